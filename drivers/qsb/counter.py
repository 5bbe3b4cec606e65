"""The QSB's timestamp: 32 bits made whole, and whether it is still the same one."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.qsb.registers import LONGEST_TICK_NS, SHORTEST_TICK_NS
from drivers.unwrap import steps, unwrapped

TURN = 1 << 32
BACKWARDS_TICKS = 2  # a line of another stream may be stamped a little earlier than the one before it
SLACK_NS = 1_000_000_000  # by which lines may be late: the kernel holds so many


class Ticks(NamedTuple):
    """Ticks of some lines.

    Attributes:
        ticks: Unwrapped timestamps, shape (n,).
        jump: Place of the first line that the host's clock contradicts: the timestamp began anew. None: none.
    """

    ticks: NDArray[np.int64]
    jump: int | None


class TickCounter:
    """Unwraps the timestamp, and notices when it began anew."""

    def __init__(self) -> None:
        self._tick = 0
        self._host_ns: int | None = None

    def restart(self) -> None:
        """The timestamp was cleared: begin with what comes next."""
        self._host_ns = None

    def runs_on(self, stamp: int, host_ns: int) -> bool:
        """Whether a line with this timestamp, arrived now, fits to those before: the adapter was not reset."""
        if self._host_ns is None:
            return False
        return self._fits((stamp - self._tick) % TURN, host_ns - self._host_ns)

    def place(self, stamps: NDArray[np.uint32], host_ns: int) -> Ticks:
        """Unwrap the timestamps of lines that arrived at ``host_ns``. From a jump on, ticks count from the new zero."""
        if self._host_ns is None:
            self._tick = int(stamps[0])
            self._host_ns = host_ns
        ticks = unwrapped(stamps, 32, self._tick, self._tick)
        elapsed_ns = host_ns - self._host_ns
        plain = [self._tick, *ticks.tolist()]
        if plain == sorted(plain) and (plain[-1] - plain[0]) * SHORTEST_TICK_NS <= elapsed_ns + SLACK_NS:
            self._tick, self._host_ns = plain[-1], host_ns
            return Ticks(ticks, None)
        since = steps(stamps, 32, self._tick)
        jump = None
        bad = since < -BACKWARDS_TICKS
        bad |= (ticks - self._tick) * SHORTEST_TICK_NS > elapsed_ns + SLACK_NS
        if bad.any():
            jump = int(bad.argmax())
            ticks[jump:] += int(stamps[jump]) - ticks[jump]
        self._tick, self._host_ns = int(ticks[-1]), host_ns
        return Ticks(ticks, jump)

    @staticmethod
    def _fits(ticks: int, elapsed_ns: int) -> bool:
        earliest = ticks * SHORTEST_TICK_NS - SLACK_NS
        latest = (ticks + 1) * LONGEST_TICK_NS + SLACK_NS
        return earliest <= elapsed_ns <= latest
