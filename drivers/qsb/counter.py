"""Unwraps the QSB's 32-bit timestamp and detects its restarts."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.qsb.registers import LONGEST_TICK_NS, SHORTEST_TICK_NS
from drivers.unwrap import steps, unwrapped

TURN = 1 << 32
BACKWARDS_TICKS = 2  # a line of another stream may have a slightly earlier stamp
SLACK_NS = 1_000_000_000  # longest delay of a line in the kernel's buffer


class LineTicks(NamedTuple):
    """Ticks of received lines.

    Attributes:
        ticks: Unwrapped timestamps, shape (n,).
        jump: Index of the first line at which the timestamp restarted, by comparison with host time; None: none.
    """

    ticks: NDArray[np.int64]
    jump: int | None


class TickCounter:
    """Unwraps the timestamp and detects a restart."""

    def __init__(self) -> None:
        self._tick = 0
        self._host_ns: int | None = None

    def restart(self) -> None:
        """The timestamp was cleared: restart with the next line."""
        self._host_ns = None

    def runs_on(self, stamp: int, host_ns: int) -> bool:
        """Whether this timestamp at this arrival time continues the earlier ones (no reset of the adapter)."""
        if self._host_ns is None:
            return False
        return self._fits((stamp - self._tick) % TURN, host_ns - self._host_ns)

    def place(self, stamps: NDArray[np.uint32], host_ns: int) -> LineTicks:
        """Unwrap the timestamps of lines that arrived at ``host_ns``. From a jump on, ticks count from the new zero."""
        if self._host_ns is None:
            self._tick = int(stamps[0])
            self._host_ns = host_ns
        ticks = unwrapped(stamps, 32, self._tick, self._tick)
        elapsed_ns = host_ns - self._host_ns
        plain = [self._tick, *ticks.tolist()]
        if plain == sorted(plain) and (plain[-1] - plain[0]) * SHORTEST_TICK_NS <= elapsed_ns + SLACK_NS:
            self._tick, self._host_ns = plain[-1], host_ns
            return LineTicks(ticks, None)
        since = steps(stamps, 32, self._tick)
        jump = None
        bad = since < -BACKWARDS_TICKS
        bad |= (ticks - self._tick) * SHORTEST_TICK_NS > elapsed_ns + SLACK_NS
        if bad.any():
            jump = int(bad.argmax())
            ticks[jump:] += int(stamps[jump]) - ticks[jump]
        self._tick, self._host_ns = int(ticks[-1]), host_ns
        return LineTicks(ticks, jump)

    @staticmethod
    def _fits(ticks: int, elapsed_ns: int) -> bool:
        earliest = ticks * SHORTEST_TICK_NS - SLACK_NS
        latest = (ticks + 1) * LONGEST_TICK_NS + SLACK_NS
        return earliest <= elapsed_ns <= latest
