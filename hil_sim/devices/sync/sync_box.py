"""The sync box: one crystal that numbers time for everybody.

It sends CANopen SYNC (COB-ID 080h, counter 1..240) every 5 ms and drives the pulse line, whose rising edges fall on
SYNC periods picked by a published code: pulse 0 in SYNC period 0, and 30 + c[n mod 32768] periods from pulse to pulse,
where c is the de Bruijn sequence B(32, 3), so that any three intervals in a row name their place in two hours. Within
its period pulse n rises (19 n) mod 32 steps of 31.25 us late, so that pulses do not beat with recorders of 1 kHz.
"""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

from hil_sim.devices.can_bus.can_wire import TransmitFrame
from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, garbled
from hil_sim.sensing.analog import ChipClock

SYNC_COB_ID: Final = 0x080
_COUNTER_MAX: Final = 240
_SYMBOLS: Final = 32
_ORDER: Final = 3
_SHORTEST: Final = 30  # SYNC periods
_DITHER_NS: Final = 31_250
_HIGH_NS: Final = 300_000  # how long a pulse stays high

Pin = Callable[[int, int], None]
"""Where the pulse line goes: called with the true time of the rising edge and the high time, ns."""


def de_bruijn(symbols: int, order: int) -> list[int]:
    """The lexicographically least de Bruijn sequence B(symbols, order).

    It is the concatenation, in lexicographic order, of the Lyndon words whose length divides ``order`` (Fredricksen,
    Kessler and Maiorana; the words by Duval's algorithm).
    """
    sequence: list[int] = []
    word = [-1]
    while word:
        word[-1] += 1
        if order % len(word) == 0:
            sequence.extend(word)
        period = len(word)
        while len(word) < order:
            word.append(word[-period])
        while word and word[-1] == symbols - 1:
            word.pop()
    return sequence


def pulse_places() -> Iterator[tuple[int, int]]:
    """SYNC number of pulse 0, 1, 2, ... and how much after the start of that SYNC it rises, ns."""
    code = de_bruijn(_SYMBOLS, _ORDER)
    sync = n = 0
    while True:
        yield sync, _DITHER_NS * (19 * (n % len(code)) % 32)
        n += 1
        sync += _SHORTEST + code[n % len(code)]


