"""The last few seconds of a channel as arrays, with amortised shifts."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.estimation.arrays import FloatArray

STAMPS = np.dtype([("tick", "<i8"), ("host_ns", "<i8")])


class History:
    """Stamps (n,), values (n, columns) and what is wrong (n,) of the newest samples, ``capacity`` at least.

    Args:
        capacity: samples that are kept for certain before those of the newest append; memory for twice as many is held.
        columns: values of one sample.
    """

    def __init__(self, capacity: int, columns: int) -> None:
        self._capacity = capacity
        held = 2 * capacity
        self._stamps = np.zeros(held, STAMPS)
        self._values = np.zeros((held, columns))
        self._wrong = np.zeros(held, np.int64)
        self._end = 0

    def append(self, rows: Rows, values: NDArray[np.float64], wrong: NDArray[np.int64]) -> None:
        """Add samples: rows with ``tick`` and ``host_ns`` (n,), values (n, columns), reasons not to use them (n,)."""
        rows, values, wrong = rows[-self._capacity :], values[-self._capacity :], wrong[-self._capacity :]
        count = len(rows)
        if count == self._capacity:
            self._end = 0  # older samples lie before a gap
        if self._end + count > len(self._stamps):
            keep = slice(self._end - min(self._end, self._capacity), self._end)
            kept = keep.stop - keep.start
            for array in (self._stamps, self._values, self._wrong):
                array[:kept] = array[keep].copy()
            self._end = kept
        here = slice(self._end, self._end + count)
        for field in STAMPS.names or ():
            self._stamps[field][here] = rows[field]
        self._values[here], self._wrong[here] = values, wrong
        self._end += count

    def mark(self, which: slice, wrong: int, off: float = 0.0) -> None:
        """Samples, counted from the end (negative), turn out to be wrong for one more reason, where still held.

        Or too large by ``off``.
        """
        if which.start < which.stop:
            these = slice(max(0, self._end + which.start), max(0, self._end + which.stop))
            self._wrong[these] |= wrong
            self._values[these] -= off

    def clear(self) -> None:
        """Clear: the device's ticks restarted."""
        self._end = 0

    @property
    def stamps(self) -> Rows:
        """Device ticks and arrival stamps (n,), oldest first; dtype :data:`STAMPS`."""
        return self._stamps[: self._end]

    @property
    def values(self) -> NDArray[np.float64]:
        """Values (n, columns)."""
        return self._values[: self._end]

    @property
    def wrong(self) -> NDArray[np.int64]:
        """Why each sample may not be used (n,); 0 where it may."""
        return self._wrong[: self._end]


class RecentSamples(NamedTuple):
    """Samples of one channel that a step may need."""

    times_s: FloatArray  # (k,) since the first tick, the filter's delay not removed
    values: FloatArray  # (k, columns)
    wrong: NDArray[np.int64]  # (k,) GateReason
    gap_s: float  # longer ones between samples are gaps
    timing_s: float  # sigma of the times, common to all

    def is_with(self, other: "RecentSamples") -> bool:
        """Whether both were sampled at the same times, as well known."""
        same = self.times_s is other.times_s or np.array_equal(self.times_s, other.times_s)
        return same and self[3:] == other[3:]


class SampleTimes(NamedTuple):
    """Times of samples, of all channels with the same clock and ticks."""

    ticks: NDArray[np.generic]  # of the device
    times_s: FloatArray  # (k,) of what is near the estimator's ticks
    kept: NDArray[np.bool_] | None  # which have a time of their own; None: all
    near: slice  # of these
    late: bool  # some were taken later than their ticks say
    timing_s: float
