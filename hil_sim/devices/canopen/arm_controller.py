"""The arm controller as the bus sees it: mission phase 2000h:1 and event counter 2000h:2 in TPDO1, on every change."""

from collections.abc import Iterable, Mapping
from typing import Any, Literal

from hil_sim.devices.can_bus.object_dictionary import Access, DataType, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, reported_phases
from hil_sim.scenario.sheets import Sheets
from hil_sim.scenario.tables import ScenarioError
from hil_sim.sensing.controller_sensors import PhaseSensor

_PHASE = 0x2000_01_08
_EVENTS = 0x2000_02_08


class ArmController(CanopenNode):
    """One controller. Its sequence runs whether or not anybody listens; a TPDO is made only in Operational.

    Args:
        node_id: CANopen node number.
        phase_changes: (mission time in s, phase code), in order.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.

    Raises:
        ValueError: phase changes out of order.
        FaultError: a fault that the controller cannot have.
    """

    def __init__(
        self,
        node_id: int,
        phase_changes: Iterable[tuple[float, int]],
        start_ns: int,
        *,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(node_id, 0x0000_0000, start_ns, faults, INPUT_KINDS)
        self._changes = [(start_ns + round(time_s * 1e9), phase) for time_s, phase in phase_changes]
        if self._changes != sorted(self._changes, key=lambda change: change[0]):
            raise ValueError("The phase changes are not in order of time; sort them.")
        self._changes = reported_phases(self._changes, faults)
        self._changes.reverse()
        self._read_back = 0  # times
        self._shown: tuple[int, ...] | None = None  # when the phase was read last
        self._phase = self._events = 0  # not objects of their own: an NMT reset does not touch the sequence
        u8 = DataType.U8
        self.dictionary.add(0x2000, 0, Entry(u8, Access.RO, 2))
        self.dictionary.add(0x2000, 1, Entry(u8, Access.RO, read=lambda _: self._phase, mappable=True))
        self.dictionary.add(0x2000, 2, Entry(u8, Access.RO, read=lambda _: self._events, mappable=True))
        self._tpdo_1 = self._add_tpdo(1, 255, (_PHASE, _EVENTS))
        self._next_change()

    @property
    def produced(self) -> int:
        """Phases reported: a TPDO1 on entering Operational, one per change in it, and each SDO read.

        Reads with no change, TPDO, emergency message or set-up (a read of 1000h) between them are one: a lost answer is
        asked for again.
        """
        return self._tpdo_1.produced + self._read_back

    def _uploaded(self, read: tuple[int, int]) -> None:
        super()._uploaded(read)
        shown = self._tpdo_1.produced, self._events, self.emergencies, self.uploads[0x1000, 0]
        if read == (0x2000, 1) and shown != self._shown:
            self._read_back += 1
            self._shown = shown

    def _next_change(self) -> None:
        if self._changes:
            self._at("phase", self._changes[-1][0], self._change)

    def _change(self, now_ns: int) -> None:
        _, self._phase = self._changes.pop()
        self._events = (self._events + 1) & 0xFF
        self._event(self._tpdo_1, now_ns)
        self._next_change()


class ArmControllerTable(CanNodeEmulator):
    """The arm controller, which reports the phase."""

    quantities = ("phase",)

    kind: Literal["arm_controller"]

    vehicle_kind = "canopen_object"

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: the object that tells the phases of the mission, 2000h."""
        if sheets.phase_channel != name or (said["index"], said["subindex"]) != (_PHASE >> 16, _PHASE >> 8 & 0xFF):
            raise ScenarioError(
                f"device.{name}: of mapped objects the phase, 2000h:1, can be rehearsed; take the others out"
            )
        return Equivalent(cls.node_keys(said) | {"measures": name}, {name: {"quantity": "phase"}}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        twin = ArmController(self.node, bench.sensor(PhaseSensor).changes, bench.start_ns, faults=bench.faults)
        return self.supervised(twin, bench.name)
