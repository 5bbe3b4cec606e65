"""Device clock from sync marks: vehicle time = offset + period x tick, with its uncertainty.

A mark bounds an event between two ticks of the device and between two vehicle times. The (offset, rate) pairs
consistent with all marks and with a bounded drift of the rate form a convex polygon (:mod:`onboard.timebase.polygon`).
The solution is the polygon's centroid (the mean for uniform quantisation error), its sigma that of the polygon. With N
marks the offset's uncertainty falls as 1/N, against 1/sqrt(N) for a mean, and an accepted mark cannot move the solution
out of the polygon.

The bound on the drift may be too small: the polygon is then wrong before it is empty. Two polygons with larger bounds
are kept beside it; the smallest bound that the marks do not contradict is used.

States follow the "time at the tone" model of flight software: a clock without marks, or with contradicting ones,
flywheels with a growing sigma and becomes invalid when that sigma is too large.
"""

import math
from abc import ABC, abstractmethod
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.timebase.polygon import NOTHING, Moments, Polygon, box, moments, moved, widen

DRIFT_PER_S = 100e-6 / 60.0  # 100 ppm per minute: a gyro-referenced oscillator warming up
CRYSTAL_DRIFT_PER_S = 1e-6 / 60.0
_SEARCH_NS = 1e9  # initial search range, narrowed by the first mark


class ClockState(IntEnum):
    """State of a clock."""

    ACQUIRING = 0
    LOCKED = 1
    FLYWHEEL = 2  # marks have stopped or contradict: extrapolated at the last rate, sigma growing
    INVALID = 3


class ClockSolution(NamedTuple):
    """Vehicle time of tick k is ``reference_ns + period_ns * (k - reference_tick)``."""

    reference_tick: float
    reference_ns: float
    period_ns: float
    sigma_ns: float  # of reference_ns
    sigma_period_ns: float
    residual_rms_ns: float
    marks: int
    state: ClockState


class Mark(NamedTuple):
    """An event after tick ``low`` and not after tick ``high``, between two vehicle times [ns]."""

    low: float
    high: float
    earliest_ns: int
    latest_ns: int


class _View(NamedTuple):
    """Polygon of the possible (time of ``tick`` minus ``base_ns`` [ns], rate error [ns/s])."""

    tick: float
    base_ns: int
    polygon: Polygon


class FlywheelingClock(ABC):
    """State of a clock that is fitted to marks or arrivals: FLYWHEEL without them, INVALID once its sigma is too large.

    Attributes:
        state: as of the last mark or call of :meth:`at`.
        flywheel_after_ns: time since the reference after which the clock flywheels.
        invalid_sigma_ns: sigma at which a flywheeling clock becomes invalid.
    """

    state: ClockState
    flywheel_after_ns: float
    invalid_sigma_ns: float
    _reference_ns: float  # vehicle time of the last mark or arrival that was used

    @abstractmethod
    def restart(self) -> None:
        """Restart from the nominal period."""

    @abstractmethod
    def tick_at(self, time_ns: int) -> float:
        """Fractional tick at vehicle time ``time_ns``."""

    @abstractmethod
    def sigma_ns(self, tick: float) -> float:
        """1-sigma of the vehicle time of ``tick`` [ns]."""

    @property
    def trusted(self) -> bool:
        """Whether the solution is valid: LOCKED or FLYWHEEL."""
        return self.state in (ClockState.LOCKED, ClockState.FLYWHEEL)

    def at(self, now_ns: int) -> ClockState:
        """The state at ``now_ns``."""
        if self.trusted and now_ns - self._reference_ns > self.flywheel_after_ns:
            self.state = ClockState.FLYWHEEL
            if self.sigma_ns(self.tick_at(now_ns)) > self.invalid_sigma_ns:
                self.restart()
                self.state = ClockState.INVALID
        return self.state


