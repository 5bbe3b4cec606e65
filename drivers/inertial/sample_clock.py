"""Estimates how many samples a chip has made by a given instant, from FIFO counts and their host stamps.

Used for gap accounting only (vehicle time is made in ``onboard.timebase``). A count read at t with total N means ``t0 +
N P <= t < t0 + (N + 1) P``: the newest sample is less than one period old. P is the slope of t over N; t0 lies within
the intersection of the bounds of all reads. A stamp can be late (host preempted), never early: lags ``t - N P`` more
than a period behind the earliest are excluded. The instant of the request is a lower bound of the read, however late
its stamp. If all polls fall at the same phase of the sample period, the bounds stay one period apart and a count may be
off by one.

Totals after a gap depend on this clock's estimate. While the period is not known well enough for that, a new
segment begins: the slope is fitted within segments and t0 from the last one, so that a wrong count does not confirm
itself.
"""

import math
from collections import deque
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MOST_READS = 1024
FEWEST_READS = 32
LATE = 1.2  # periods behind the earliest lag
TRIMMINGS = 3
RESIDUAL = 0.3  # samples, rms: a read falls at a uniform phase of the sample period
SPREAD = 2000.0  # samples^2: the slope is known to 0.6 %, and so better than the nominal rate
SURE = 0.25  # samples: error of a gap's count below which the segment continues
PROMPT = 0.25  # periods: longest extra duration of a read used for the slope
FURTHEST_OFF = 0.15  # of the nominal period: the internal oscillator over temperature (PS 6.6)
NARROW = 0.35  # periods: width at which an onset is accepted


class _Fit(NamedTuple):
    period_ns: float
    spread: float  # samples^2 about the means of the segments; 0 while the period is nominal
    first_ns: float  # best estimate of t0 + N P minus t of the last read: between -P and 0 for a punctual stamp
    latest_ns: float  # its upper bound, unaffected by late stamps


class Onset:
    """Bounds of the instant x of the last sample before a FIFO start, from counts read after the start.

    A count c read between b and t means ``b - (c + 1) P < x <= t - c P``. A late stamp only widens the interval, and
    the next punctual read narrows it again.

    Args:
        before_ns: An instant before the FIFO was started.
        period_ns: Sample period P, ns.

    Attributes:
        reads: The reads, ``(not before, stamp, count)``.
        earliest_ns: x is later than this.
        latest_ns: x is not later than this.
    """

    def __init__(self, before_ns: int, period_ns: float) -> None:
        self._period_ns = period_ns
        self._before_ns = before_ns
        self.reads: list[tuple[int, int, int]] = []
        self.earliest_ns = before_ns - period_ns
        self.latest_ns = math.inf

    def observe(self, host_ns: int, queued: int) -> None:
        """A count of ``queued`` samples, stamped ``host_ns`` and read after the stamp of the count before."""
        self.reads.append((self._before_ns, host_ns, queued))
        self.earliest_ns = max(self.earliest_ns, self._before_ns - (queued + 1) * self._period_ns)
        self.latest_ns = min(self.latest_ns, host_ns - queued * self._period_ns)
        self._before_ns = host_ns

    @property
    def settled(self) -> bool:
        """Further reads add nothing: the interval is narrow enough, or reads take no (simulated) time."""
        before_ns, host_ns, _ = self.reads[-1]
        return self.latest_ns - self.earliest_ns <= NARROW * self._period_ns or host_ns == before_ns


