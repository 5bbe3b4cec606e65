"""Reduces signals of any length for plots in constant memory: envelopes over time bins, and every k-th row.

Both start at full resolution and halve it whenever they are full, so the length need not be known beforehand.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.estimation.arrays import FloatArray


class Trace(NamedTuple):
    """Mean and extremes of a signal's columns over n time bins."""

    time_s: FloatArray  # (n,) middle of the bin
    low: FloatArray  # (n, columns)
    mean: FloatArray
    high: FloatArray


class Envelope:
    """Minimum, mean and maximum per time bin.

    Args:
        start_ns: start of the first bin, which also takes earlier values.
        columns: number of columns of the signal.
        bins: largest number of bins, rounded up to even.
        width_ns: initial width of a bin.
    """

    def __init__(self, start_ns: int, columns: int, bins: int = 2048, width_ns: int = 1_000_000) -> None:
        self._start_ns, self._width_ns = start_ns, width_ns
        bins += bins % 2  # neighbours merge by pairs
        self._low: FloatArray = np.full((bins, columns), np.inf)
        self._high: FloatArray = np.full((bins, columns), -np.inf)
        self._sum: FloatArray = np.zeros((bins, columns))
        self._count: FloatArray = np.zeros((bins, columns))

    def add(self, at_ns: NDArray[np.int64], values: FloatArray) -> None:
        """Add values (n, columns); NaN is ignored."""
        if not len(at_ns):
            return
        while (int(at_ns.max()) - self._start_ns) // self._width_ns >= len(self._low):
            self._halve()
        bins = np.maximum((at_ns - self._start_ns) // self._width_ns, 0)
        if (np.diff(bins) < 0).any():
            order = np.argsort(bins, kind="stable")
            bins, values = bins[order], values[order]
        first = np.flatnonzero(np.diff(bins, prepend=-1))
        where, known = bins[first], np.isfinite(values)
        self._low[where] = np.minimum(self._low[where], np.minimum.reduceat(np.where(known, values, np.inf), first))
        self._high[where] = np.maximum(self._high[where], np.maximum.reduceat(np.where(known, values, -np.inf), first))
        self._sum[where] += np.add.reduceat(np.where(known, values, 0.0), first)
        self._count[where] += np.add.reduceat(known, first, dtype=np.float64)

    def _halve(self) -> None:
        half = len(self._low) // 2

        def pairs(a: FloatArray) -> FloatArray:
            return a[: 2 * half].reshape(half, 2, -1)

        for array, merged, empty in (
            (self._low, pairs(self._low).min(axis=1), np.inf),
            (self._high, pairs(self._high).max(axis=1), -np.inf),
            (self._sum, pairs(self._sum).sum(axis=1), 0.0),
            (self._count, pairs(self._count).sum(axis=1), 0.0),
        ):
            array[:half], array[half:] = merged, empty
        self._width_ns *= 2

    def trace(self, zero_ns: int) -> Trace:
        """The non-empty bins, with times relative to ``zero_ns``."""
        full = self._count.any(axis=1)
        count = self._count[full]
        known = count > 0
        middle = self._start_ns - zero_ns + (np.flatnonzero(full) + 0.5) * self._width_ns
        mean: FloatArray = np.divide(self._sum[full], count, out=np.full_like(count, np.nan), where=known)
        low: FloatArray = np.where(known, self._low[full], np.nan)
        high: FloatArray = np.where(known, self._high[full], np.nan)
        time_s: FloatArray = (middle * 1e-9).astype(np.float64)
        return Trace(time_s, low, mean, high)


class Thinned:
    """Every k-th row of a channel (k as small as ``capacity`` allows), and the last one."""

    def __init__(self, capacity: int = 2000) -> None:
        self._capacity, self._stride, self._seen, self._kept = capacity, 1, 0, 0
        self._parts: list[Rows] = []
        self._last: Rows | None = None

    def add(self, rows: Rows) -> None:
        """Add the next rows (n,)."""
        if not len(rows):
            return
        part = rows[-self._seen % self._stride :: self._stride].copy()
        self._seen += len(rows)
        self._last = rows[-1:].copy()
        self._parts.append(part)
        self._kept += len(part)
        while self._kept > self._capacity:
            self._parts = [np.concatenate(self._parts)[::2]]
            self._kept, self._stride = len(self._parts[0]), 2 * self._stride

    @property
    def rows(self) -> Rows | None:
        """The rows kept; None if there are none."""
        if self._last is None:
            return None
        kept = np.concatenate(self._parts)
        return kept if (self._seen - 1) % self._stride == 0 else np.concatenate([kept, self._last])
