"""How many samples a chip has made by a given instant, from what its FIFO counts said so far.

Serves gap accounting only (vehicle time is made in ``onboard.timebase``). A count read at t that brings the total to
N says ``t0 + N P <= t < t0 + (N + 1) P``: the newest sample is less than one period old. P is the slope of t over N;
t0 lies between the bounds that all reads together leave. A late stamp (the host was preempted) can only be later than
true: lags ``t - N P`` more than a period behind the earliest are such, and are left out. Where the polls keep to one
place in the sample period the bounds stay a period apart, and a count may be one off.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

MOST_READS = 1024
FEWEST_READS = 32
LATE = 1.2  # periods behind the earliest lag
TRIMMINGS = 3


class _Fit(NamedTuple):
    period_ns: float
    first_ns: float  # t0 + N P for the N of the last read, after its t: between -P and 0


class SampleClock:
    """Sample total against host time.

    Args:
        nominal_period_ns: Sample period to go by until the stream has shown its own.
    """

    def __init__(self, nominal_period_ns: int) -> None:
        self._period_ns = float(nominal_period_ns)
        self._reads: deque[tuple[int, int]] = deque(maxlen=MOST_READS)

    def __bool__(self) -> bool:
        return bool(self._reads)

    def observe(self, host_ns: int, produced: int) -> None:
        """A FIFO count read at ``host_ns`` that brings the samples made so far to ``produced``."""
        self._reads.append((host_ns, produced))

    def forget_phase(self) -> None:
        """The chip's sampling began anew: keep the period, drop the reads."""
        self._period_ns = self.period_ns()
        self._reads.clear()

    def period_ns(self) -> float:
        """Sample period, ns, or the last one known while reads are few."""
        return self._fit().period_ns if self._reads else self._period_ns

    def produced(self, host_ns: int) -> int:
        """Samples made by ``host_ns``; at least as many as the last read counted. Needs one read or more."""
        fit = self._fit()
        last_ns, last_produced = self._reads[-1]
        return last_produced + max(int((host_ns - last_ns - fit.first_ns) // fit.period_ns), 0)

    def _fit(self) -> _Fit:
        reads = np.array(self._reads, np.int64)
        t, n = (reads - reads[-1]).astype(float).T
        period = self._period_ns
        slope_known = len(reads) >= FEWEST_READS
        for _ in range(TRIMMINGS):
            centred = n - n.mean()
            spread = float(centred @ centred)
            if slope_known and spread > 0.0:
                period = float(centred @ t) / spread
            lags = t - n * period
            in_time = lags <= lags.min() + LATE * period
            if in_time.all():
                break
            t, n = t[in_time], n[in_time]
        lags = t - n * period
        return _Fit(period, float(lags.min() + lags.max() - period) / 2.0)
