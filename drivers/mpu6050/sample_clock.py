"""How many samples a chip has made by a given instant, from what its FIFO counts said so far.

Serves gap accounting only (vehicle time is made in ``onboard.timebase``). A count read at t that brings the total to
N says ``t0 + N P <= t < t0 + (N + 1) P``: the newest sample is less than one period old. P is the slope of t over N;
t0 lies between the bounds that all reads together leave. A late stamp (the host was preempted) can only be later than
true: lags ``t - N P`` more than a period behind the earliest are such, and are left out. Nor can a read have been made
before it was asked for, so that instant bounds it from below, however late its stamp is. Where the polls keep to one
place in the sample period the bounds stay a period apart, and a count may be one off.

Totals after a gap are what this clock made of it. While the period is not known well enough for that, they begin a
stretch of their own: the slope is taken within stretches and t0 from the last one, lest a wrong count confirm itself.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

MOST_READS = 1024
FEWEST_READS = 32
LATE = 1.2  # periods behind the earliest lag
TRIMMINGS = 3
RESIDUAL = 0.3  # samples: a read falls anywhere in a sample period
SPREAD = 2000.0  # samples^2: the slope is known to 0.6 %, and so better than the nominal rate
SURE = 0.25  # samples by which the count of a gap may be off for its reads to go on the same stretch
PROMPT = 0.25  # periods a read may take longer than most, to be used for the slope
FURTHEST_OFF = 0.15  # of the nominal period: the internal oscillator over temperature (PS 6.6)
NARROW = 0.35  # periods: an onset known that well is known well enough


class _Fit(NamedTuple):
    period_ns: float
    spread: float  # samples^2 about the means of the stretches; 0 while the period is the nominal one
    first_ns: float  # best estimate of t0 + N P for the N of the last read, after its t: between -P and 0 if in time
    latest_ns: float  # its upper bound, which late stamps do not touch


class Onset:
    """When a chip made its last sample before its FIFO was started, from counts read after the start.

    A count of c read at t, and not before b, says ``b - (c + 1) P < x <= t - c P``. A late stamp widens that interval
    and never moves it, so the next read in time mends what it spoiled.

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
        """More reads at once would tell no more: it is known well, or reads take no time."""
        before_ns, host_ns, _ = self.reads[-1]
        return self.latest_ns - self.earliest_ns <= NARROW * self._period_ns or host_ns == before_ns


class SampleClock:
    """Sample total against host time.

    Args:
        nominal_period_ns: Sample period to go by until the stream has shown its own.
    """

    def __init__(self, nominal_period_ns: int) -> None:
        self._period_ns = self._nominal_ns = float(nominal_period_ns)
        self._reads: deque[tuple[int, int, int, int]] = deque(maxlen=MOST_READS)  # the last: its stretch
        self._stretch = 0

    def __bool__(self) -> bool:
        return bool(self._reads)

    @property
    def slope_known(self) -> bool:
        """The period is the stream's own and no longer the nominal one."""
        return bool(self._reads) and self._fit().spread > 0.0

    def observe(self, host_ns: int, produced: int, before_ns: int | None = None) -> None:
        """A count that brings the samples made so far to ``produced``.

        Args:
            host_ns: Its stamp.
            produced: Samples made when it was read.
            before_ns: When it had not yet been asked for; None: the stamp is taken to be in time.
        """
        self._reads.append((host_ns, produced, host_ns if before_ns is None else before_ns, self._stretch))

    def gap(self, samples: int) -> None:
        """So many samples were lost by what this clock says: are the totals from here on to be built on?"""
        spread = self._fit().spread
        if samples * RESIDUAL > SURE * math.sqrt(spread):
            self._stretch += 1

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
        return self._made(host_ns, fit, fit.first_ns)

    def surely_produced(self, host_ns: int) -> int:
        """Samples made by ``host_ns`` at the least, whatever the stamps were late by. Needs one read or more."""
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
        reads = np.array(self._reads, np.int64)
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
                    break  # no chip is: the counts are not to be believed
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
        stamped_only = before_newest == t_newest  # nothing but the stamp to go by: leave out what is late
        bounds = (before_newest - n_newest * period)[on_time | ~stamped_only]
        earliest = float(bounds.max()) - period
        return _Fit(period, spread, (earliest + latest) / 2.0, latest)
