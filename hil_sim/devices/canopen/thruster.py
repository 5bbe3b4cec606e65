"""The driver of a thruster as the bus sees it: its force, manufacturer's object 2101h, in TPDO1 on every SYNC."""

from collections.abc import Mapping
from typing import Any, Literal

from hil_sim.devices.can_bus.object_dictionary import Access, DataType, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.scenario.sensor_tables import Vector
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.controller_sensors import ThrustSensor

_FORCE = 0x2101_00_10


class Thruster(CanopenNode):
    """One thruster.

    Args:
        node_id: CANopen node number.
        analog: Its force, N.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        step_n: A count of 2101h.
        faults: What breaks.

    Raises:
        FaultError: a fault that a thruster cannot have.
    """

    def __init__(
        self, node_id: int, analog: ScalarAnalog, start_ns: int, *, step_n: float, faults: DeviceFaults = NO_FAULTS
    ) -> None:
        super().__init__(node_id, 0x0008_0191, start_ns, faults, INPUT_KINDS)
        self._analog, self._step_n = FaultyScalar(analog, faults, start_ns), step_n
        self.dictionary.add(0x2101, 0, Entry(DataType.I16, Access.RO, read=self.force, mappable=True))
        self._sampled = self._add_tpdo(1, 1, (_FORCE,))

    def force(self, now_ns: int) -> int:
        """Object 2101h at ``now_ns``."""
        return round(self._analog.value(self._seconds(now_ns)) / self._step_n)


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
        twin = Thruster(self.node, sensor, bench.start_ns, step_n=sensor.step_n, faults=bench.faults)
        return self.supervised(twin, bench.name)