class DeviceClock(FlywheelingClock):
    """Fits one device's clock.

    Args:
        nominal_period_ns: data-sheet length of a tick; the true one may be ``tolerance`` off.
        tolerance: largest relative error of the nominal period.
        drift_per_s: largest change of the relative rate per second, as far as the marks agree with it.
        invalid_sigma_ns: sigma at which a flywheeling clock becomes invalid.
    """

    flywheel_after_ns = 1e9
    COMMON_SIGMA_NS = 7e3  # common delay of all marks (stamps are late, never early)
    MARKS_TO_LOCK = 5
    MARKS_HELD = 8
    REJECTS_TO_REACQUIRE = 4
    LARGER = (
        1.0,
        6.0,
        36.0,
    )  # bounds on the drift, in drift_per_s; the last by default is 0.75 K/s by 80 ppm/K (MPU-6050 PS 7.15)
    STRIKES = 2  # contradictions, less one for each MARKS_TO_TRUST marks, after which the next larger bound is used
    MARKS_TO_TRUST = 60  # that a smaller bound has to agree with before it is used again; twice as many each time
    LEAST_SHARE = 0.5  # of the sigma by the next larger bound (0.55 on average); less is a wrong polygon about to end
    HEAL = 0.05  # share of a refused mark's width by which the polygon grows, in case the polygon was wrong

    def __init__(
        self,
        nominal_period_ns: float,
        tolerance: float = 0.06,
        drift_per_s: float = DRIFT_PER_S,
        invalid_sigma_ns: float = 2e6,
    ) -> None:
        self.nominal_period_ns, self.tolerance, self._least_drift_per_s = nominal_period_ns, tolerance, drift_per_s
        self.invalid_sigma_ns = invalid_sigma_ns
        self.rejected = 0
        self.restart()

    def restart(self) -> None:
        """Restart from the nominal period: the device's tick restarted."""
        self.state = ClockState.ACQUIRING
        self.marks = 0
        self.residual_ns = 0.0
        self._residual_square = 0.0
        self._pending: list[Mark] = []
        self._refused: list[Mark] = []
        self._contradiction_ns = 0.0
        self._restart_with(_View(0, 0, box(-_SEARCH_NS, _SEARCH_NS, *self._rates)))

    @property
    def _rates(self) -> tuple[float, float]:
        return -self.tolerance * 1e9, self.tolerance * 1e9

    def mark(self, mark: Mark) -> bool:
        """Take a mark, in order of tick; returns whether it was accepted."""
        if self.state in (ClockState.ACQUIRING, ClockState.INVALID):
            return self._acquire(mark)
        left = self._taken(self._used, mark) if mark.high >= self._view.tick else self._view._replace(polygon=NOTHING)
        if not len(left.polygon):
            self._refuse(mark)
            return False
        self._residual(mark)
        self._set_all(left, mark)
        self._refused, self._contradiction_ns = [], 0.0
        self.marks += 1
        self.state = ClockState.LOCKED
        return True

    def suspect(self, error_ns: float = 0.0) -> None:
        """Flag evidence against this clock: it flywheels until the next mark that agrees with it.

        Args:
            error_ns: disagreement with a mark; if not 0 the clock is :attr:`contradicted` until then.
        """
        if self.state is ClockState.LOCKED:
            self.state = ClockState.FLYWHEEL
        self._contradiction_ns = max(self._contradiction_ns, error_ns)

    @property
    def contradicted(self) -> bool:
        """Whether a mark disagreed and none has agreed since: either the clock or the mark is wrong."""
        return self._contradiction_ns > 0.0

    @property
    def period_ns(self) -> float:
        """Length of a tick, ns."""
        return self.nominal_period_ns * (1.0 + self._moments.y * 1e-9)

    def time_ns(self, ticks: NDArray[np.generic] | float) -> NDArray[np.int64]:
        """Vehicle time [ns] of ``ticks`` (n,), int64 (n,)."""
        numbers = np.asarray(ticks)
        if numbers.dtype.kind in "ui":
            since = (numbers.astype(np.int64) - np.int64(self._whole_tick)) - (self._view.tick - self._whole_tick)
        else:
            since = numbers.astype(np.float64) - self._view.tick
        after = since * self.period_ns + self._moments.x
        times: NDArray[np.int64] = self._view.base_ns + np.rint(after).astype(np.int64)
        return times

    def tick_at(self, time_ns: int) -> float:
        """Fractional tick at vehicle time ``time_ns``."""
        return self._view.tick + (time_ns - self._view.base_ns - self._moments.x) / self.period_ns

    def sigma_ns(self, tick: float) -> float:
        """1-sigma of the vehicle time of ``tick`` [ns]: the polygon's plus the drift since or until the last mark."""
        at, s = self._moments, self._seconds(tick - self._view.tick)
        drifted_ns = 0.5e9 * self.drift_per_s * s * s
        possible = max(at.xx + 2.0 * at.xy * s + at.yy * s * s, self._least_sigma_ns**2)
        return math.sqrt(possible + drifted_ns**2 / 3.0 + self.COMMON_SIGMA_NS**2 + self._contradiction_ns**2)

    def blur(self, ticks: float) -> None:
        """Widen the polygon by ``ticks`` either way: the number of lost samples is uncertain."""
        self._pending = []
        if self.trusted:
            self._widen_all(ticks * self.period_ns)
            self.suspect()

    @property
    def solution(self) -> ClockSolution:
        """Solution at the last mark."""
        return self.solution_at(self._view.tick)

    def solution_at(self, tick: float) -> ClockSolution:
        """The solution referred to ``tick``."""
        drifted = self.drift_per_s * self._seconds(tick - self._view.tick)
        return ClockSolution(
            tick,
            self._reference_ns + (tick - self._view.tick) * self.period_ns,
            self.period_ns,
            self.sigma_ns(tick),
            self.nominal_period_ns * math.sqrt(1e-18 * self._moments.yy + drifted**2 / 3.0),
            math.sqrt(self._residual_square),
            self.marks,
            self.state,
        )

    # The polygon

    @property
    def drift_per_s(self) -> float:
        """The bound in use on the change of the relative rate per second."""
        return self._least_drift_per_s * self.LARGER[self._used]

    def _restart_with(self, view: _View) -> None:
        """Begin with the smallest bound."""
        self._used = self._strikes = self._since_strike = 0
        self._agreed, self._to_trust = [0] * len(self.LARGER), [self.MARKS_TO_TRUST] * len(self.LARGER)
        self._views = [view] * len(self.LARGER)
        self._use(0)

    def _taken(self, bound: int, mark: Mark) -> _View:
        """View of a bound at a later mark; an empty polygon if it contradicts the mark."""
        view = self._views[bound]
        seconds = self._seconds(mark.high - view.tick)
        advance_ns = (mark.high - view.tick) * self.nominal_period_ns
        whole_ns = math.floor(advance_ns)
        drift = 1e9 * self._least_drift_per_s * self.LARGER[bound] * seconds
        # the effect of a bounded drift on (offset, rate) lies in the sum of two segments: a steady drift, and one that
        # reverses half-way
        segments = [(0.5 * drift * seconds, drift), (0.25 * drift * seconds, 0.0)] if drift > 0.0 else []
        later = _View(mark.high, view.base_ns + whole_ns, view.polygon)
        shear = seconds, advance_ns - whole_ns
        return later._replace(polygon=moved(view.polygon, shear, segments, self._bounds(later, mark)))

    def _set_all(self, left: _View, mark: Mark) -> None:
        """All views after a mark that the one in use agrees with, ``left``; the view to use from now on."""
        used = self._used
        for bound in range(len(self._views)):
            view = left if bound == used else self._taken(bound, mark)
            self._agreed[bound] = self._agreed[bound] + 1 if len(view.polygon) else 0
            self._views[bound] = view if len(view.polygon) else left
        self._since_strike += 1
        if self._since_strike >= self.MARKS_TO_TRUST:
            self._strikes, self._since_strike = max(self._strikes - 1, 0), 0
        if used and self._agreed[used - 1] >= self._to_trust[used - 1]:
            self._strikes = 0
            self._use(used - 1)
        else:
            self._use(used)

    def _demote(self) -> None:
        """Use the next larger bound; the smaller one begins anew from its view."""
        if self._used + 1 < len(self._views):
            larger = self._used + 1
            self._views[:larger] = [self._views[larger]] * larger
            self._agreed[:larger] = [0] * larger
            self._to_trust[self._used] *= 2
            self._strikes = self._since_strike = 0
            self._use(larger)

    def _widen_all(self, by_ns: float) -> None:
        self._views = [view._replace(polygon=widen(view.polygon, by_ns, 0.0)) for view in self._views]
        self._use(self._used)

    def _use(self, bound: int) -> None:
        self._used, self._view = bound, self._views[bound]
        view = self._view
        self._whole_tick = math.floor(view.tick)
        self._moments: Moments = moments(view.polygon)
        self._reference_ns = view.base_ns + self._moments.x
        self._least_sigma_ns = 0.0
        if bound + 1 < len(self._views):
            self._least_sigma_ns = self.LEAST_SHARE * math.sqrt(moments(self._views[bound + 1].polygon).xx)

    def _seconds(self, ticks: float) -> float:
        return ticks * self.nominal_period_ns * 1e-9

    def _bounds(self, view: _View, mark: Mark, slack_ns: float = 0.0) -> list[tuple[float, float, float]]:
        """Lines that ``mark``, widened by ``slack_ns`` on both sides, cuts ``view`` by."""
        low, high = mark.low - view.tick, mark.high - view.tick
        latest_ns = mark.latest_ns - view.base_ns - low * self.nominal_period_ns + slack_ns
        earliest_ns = mark.earliest_ns - view.base_ns - high * self.nominal_period_ns - slack_ns
        return [(1.0, self._seconds(low), latest_ns), (-1.0, -self._seconds(high), -earliest_ns)]

    def _cut(self, view: _View, mark: Mark, slack_ns: float = 0.0) -> Polygon:
        """Intersection of ``view`` with ``mark`` widened by ``slack_ns`` on both sides."""
        return moved(view.polygon, lines=self._bounds(view, mark, slack_ns))

    def _residual(self, mark: Mark) -> None:
        middle_ns = mark.earliest_ns + (mark.latest_ns - mark.earliest_ns) // 2
        self.residual_ns = float(middle_ns - int(self.time_ns(0.5 * (mark.low + mark.high))))
        self._residual_square += 0.05 * (self.residual_ns**2 - self._residual_square)

    def _refuse(self, mark: Mark) -> None:
        self.rejected += 1
        middle_ns = mark.earliest_ns + (mark.latest_ns - mark.earliest_ns) // 2
        self.suspect(abs(middle_ns - int(self.time_ns(0.5 * (mark.low + mark.high)))))
        self._refused.append(mark)
        width_ns = (mark.high - mark.low) * self.period_ns + mark.latest_ns - mark.earliest_ns
        if len(self._refused) >= self.REJECTS_TO_REACQUIRE:
            refused, error_ns = self._refused, self._contradiction_ns
            self.restart()
            self.suspect(error_ns)
            for again in refused:
                self._acquire(again)
        else:
            self._widen_all(self.HEAL * width_ns)
            self._strikes, self._since_strike = self._strikes + 1, 0
            if self._strikes >= self.STRIKES:
                self._demote()

    # Acquisition

    def _acquire(self, mark: Mark) -> bool:
        """Lock if most of the last few marks agree on one offset and a rate within the tolerance."""
        earlier = [one for one in self._pending if one.high < mark.high]
        self._pending = [*earlier[1 - self.MARKS_HELD :], mark]
        agreeing, polygon = self._consensus()
        if agreeing < self.MARKS_TO_LOCK or 3 * agreeing < 2 * len(self._pending):
            return False
        self._restart_with(_View(mark.high, mark.latest_ns, polygon))
        self._pending, self._contradiction_ns = [], 0.0
        self.marks, self.state = agreeing, ClockState.LOCKED
        return True

    def _consensus(self) -> tuple[int, Polygon]:
        """Size of the largest set of pending marks consistent with the newest, and the polygon they leave."""
        *others, newest = self._pending
        everything = _View(newest.high, newest.latest_ns, box(-_SEARCH_NS, _SEARCH_NS, *self._rates))
        start = everything._replace(polygon=self._cut(everything, newest))
        best: tuple[int, Polygon] = (1, start.polygon)
        for first in range(len(others)):
            agreeing, view = 1, start
            for mark in [others[first], *others[:first], *others[first + 1 :]]:
                seconds = self._seconds(mark.high - newest.high)
                left = self._cut(view, mark, 0.5e9 * self.drift_per_s * seconds * seconds)
                if len(left):
                    agreeing, view = agreeing + 1, view._replace(polygon=left)
            best = max(best, (agreeing, view.polygon), key=lambda found: found[0])
        return best
