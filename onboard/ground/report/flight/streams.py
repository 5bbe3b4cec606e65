"""What samples say of their instrument and its clock: spectra by Welch's method, and the intervals between them.

Both take the rows in blocks, in constant memory. Samples are taken as evenly spaced between gaps.
"""

from typing import NamedTuple

import numpy as np

from drivers.records import Rows
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.ground.log.tables.thin import Thinned

SEGMENT = 1024  # samples of a segment of Welch's method, half of which the next one shares
_INTERVALS_KEPT = 20_000
_INTERVAL = np.dtype([("ns", "<i8")])
_WINDOW = np.hanning(SEGMENT + 1)[:-1]


class Spectrum:
    """Mean periodogram of Hann-windowed segments, each without its mean (Welch 1967).

    Args:
        columns: of the signal.
    """

    def __init__(self, columns: int) -> None:
        self._sum: FloatArray = np.zeros((SEGMENT // 2 + 1, columns))
        self.segments = 0

    def add(self, sequence: np.ndarray, values: FloatArray) -> None:
        """Take in a block: sequence numbers (n,) and values (n, columns); a segment has no gap and no NaN."""
        broken = np.diff(sequence.astype(np.int64), prepend=int(sequence[0]) - 1) != 1
        unusable: BoolArray = np.isfinite(values).all(axis=1) == np.False_
        start = 0
        for stop in [*np.flatnonzero(broken | unusable).tolist(), len(values)]:
            for first in range(start, stop - SEGMENT + 1, SEGMENT // 2):
                part = values[first : first + SEGMENT]
                swing = np.fft.rfft((part - part.mean(axis=0)) * _WINDOW[:, None], axis=0)
                self._sum += np.abs(swing) ** 2
                self.segments += 1
            start = stop + 1 if stop < len(values) and unusable[stop] else stop

    def density(self, rate_hz: float) -> tuple[FloatArray, FloatArray]:
        """Frequencies (f,) Hz without zero, and the amplitude spectral density (f, columns), unit/sqrt(Hz), one-sided.

        Args:
            rate_hz: of the samples.
        """
        scale = 2.0 / (rate_hz * float(_WINDOW @ _WINDOW) * max(self.segments, 1))
        frequency = np.linspace(rate_hz / SEGMENT, rate_hz / 2, SEGMENT // 2)
        return np.asarray(frequency, np.float64), np.asarray(np.sqrt(scale * self._sum[1:]), np.float64)


class IntervalStatistics(NamedTuple):
    """Times between neighbouring samples, ns; ``kept`` is every k-th of them."""

    kept: FloatArray  # (n,)
    least: float
    most: float

    @property
    def median(self) -> float:
        """Of those kept."""
        return float(np.median(self.kept))

    @property
    def rms(self) -> float:
        """Standard deviation of those kept."""
        return float(self.kept.std())

    def percentiles(self) -> tuple[float, float]:
        """0.5 % and 99.5 % of those kept."""
        low, high = np.percentile(self.kept, (0.5, 99.5))
        return float(low), float(high)


class Intervals:
    """Intervals of a stream by arrival and by its own tick, only between samples with nothing missing between them."""

    def __init__(self) -> None:
        self._of = {field: Thinned(_INTERVALS_KEPT) for field in ("host_ns", "tick")}
        self._ends: dict[str, tuple[int, int]] = {}

    def add(self, rows: Rows) -> None:
        """Take in a block of rows with ``sequence``, ``host_ns``, ``tick``."""
        follows: BoolArray = np.diff(rows["sequence"].astype(np.int64)) == 1
        for field, thinned in self._of.items():
            steps = np.diff(rows[field].astype(np.int64))[follows]
            steps = steps[steps >= 0]  # a tick that goes back is a reset of the device
            if len(steps):
                thinned.add(steps.view(_INTERVAL))
                low, high = self._ends.get(field, (int(steps.min()), int(steps.max())))
                self._ends[field] = min(low, int(steps.min())), max(high, int(steps.max()))

    def arrival(self) -> IntervalStatistics | None:
        """By ``host_ns``; None for fewer than two rows that follow each other."""
        return self._statistics("host_ns", 1.0)

    def sampled(self, period_ns: float) -> IntervalStatistics | None:
        """By the device's ticks of ``period_ns``."""
        return self._statistics("tick", period_ns)

    def _statistics(self, field: str, factor: float) -> IntervalStatistics | None:
        rows = self._of[field].rows
        if rows is None:
            return None
        low, high = self._ends[field]
        return IntervalStatistics(rows["ns"] * factor, low * factor, high * factor)
