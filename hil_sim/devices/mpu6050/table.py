"""``[device.NAME]`` of an MPU-6050."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.sensors import ImuSensor


class Mpu6050Table(MeasuringEmulator):
    """An MPU-6050. Its RC oscillator is the clock ``NAME_rc``."""

    needs = "i2c"
    quantities = ("inertial",)
    where = "address {address:#04x}"

    kind: Literal["mpu6050"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x68
    sync_input: bool = True

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"address": said.get("address", 0x68), "measures": name, "at": said["frame"]}
        table["sync_input"] = sheets.pulse and said.get("sync_input", True)
        return Equivalent(table, {name: sheets.imu("mpu6050", said)}, {name: "gyro", f"{name}_rc": "rc"})

    def clocks(self, name: str) -> tuple[str, ...]:
        """See ``Emulator``."""
        return name, f"{name}_rc"

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        imu = Mpu6050Twin(
            bench.sensor(ImuSensor),
            bench.clock,
            bench.start_ns,
            address=self.address,
            faults=bench.faults,
            rc_clock=bench.clocks[f"{bench.name}_rc"],
        )
        return Twin(imu, lambda: imu.sampled or imu.shown, (bench.name,), pin=imu.fsync if self.sync_input else None)
