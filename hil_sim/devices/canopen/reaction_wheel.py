"""A reaction wheel's drive as the bus sees it: velocity actual value 606Ch in TPDO1, on every SYNC (CiA 402)."""

from collections.abc import Mapping
from typing import Any, Literal

from hil_sim.devices.can_bus.object_dictionary import DataType
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.measured_object import MeasuredObject
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.controller_sensors import TachoSensor

_VELOCITY = 0x606C_00_20


class ReactionWheelTable(CanNodeEmulator):
    """A reaction wheel."""

    quantities = ("wheel_rate",)

    kind: Literal["reaction_wheel"]

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = cls.node_keys(said) | {"measures": name, "at": said["joint"]}
        return Equivalent(table, {name: sheets.wheel(said)}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        tacho = bench.sensor(TachoSensor)
        about = 0x0002_0192, _VELOCITY, DataType.I32
        twin = MeasuredObject(self.node, *about, tacho, bench.start_ns, step=tacho.step_rad_s, faults=bench.faults)
        return self.supervised(twin, bench.name)
