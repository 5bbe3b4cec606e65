"""A reaction wheel's drive as the bus sees it: velocity actual value 606Ch in TPDO1, on every SYNC (CiA 402)."""

from collections.abc import Mapping
from typing import Any, Literal

from hil_sim.devices.can_bus.object_dictionary import Access, DataType, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.controller_sensors import TachoSensor

_VELOCITY = 0x606C_00_20


class ReactionWheel(CanopenNode):
    """One wheel.

    Args:
        node_id: CANopen node number.
        analog: Its speed, rad/s.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        step_rad_s: A count of 606Ch.
        faults: What breaks.

    Raises:
        FaultError: a fault that a wheel cannot have.
    """

    def __init__(
        self,
        node_id: int,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        step_rad_s: float,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(node_id, 0x0002_0192, start_ns, faults, INPUT_KINDS)
        self._analog, self._step_rad_s = FaultyScalar(analog, faults, start_ns), step_rad_s
        self.dictionary.add(0x606C, 0, Entry(DataType.I32, Access.RO, read=self.velocity, mappable=True))
        self._sampled = self._add_tpdo(1, 1, (_VELOCITY,))

    def velocity(self, now_ns: int) -> int:
        """Object 606Ch at ``now_ns``."""
        return round(self._analog.value(self._seconds(now_ns)) / self._step_rad_s)


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
        twin = ReactionWheel(self.node, tacho, bench.start_ns, step_rad_s=tacho.step_rad_s, faults=bench.faults)
        return self.supervised(twin, bench.name)