class SampleClock:
    """Total of samples as a function of host time.

    Args:
        nominal_period_ns: Sample period used until it is fitted.
    """

    def __init__(self, nominal_period_ns: int) -> None:
        self._period_ns = self._nominal_ns = float(nominal_period_ns)
        self._reads: deque[tuple[int, int, int, int]] = deque(maxlen=MOST_READS)  # last field: its segment
        self._segment = 0
        self._fitted: _Fit | None = None  # of the reads; None: they have changed

    def __bool__(self) -> bool:
        return bool(self._reads)

    @property
    def slope_known(self) -> bool:
        """Whether the period is fitted from the stream rather than nominal."""
        return bool(self._reads) and self._fit().spread > 0.0

    def observe(self, host_ns: int, produced: int, before_ns: int | None = None) -> None:
        """Add a count after which ``produced`` samples have been made.

        Args:
            host_ns: Its stamp.
            produced: Samples made when it was read.
            before_ns: Instant before the request; None: the stamp is taken as punctual.
        """
        self._reads.append((host_ns, produced, host_ns if before_ns is None else before_ns, self._segment))
        self._fitted = None

    def gap(self, samples: int) -> None:
        """Record a gap of ``samples`` by this clock; begins a new segment if that number is uncertain."""
        spread = self._fit().spread
        if samples * RESIDUAL > SURE * math.sqrt(spread):
            self._segment += 1

    def forget_phase(self) -> None:
        """The chip restarted sampling: keep the period, drop the reads."""
        self._period_ns = self.period_ns()
        self._reads.clear()
        self._fitted = None

    def period_ns(self) -> float:
        """Sample period, ns, or the last one known while reads are few."""
        return self._fit().period_ns if self._reads else self._period_ns

    def produced(self, host_ns: int) -> int:
        """Samples made by ``host_ns``; at least as many as the last read counted. Needs one read or more."""
        fit = self._fit()
        return self._made(host_ns, fit, fit.first_ns)

    def made_ns(self, totals: NDArray[np.int64]) -> NDArray[np.float64]:
        """When so many samples had just been made, host time (n,). Needs one read or more."""
        fit = self._fit()
        last_ns, last_produced, *_ = self._reads[-1]
        return np.asarray(last_ns + fit.first_ns + (totals - last_produced) * fit.period_ns, np.float64)

    def surely_produced(self, host_ns: int) -> int:
        """Lower bound of the samples made by ``host_ns``, valid for any delay of stamps. Needs one read or more."""
        fit = self._fit()
        return self._made(host_ns, fit, fit.latest_ns)

    def number_after(self, onset: Onset) -> int:
        """Number of the first sample after ``onset``. Needs one read or more."""
        fit = self._fit()
        last_ns, last_produced, *_ = self._reads[-1]
        middle_ns = (onset.earliest_ns + onset.latest_ns) / 2.0 - last_ns - fit.first_ns
        return last_produced + max(math.floor(middle_ns / fit.period_ns + 0.5), 0)

    def _made(self, host_ns: int, fit: _Fit, first_ns: float) -> int:
        last_ns, last_produced, *_ = self._reads[-1]
        return last_produced + max(int((host_ns - last_ns - first_ns) // fit.period_ns), 0)

    def _fit(self) -> _Fit:
        if self._fitted is None:
            self._fitted = self._fit_anew()
        return self._fitted

    def _fit_anew(self) -> _Fit:
        reads = np.fromiter(chain.from_iterable(self._reads), np.int64, 4 * len(self._reads)).reshape(-1, 4)
        t, n, before = (reads[:, :3] - (reads[-1, 0], reads[-1, 1], reads[-1, 0])).astype(float).T
        stretch = reads[:, 3] - reads[0, 3]
        newest = stretch == stretch[-1]
        t_newest, n_newest, before_newest = t[newest], n[newest], before[newest]
        took = t - before
        prompt = took <= np.median(took) + PROMPT * self._period_ns
        t, n, stretch = t[prompt], n[prompt], stretch[prompt]
        period, spread = self._period_ns, 0.0
        for _ in range(TRIMMINGS):
            sizes = np.maximum(np.bincount(stretch), 1)
            centred = n - (np.bincount(stretch, n) / sizes)[stretch]
            square = float(centred @ centred)
            if len(n) >= FEWEST_READS and square >= SPREAD:
                slope = float(centred @ t) / square
                if abs(slope / self._nominal_ns - 1.0) > FURTHEST_OFF:
                    break  # beyond any chip's tolerance: the counts are rejected
                period, spread = slope, square
            lags = t - n * period
            earliest_lags = np.full(len(sizes), np.inf)
            np.minimum.at(earliest_lags, stretch, lags)
            in_time = lags <= earliest_lags[stretch] + LATE * period
            if in_time.all():
                break
            t, n, stretch = t[in_time], n[in_time], stretch[in_time]
        latest = float((t_newest - n_newest * period).min())
        on_time = t_newest - n_newest * period <= latest + LATE * period
        stamped_only = before_newest == t_newest  # only the stamps bound it: exclude late ones
        bounds = (before_newest - n_newest * period)[on_time | ~stamped_only]
        earliest = float(bounds.max()) - period
        return _Fit(period, spread, (earliest + latest) / 2.0, latest)
