"""A CANopen device (CiA 301): NMT states, SDO server, heartbeat, emergency messages, TPDOs on SYNC, event and timer.

Subclasses fill the object dictionary. What a client may count on: boot-up 50 ms after power-up, and 1.1 ms more for
each node number; 5 ms after an NMT reset; timers that run slow by 50 ppm for each node number; an SDO answer 0.5 ms
after its request; a TPDO offered to the bus 40 us after the SYNC that it answers, its objects sampled at the end of the
SYNC frame. SDO transfers are expedited; a segmented one is aborted with 05040001h. A SYNC is taken with or without
counter; a longer frame is none, and is reported once by 8240h. A node is watched by its heartbeat or, where it was made
without one, by node guarding (7.2.8.3.2.1): it answers remote frames with its state and a bit that toggles, and when
none came for guard time x life time factor it reports 8130h and leaves Operational, the default of 1029h.

The SDO server of a simulated node (CiA 301, 7.2.4): expedited transfers; others are aborted with 05040001h.
"""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.can_bus.can_wire import TransmitFrame
from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry, ObjectDictionary
from hil_sim.devices.can_bus.tpdo import ANSWER_NS, Tpdo
from hil_sim.devices.powered import PoweredTwin
from hil_sim.faults import MEMORYLESS, NEVER, DeviceFaults, FaultKind, garbled

_BOOT_NS = 50_000_000
_BOOT_STAGGER_NS = 1_100_000
_RESET_NS = 5_000_000
_SDO_NS = 500_000
_SYNC = 0x080
_TOGGLE = 0x80
_LIFE_GUARD_ERROR, _SYNC_LENGTH_ERROR, _COMMUNICATION_ERROR = 0x8130, 0x8240, 0x10
_FIRST_COMMUNICATION, _LAST_COMMUNICATION = 0x1000, 0x1FFF
# NMT states, as the heartbeat reports them.
BOOTING = 0x00
STOPPED = 0x04
OPERATIONAL = 0x05
PRE_OPERATIONAL = 0x7F
OFF = -1
_DEAF = (OFF, BOOTING)
_FAULTS = (FaultKind.OFF, FaultKind.RESET, FaultKind.SILENT, FaultKind.INTERMITTENT, FaultKind.GARBAGE, FaultKind.SLOW)


def serve(dictionary: ObjectDictionary, request: bytes, now_ns: int) -> tuple[bytes | None, tuple[int, int] | None]:
    """Do what eight bytes of an SDO request ask.

    Returns:
        The answer, None where there is none; and the object that was read, None where none was.
    """
    command, index, sub = request[0], int.from_bytes(request[1:3], "little"), request[3]
    specifier, head = command >> 5, request[1:4]
    if specifier == 4:  # the client aborts; an expedited transfer is over already
        return None, None
    try:
        if specifier == 2:
            value = dictionary.upload(index, sub, now_ns)
            return bytes([0x43 | (4 - len(value)) << 2]) + head + value.ljust(4, b"\0"), (index, sub)
        if specifier == 1 and command & 0x02:
            sized = bool(command & 0x01)
            length = 4 - (command >> 2 & 3) if sized else 4
            dictionary.download(index, sub, request[4 : 4 + length], sized=sized, now_ns=now_ns)
            return b"\x60" + head + bytes(4), None
        raise DictionaryError(Abort.COMMAND)
    except DictionaryError as abort:
        return b"\x80" + head + abort.code.to_bytes(4, "little"), None


