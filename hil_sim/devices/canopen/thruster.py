"""The driver of a thruster as the bus sees it: its force, manufacturer's object 2101h, in TPDO1 on every SYNC."""

from collections.abc import Mapping
from typing import Any, Literal

from hil_sim.devices.can_bus.object_dictionary import DataType
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.measured_object import MeasuredObject
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.scenario.sensor_tables import Vector
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.controller_sensors import ThrustSensor

_FORCE = 0x2101_00_10


class ThrusterTable(CanNodeEmulator):
    """The driver of a thruster."""

    quantities = ("thrust",)

    kind: Literal["thruster"]
    axis: Vector = (1.0, 0.0, 0.0)  # of its frame, for a rehearsal

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = cls.node_keys(said) | {"measures": name, "at": said["frame"], "axis": said["axis"]}
        return Equivalent(table, {name: sheets.thrust(said)}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        sensor = bench.sensor(ThrustSensor)
        about = 0x0008_0191, _FORCE, DataType.I16
        twin = MeasuredObject(self.node, *about, sensor, bench.start_ns, step=sensor.step_n, faults=bench.faults)
        return self.supervised(twin, bench.name)
