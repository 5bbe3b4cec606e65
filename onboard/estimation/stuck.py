"""Detects stuck instruments: runs of equal readings that noise and motion exclude.

Two tests:

- *Noise*: the stated noise gives the probability that a reading repeats the count before; a run is stuck when its
  probability is below ``READING``. Half of the stated noise is assumed, conditional on the reading before (filters
  correlate neighbours). Noise below a count may repeat for long and is not tested.
- *Travel*: the angle of a moving joint changes by about as much as it did before, and a joint can neither stop nor
  jump from one sample to the next. A run of equal readings that noise excludes is stuck where it begins in motion, or
  ends with a jump larger than the neighbouring steps. At rest an encoder repeats and is not tested.

A stuck run is reported with its earlier samples; those still in a history are refused too.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray
from onboard.estimation.jumps import TRAVELS
from onboard.estimation.policy import READING

_SHORTEST = 4  # equal readings that are a run of a travelling joint's
_TRAVEL = 8.0  # counts a sample, below which a joint may come to rest from one sample to the next
NONE = slice(0, 0)
_RUNS = 6  # that are kept for the next readings: the speed before a run, and what comes after it


def longest_run(sigma_counts: Sequence[float], memory: float) -> float:
    """Length of a run of equal readings with probability ``READING``; infinite where the noise is below a count.

    Args:
        sigma_counts: noise of each column, rms, counts.
        memory: correlation of a reading's noise with that of the one before.
    """
    left = 0.5 * math.sqrt(1.0 - memory * memory)
    spread = [left * sigma for sigma in sigma_counts]
    if not all(0.5 <= sigma < math.inf for sigma in spread):
        return math.inf
    chance = math.prod(math.erf(1.0 / (2.0 * math.sqrt(2.0) * sigma)) for sigma in spread)
    return 1.0 + math.ceil(math.log(READING) / math.log(chance))


class StuckReadings:
    """Finds stuck runs in one channel's raw readings.

    Args:
        columns: of a reading.
        longest: run that may be chance (:func:`longest_run`).
        travels: it is the angle of a joint, which its travel judges besides; where noise excludes no run, it alone.
    """

    def __init__(self, columns: int, longest: float, *, travels: bool = False) -> None:
        self._longest, self._travels = longest, travels
        by_noise = longest + 1.0 if math.isfinite(longest) else 0.0
        self._shortest = max(_SHORTEST, by_noise)  # run that travel judges
        self._values = np.zeros((0, columns))  # of the last few runs, the one that goes on included
        self._lengths = np.zeros(0, np.int64)
        self._stuck = np.zeros(0, np.bool_)

    @property
    def stuck(self) -> bool:
        """Whether the last reading is in a stuck run."""
        return bool(self._stuck[-1:].any())

    def forget(self) -> None:
        """What comes next does not follow on what came last."""
        self._values, self._lengths, self._stuck = self._values[:0], self._lengths[:0], self._stuck[:0]

    def watch(self, readings: NDArray[np.float64], usable: BoolArray) -> tuple[BoolArray, slice]:
        """Judge the next readings.

        Args:
            readings: (n, columns) raw counts.
            usable: (n,); a reading that is not (saturated, say) is no part of a run.

        Returns:
            Which are stuck, (n,), and which of those *before* them turn out to be, counted from the first of these, so
            that both ends are negative or zero; empty where none do.
        """
        n, kept = len(readings), len(self._lengths)
        if not n:
            return np.zeros(0, np.bool_), NONE
        if self._differ(readings) and usable.all():
            if n >= _RUNS:
                self._values, self._lengths = readings[-_RUNS:].copy(), np.ones(_RUNS, np.int64)
                self._stuck = np.zeros(_RUNS, np.bool_)
                return np.zeros(n, np.bool_), NONE
            lengths = np.concatenate([self._lengths, np.ones(n, np.int64)])
            self._values = np.concatenate([self._values, readings])[-_RUNS:]
            found = np.concatenate([self._stuck, np.zeros(n, np.bool_)])
            self._lengths, self._stuck = lengths[-_RUNS:], found[-_RUNS:]
            return found[kept:], NONE
        values = np.concatenate([self._values, np.where(usable[:, None], readings, np.nan)])
        first = np.ones(len(values), np.bool_)
        differs = values[1:] != values[:-1]
        first[1:] = differs[:, 0] if differs.shape[1] == 1 else differs.any(axis=1)  # of its run; NaN equals nothing
        run = np.cumsum(first) - 1
        lengths = np.bincount(run, np.concatenate([self._lengths, np.ones(n)])).astype(np.int64)
        known = np.zeros(len(lengths), np.bool_)
        known[:kept] = self._stuck
        values = values[first]
        found = known | (self._by_travel(values, lengths) if self._travels else lengths > self._longest)
        at = np.flatnonzero(found[:kept] & ~known[:kept])
        before = NONE
        if len(at):
            old = np.append(np.cumsum(self._lengths[::-1])[::-1], 0)  # readings from each run on to the end of what was
            before = slice(-int(old[at[0]]), -int(old[at[-1] + 1]))
        self._values, self._lengths, self._stuck = values[-_RUNS:], lengths[-_RUNS:], found[-_RUNS:]
        return found[run[kept:]], before

    def _differ(self, readings: NDArray[np.float64]) -> bool:
        """Whether every reading differs from the one before, and no run before them can be judged by them."""
        if not len(self._lengths) or (self._travels and self._lengths.max() >= self._shortest):
            return False
        same = readings[1:] == readings[:-1]
        first = readings[0] == self._values[-1]
        if same.shape[1] == 1:
            return not (first[0] or same.any())
        return not (first.all() or same.all(axis=1).any())

    def _by_travel(self, values: NDArray[np.float64], lengths: NDArray[np.int64]) -> BoolArray:
        step = np.diff(values[:, 0])  # from each run to the next
        found = np.zeros(len(values), np.bool_)
        for k in np.flatnonzero(lengths >= self._shortest):
            if k >= 3 and (lengths[k - 2 : k] == 1).all():
                before, earlier = step[k - 1], step[k - 2]
                due = 2.0 * before - earlier
                found[k] = min(abs(before), abs(due)) >= _TRAVEL and before * due > 0.0
            if k + 2 < len(values) or (k + 2 == len(values) and lengths[k + 1] > 1):
                after = abs(step[k + 1]) if lengths[k + 1] == 1 else 0.0
                found[k] |= abs(step[k]) > _TRAVEL + TRAVELS * after
        return found