class SyncBox:
    """One box, running from power-up.

    Args:
        clock: Its crystal.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        period_ns: SYNC period on its own clock.
        first_sync: SYNC number it begins with, as if it had been on before.
        faults: What breaks.

    Raises:
        FaultError: a fault that the box cannot have.
    """

    def __init__(
        self,
        clock: ChipClock,
        start_ns: int,
        *,
        period_ns: int = 5_000_000,
        first_sync: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        faults.require(
            FaultKind.OFF,
            FaultKind.RESET,
            FaultKind.SILENT,
            FaultKind.INTERMITTENT,
            FaultKind.WRONG,
            FaultKind.GARBAGE,
            FaultKind.SLOW,
            FaultKind.CLOCK_JUMP,
        )
        self.hears_process_data = False
        self.produced = 0
        self.pulses = 0
        self._faults, self._is_faulty = faults, bool(faults)
        self._rng = faults.rng()
        self._clock: ChipClock = FaultyClock(clock, faults)
        self._period_ns = period_ns
        self._pins: list[Pin] = []
        self._transmit: TransmitFrame | None = None
        self._cycles = deque(faults.power_cycles())
        self._sync = self._sync_ns = self._origin_chip_ns = 0
        self._pulse_places = pulse_places()
        self._next_pulse = (0, 0)
        self._count_from(start_ns, first_sync)

    @property
    def due_ns(self) -> int:
        """Time of the next SYNC, or of a change of its supply before that."""
        return min(self._sync_ns, self._cycles[0].down_ns) if self._cycles else self._sync_ns

    @property
    def pulse_ns(self) -> int:
        """Before when it drives no edge of the sync line; where a fault is to come, when it next acts."""
        if self._is_faulty or not self._pins:
            return self.due_ns if self._pins else NEVER
        return self._sync_time_ns(max(self._next_pulse[0], self._sync))

    def connect(self, transmit: TransmitFrame) -> None:
        """Give it the CAN wire."""
        self._transmit = transmit

    def connect_pin(self, pin: Pin) -> None:
        """Wire the pulse line to an input."""
        self._pins.append(pin)

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """Ignores all frames."""

    def act(self, now_ns: int) -> None:
        """Send the SYNC that is due, and the edge that belongs to it."""
        if self._cycles and self._cycles[0].down_ns <= now_ns:
            up_ns = self._cycles.popleft().up_ns
            if up_ns < NEVER:
                self._count_from(up_ns, 0)
            else:
                self._sync_ns = NEVER
            return
        while self._is_faulty and self._sync_time_ns(self._sync + 1) <= now_ns:
            self._sync += 1  # the clock was put forward over it
        while self._next_pulse[0] < self._sync:
            self._next_pulse = next(self._pulse_places)
        if self._sync == self._next_pulse[0]:
            rise_ns = self._clock.time_ns(self._clock.chip_ns(now_ns) + self._next_pulse[1])
            self._next_pulse = next(self._pulse_places)
            self.pulses += 1
            for pin in self._pins:
                pin(rise_ns, _HIGH_NS)
        if self._transmit is not None and not (self._is_faulty and self._faults.is_away(now_ns)):
            self.produced += 1
            self._transmit(SYNC_COB_ID, self._counter(now_ns), now_ns)
        self._sync += 1
        self._sync_ns = self._sync_time_ns(self._sync)

    def next_syncs(self, before_ns: int, most: int) -> list[tuple[int, bytes]]:
        """Times and data of the SYNCs after the last one sent, before ``before_ns``; none where a fault is to come."""
        syncs: list[tuple[int, bytes]] = []
        for sync in range(self._sync, self._sync if self._is_faulty else self._sync + most):
            time_ns = self._sync_time_ns(sync)
            if time_ns >= before_ns:
                break
            syncs.append((time_ns, bytes([sync % _COUNTER_MAX + 1])))
        return syncs

    def have_sent(self, count: int) -> None:
        """So many SYNCs were sent as ``next_syncs`` said; drives the edges that belong to them."""
        after = self._sync + count
        while self._next_pulse[0] < after:
            sync, late_ns = self._next_pulse
            if sync >= self._sync:
                rise_ns = self._clock.time_ns(self._clock.chip_ns(self._sync_time_ns(sync)) + late_ns)
                self.pulses += 1
                for pin in self._pins:
                    pin(rise_ns, _HIGH_NS)
            self._next_pulse = next(self._pulse_places)
        self.produced += count
        self._sync, self._sync_ns = after, self._sync_time_ns(after)

    def _counter(self, now_ns: int) -> bytes:
        if not self._is_faulty:
            return bytes([self._sync % _COUNTER_MAX + 1])
        wrong = self._faults.active(FaultKind.WRONG, now_ns)
        number = self._sync if wrong is None else self._sync + int(wrong.value)
        data = bytes([number % _COUNTER_MAX + 1])
        return data if self._faults.active(FaultKind.GARBAGE, now_ns) is None else garbled(data, self._rng)

    def _sync_time_ns(self, sync: int) -> int:
        return self._clock.time_ns(self._origin_chip_ns + sync * self._period_ns)

    def _count_from(self, up_ns: int, first_sync: int) -> None:
        self._sync = first_sync
        self._origin_chip_ns = self._clock.chip_ns(up_ns) - first_sync * self._period_ns
        self._sync_ns = up_ns
        self._pulse_places = pulse_places()
        self._next_pulse = next(place for place in self._pulse_places if place[0] >= first_sync)