class CanopenNode(PoweredTwin):
    """One node.

    Args:
        node_id: 1 to 127.
        device_type: Object 1000h.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.
        extra_faults: Kinds that the subclass applies itself.

    Raises:
        ValueError: a node number out of range.
        FaultError: a fault that this node cannot have.
    """

    _sampled: Tpdo  # answers every SYNC

    def __init__(
        self,
        node_id: int,
        device_type: int,
        start_ns: int,
        faults: DeviceFaults,
        extra_faults: tuple[FaultKind, ...] = (),
    ) -> None:
        if not 1 <= node_id <= 127:
            raise ValueError(f"Node number {node_id} is not 1 to 127.")
        self.node_id = node_id
        self.hears_process_data = False
        self.state = OFF
        self.dictionary = ObjectDictionary()
        self.uploads: Counter[tuple[int, int]] = Counter()  # SDO reads answered, by object
        self.emergencies = 0  # messages sent
        super().__init__(start_ns, faults.require(*_FAULTS, *extra_faults))
        self._rng = faults.rng()
        self._transmit: TransmitFrame | None = None
        self._tpdos: list[Tpdo] = []
        self._guard: tuple[Entry, Entry] | None = None  # guard time in ms, life time factor
        self._toggle = 0
        self._abandoned = False  # by who guarded it
        self.revision = 0  # changes with all that its answers to SYNCs depend on, but for what it measures
        for away_ns, back_ns in faults.absences():
            if back_ns != NEVER:
                self._at(f"recovery {away_ns}", back_ns, self._recovered_bus)
        self._add_communication_objects(device_type)

    @property
    def produced(self) -> int:
        """Samples so far, one for each SYNC in Operational."""
        return self._sampled.produced

    def guard_for_heartbeat(self) -> None:
        """Make it a node without heartbeat, that can be guarded."""
        self.dictionary.remove(0x1017, 0)
        time_ms = self.dictionary.add(0x100C, 0, Entry(DataType.U16, Access.RW))
        factor = self.dictionary.add(0x100D, 0, Entry(DataType.U8, Access.RW))
        self._guard = time_ms, factor

    def connect(self, transmit: TransmitFrame) -> None:
        """Give it the wire."""
        self._transmit = transmit

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """A frame has ended on the wire."""
        if self.state in _DEAF or self._is_silent(now_ns):
            return
        if identifier == self._sync_cob_id.value:
            if len(data) > 1:
                self._refuse_sync(now_ns)
            elif self.state == OPERATIONAL:
                self._on_sync(data[0] if data else None, now_ns)
        elif identifier == 0x600 + self.node_id:
            if self.state != STOPPED and len(data) == 8:
                self._on_sdo(data, now_ns)
        elif identifier == 0x000 and len(data) == 2 and data[1] in (0, self.node_id):
            self._on_nmt(data[0], now_ns)

    def answers(self, now_ns: int) -> list[Tpdo] | None:
        """TPDOs that it answers each SYNC from now on with, as things stand; None where that is not known."""
        if self.knows_until(now_ns) <= now_ns or self._sync_cob_id.value != _SYNC:
            return None
        if self.state != OPERATIONAL:
            return []
        every_sync = [tpdo.every_sync for tpdo in self._tpdos]
        if None in every_sync:
            return None
        return [tpdo for tpdo, answers in zip(self._tpdos, every_sync, strict=True) if answers]

    def knows_until(self, now_ns: int) -> int:
        """Up to when no fault but of its inputs' readings changes what it answers; ``now_ns``: one is in force."""
        return self._faults.quiet_until(now_ns, *MEMORYLESS) - ANSWER_NS if self._is_faulty else NEVER

    def hears(self, identifier: int) -> bool:
        """Whether a PDO of another node does anything to it."""
        return identifier == self._sync_cob_id.value

    def remote(self, identifier: int, now_ns: int) -> None:
        """A remote frame has ended."""
        if self._guard is None or identifier != 0x700 + self.node_id:
            return
        if self.state in _DEAF or self._is_silent(now_ns):
            return
        self._send(identifier, bytes([self._toggle | self.state]), now_ns + ANSWER_NS)
        self._toggle ^= _TOGGLE
        if self._abandoned:
            self._abandoned = False
            self.emergency(0, 0, b"", now_ns)
        time_ms, factor = self._guard
        life_ms = time_ms.value * factor.value
        if life_ms:
            self._at("life", now_ns + self._timer_ns(life_ms), self._abandon)

    def emergency(self, code: int, register: int, vendor: bytes, now_ns: int) -> None:
        """Report an error (code 0: no error any more) by an EMCY message, and keep it in 1001h and 1003h.

        Args:
            code: Emergency error code.
            register: New error register 1001h.
            vendor: Up to five manufacturer-specific bytes.
            now_ns: When.
        """
        self._error_register.value = register
        if code:
            self._last_error.value = code
            self._error_count.value = 1
        if self.state in (PRE_OPERATIONAL, OPERATIONAL):
            self.emergencies += 1
            body = code.to_bytes(2, "little") + bytes([register]) + vendor[:5].ljust(5, b"\0")
            self._send(self._emcy_cob_id.value & 0x7FF, body, now_ns)

    # For subclasses

    def _add_tpdo(self, number: int, transmission_type: int, mapping: tuple[int, ...], event_timer_ms: int = 0) -> Tpdo:
        cob_id = 0x80 + 0x100 * number + self.node_id
        tpdo = Tpdo(self.dictionary, number, cob_id, transmission_type, mapping, event_timer_ms)
        tpdo.event_timer.changed = lambda _, now_ns: self._arm_event_timer(tpdo, now_ns)
        self._tpdos.append(tpdo)
        return tpdo

    def _event(self, tpdo: Tpdo, now_ns: int) -> None:
        """Something happened that ``tpdo`` is to report."""
        if self.state != OPERATIONAL or not (tpdo.valid and tpdo.on_event):
            return
        if f"inhibit {tpdo.number}" in self._timers:
            tpdo.pending = True
        else:
            self._send_tpdo(tpdo, now_ns)

    def _times_s(self, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Mission times, (n,)."""
        return (times_ns - self._start_ns).astype(np.float64) * 1e-9

    def _timer_ns(self, period_ms: int) -> int:
        """What the node's oscillator makes of a period."""
        return period_ms * (1_000_000 + 50 * self.node_id)

    def _before_start(self) -> None:
        """Application state that a reset clears; subclasses override."""

    # Supply and NMT

    def _lose_power(self, now_ns: int) -> None:
        del now_ns
        self.state = OFF
        self._stop_communication()

    def _gain_power(self, now_ns: int) -> None:
        self.dictionary.reset()
        self._before_start()
        self._boot(now_ns + _BOOT_NS + self.node_id * _BOOT_STAGGER_NS)

    def _acts(self, name: str) -> None:
        self.revision += name != "heartbeat"

    def _boot(self, ready_ns: int) -> None:
        self._stop_communication()
        self.state = BOOTING
        self._toggle, self._abandoned = 0, False
        self._at("boot", ready_ns, self._boot_up)

    def _boot_up(self, now_ns: int) -> None:
        self.state = PRE_OPERATIONAL
        self._send(0x700 + self.node_id, bytes([BOOTING]), now_ns)
        self._arm_heartbeat(self._heartbeat_ms.value, now_ns)

    def _stop_communication(self) -> None:
        names = {"boot", "heartbeat", "life"}
        names.update(f"{kind} {tpdo.number}" for kind in ("event", "inhibit") for tpdo in self._tpdos)
        for name in names:
            self._stop(name)

    def _on_nmt(self, command: int, now_ns: int) -> None:
        self.revision += 1
        if command == 1:
            self._start_node(now_ns)
        elif command == 2:
            self._leave_operational(STOPPED)
        elif command == 128:
            self._leave_operational(PRE_OPERATIONAL)
        elif command == 129:
            self.dictionary.reset()
            self._before_start()
            self._boot(now_ns + _RESET_NS)
        elif command == 130:
            self.dictionary.reset(_FIRST_COMMUNICATION, _LAST_COMMUNICATION)
            self._boot(now_ns + _RESET_NS)

    def _start_node(self, now_ns: int) -> None:
        if self.state == OPERATIONAL:
            return
        self.state = OPERATIONAL
        for tpdo in self._tpdos:
            tpdo.restart()
            self._event(tpdo, now_ns)
            self._arm_event_timer(tpdo, now_ns)

    def _leave_operational(self, state: int) -> None:
        self.state = state
        for tpdo in self._tpdos:
            self._stop(f"event {tpdo.number}")
            self._stop(f"inhibit {tpdo.number}")

    # SYNC and TPDO

    def _refuse_sync(self, now_ns: int) -> None:
        if self._last_error.value != _SYNC_LENGTH_ERROR:
            self.emergency(_SYNC_LENGTH_ERROR, _COMMUNICATION_ERROR, b"", now_ns)

    def _on_sync(self, counter: int | None, now_ns: int) -> None:
        for tpdo in self._tpdos:
            if tpdo.on_sync(counter):
                self._send(tpdo.cob_id, tpdo.sample(now_ns), now_ns + ANSWER_NS)

    def _send_tpdo(self, tpdo: Tpdo, now_ns: int) -> None:
        self._send(tpdo.cob_id, tpdo.sample(now_ns), now_ns + ANSWER_NS)
        if tpdo.inhibit_ns:
            self._at(f"inhibit {tpdo.number}", now_ns + tpdo.inhibit_ns, lambda t: self._after_inhibit(tpdo, t))
        self._arm_event_timer(tpdo, now_ns)

    def _after_inhibit(self, tpdo: Tpdo, now_ns: int) -> None:
        if tpdo.pending:
            self._event(tpdo, now_ns)

    def _arm_event_timer(self, tpdo: Tpdo, now_ns: int) -> None:
        name = f"event {tpdo.number}"
        self._stop(name)
        if self.state == OPERATIONAL and tpdo.on_event and tpdo.event_timer.value:
            self._at(name, now_ns + self._timer_ns(tpdo.event_timer.value), lambda t: self._on_event_timer(tpdo, t))

    def _on_event_timer(self, tpdo: Tpdo, now_ns: int) -> None:
        self._event(tpdo, now_ns)
        self._arm_event_timer(tpdo, now_ns)

    def _on_sdo(self, request: bytes, now_ns: int) -> None:
        answer, read = serve(self.dictionary, request, now_ns)
        if read is None:
            self.revision += 1
        else:
            self._uploaded(read)
        if answer is not None:
            self._send(0x580 + self.node_id, answer, now_ns + _SDO_NS)

    def _uploaded(self, read: tuple[int, int]) -> None:
        """An object was read and answered."""
        self.uploads[read] += 1

    # Heartbeat and wire

    def _arm_heartbeat(self, period_ms: int, now_ns: int) -> None:
        self._stop("heartbeat")
        if period_ms:
            self._at("heartbeat", now_ns + self._timer_ns(period_ms), self._beat)

    def _abandon(self, now_ns: int) -> None:
        self._abandoned = True
        self.emergency(_LIFE_GUARD_ERROR, _COMMUNICATION_ERROR, b"", now_ns)
        if self.state == OPERATIONAL:
            self._leave_operational(PRE_OPERATIONAL)

    def _beat(self, now_ns: int) -> None:
        self._send(0x700 + self.node_id, bytes([self.state]), now_ns)
        self._arm_heartbeat(self._heartbeat_ms.value, now_ns)

    def _recovered_bus(self, now_ns: int) -> None:
        self.emergency(0x8140, 0x10, b"", now_ns)  # recovered from bus-off
        self.emergency(0x0000, 0x00, b"", now_ns)

    def _hear(self, sync: int, now_ns: int) -> None:
        """1005h has another SYNC than that of the predefined connection set."""
        del now_ns
        self.hears_process_data |= sync != 0x80

    def _send(self, identifier: int, data: bytes, ready_ns: int) -> None:
        if self._is_faulty:
            slow = self._faults.active(FaultKind.SLOW, ready_ns)
            ready_ns += 0 if slow is None else round(slow.value * 1e9)
            if self._faults.active(FaultKind.GARBAGE, ready_ns) is not None:
                data = garbled(data, self._rng)
            if self._faults.is_away(ready_ns):
                return
        if self._transmit is not None:
            self._transmit(identifier, data, ready_ns)

    def _add_communication_objects(self, device_type: int) -> None:
        add, u8, u16, u32 = self.dictionary.add, DataType.U8, DataType.U16, DataType.U32
        add(0x1000, 0, Entry(u32, Access.RO, device_type))
        self._error_register = add(0x1001, 0, Entry(u8, Access.RO, mappable=True))
        self._error_count = add(0x1003, 0, Entry(u8, Access.RW, check=_only_zero))
        self._last_error = add(0x1003, 1, Entry(u32, Access.RO))
        self._sync_cob_id = add(0x1005, 0, Entry(u32, Access.RW, 0x80, check=_check_identifier, changed=self._hear))
        self._emcy_cob_id = add(0x1014, 0, Entry(u32, Access.RO, 0x80 + self.node_id))
        self._heartbeat_ms = add(0x1017, 0, Entry(u16, Access.RW, 0, changed=self._arm_heartbeat))
        for sub, value in enumerate((4, 0x0000_5A5A, device_type & 0xFFFF, 0x0001_0000, 1000 + self.node_id)):
            add(0x1018, sub, Entry(u8 if sub == 0 else u32, Access.RO, value))


def _only_zero(value: int, now_ns: int) -> None:
    """1003h:0 takes a zero, which clears the error history."""
    del now_ns
    if value:
        raise DictionaryError(Abort.VALUE_RANGE)


def _check_identifier(value: int, now_ns: int) -> None:
    del now_ns
    if value & ~0x7FF:
        raise DictionaryError(Abort.VALUE_RANGE)
