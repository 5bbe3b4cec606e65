"""Samples that a simulated chip converts ahead: one conversion of many costs hardly more than one of ten.

They are good as long as no register that they depend on is written, and the input's future is known.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.sensing.analog import ChipClock, KnownAhead

Times = NDArray[np.float64]
Words = NDArray[np.int16]
_MOST = 1024


class Grid(NamedTuple):
    """When samples are made.

    Attributes:
        first_ns: Chip time of the next one.
        period_ns: Chip time between them.
        clock: That of the chip.
        settings: What their words depend on; empty where they cannot be made ahead.
    """

    first_ns: int
    period_ns: int
    clock: ChipClock
    settings: tuple[object, ...]


class SamplesAhead:
    """The samples of one chip.

    Args:
        analog: The input.
        convert: Words at chip times and mission times, none later than a mission time.
    """

    def __init__(self, analog: KnownAhead, convert: Callable[[Times, Times, float], Words]) -> None:
        self._analog = analog
        self._convert = convert
        self._settings: tuple[object, ...] = ()
        self._first_ns = 0  # chip time of the first of those converted ahead
        self._times_s: Times = np.zeros(0)  # (m,)
        self._words: Words = np.zeros((0, 7), np.int16)

    def next(self, count: int, grid: Grid, latest_s: float) -> tuple[Times, Words]:
        """The next samples: mission times (n,), none after ``latest_s``, and words (n, 7) that are the caller's."""
        times_s, words = self._times_s[:count], self._words[:count]
        fits = grid.settings and grid.settings == self._settings and grid.first_ns == self._first_ns
        if fits and len(times_s) == count and times_s[-1] <= latest_s:
            self._first_ns += count * grid.period_ns
            self._times_s, self._words = self._times_s[count:], self._words[count:]
            return times_s, words.copy()
        ticks_ns = grid.first_ns + grid.period_ns * np.arange(count, dtype=np.float64)  # (n,)
        times_s = np.minimum(grid.clock.times_s(ticks_ns), latest_s)
        words = self._convert(ticks_ns, times_s, latest_s)
        if grid.settings:
            self._make(count, grid._replace(first_ns=grid.first_ns + count * grid.period_ns))
        return times_s, words

    def _make(self, fewest: int, grid: Grid) -> None:
        """Convert what the input knows; fewer than ``fewest`` samples would be for nothing."""
        self._first_ns, self._settings = grid.first_ns, grid.settings
        ticks_ns = grid.first_ns + grid.period_ns * np.arange(_MOST, dtype=np.float64)
        times_s = grid.clock.times_s(ticks_ns)
        known = int(np.searchsorted(times_s, self._analog.known_s))
        known = known if known >= fewest else 0
        self._times_s = times_s[:known]
        self._words = self._convert(ticks_ns[:known], self._times_s, math.inf) if known else self._words[:0]
