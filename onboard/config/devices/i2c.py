"""Devices on I2C."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.mpu6050.registers import Mpu6050Config
from drivers.records import IMU
from onboard.config.devices.base import BusDevice, BusType, ImuDevice
from onboard.config.types import Positive


class Mpu6050Device(BusDevice, ImuDevice):
    """MPU-6050 family IMU: drained from its FIFO, or read sample by sample (``mode = "burst"``)."""

    bus_type = BusType.I2C
    records = IMU
    kind: Literal["mpu6050"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = Mpu6050Config.address
    sample_rate_hz: Annotated[int, Field(ge=4, le=1000)] = Mpu6050Config.sample_rate_hz
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 250
    filter_code: Annotated[int, Field(ge=0, le=6)] = Mpu6050Config.filter_code
    poll_period_ms: Positive = Mpu6050Config.poll_period_ms
    max_transfer_bytes: int = Mpu6050Config.max_transfer_bytes
    mode: Literal["fifo", "burst"] = "fifo"

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return float(self.sample_rate_hz)

    def settings(self, name: str) -> Mpu6050Config:
        """See ``BusDevice``."""
        return self._settings(Mpu6050Config)
