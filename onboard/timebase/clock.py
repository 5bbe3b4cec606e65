"""One device clock: vehicle time = offset + period x tick, with covariance, from marks.

A mark says "at tick k (a fraction for a quantised mark) the vehicle time was t, give or take sigma". The clock is a
two-state Kalman filter on (time at the last mark, period), the period a random walk: oscillators drift, they do not
jump. States follow the "time at the tone" model of flight software: a clock that has lost its marks flywheels with a
growing sigma, and one that cannot be trusted says so.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class ClockState(IntEnum):
    """May this clock be trusted?"""

    ACQUIRING = 0
    LOCKED = 1
    FLYWHEEL = 2  # marks have stopped: going on at the last rate, sigma growing
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
    """Tick ``tick`` of the device was at vehicle time ``time_ns``, 1-sigma ``sigma_ns``."""

    tick: float
    time_ns: int
    sigma_ns: float


class DeviceClock:
    """Fits one device's clock.

    Args:
        nominal_period_ns: data-sheet length of a tick; the true one may be ``tolerance`` off.
        tolerance: largest believable relative error of the nominal period.
        wander: random walk of the period, relative per sqrt(second) (1e-6 is 1 ppm in a second).
        flywheel_after_s: without marks for so long the clock flywheels.
        invalid_sigma_ns: a flywheeling clock is invalid when its sigma has grown to this.
    """

    MARKS_TO_LOCK = 4
    GATE_SIGMA = 5.0
    REJECTS_TO_REACQUIRE = 4

    def __init__(
        self,
        nominal_period_ns: float,
        tolerance: float = 0.06,
        wander: float = 1e-6,
        flywheel_after_s: float = 1.0,
        invalid_sigma_ns: float = 2e6,
    ) -> None:
        self.nominal_period_ns, self.tolerance, self.wander = nominal_period_ns, tolerance, wander
        self.flywheel_after_ns, self.invalid_sigma_ns = flywheel_after_s * 1e9, invalid_sigma_ns
        self.rejected = 0
        self.restart()

    def restart(self) -> None:
        """Forget everything but the data sheet: the device's tick began again."""
        self.state = ClockState.ACQUIRING
        self.marks = 0
        self._pending: list[Mark] = []
        self._tick, self._time_ns, self._period_ns = 0.0, 0.0, self.nominal_period_ns
        self._covariance: Floats = np.diag([1e18, (self.tolerance * self.nominal_period_ns) ** 2])
        self._residual_square, self._mark_square, self.consecutive_rejects = 0.0, 1e-9, 0

    def mark(self, mark: Mark) -> bool:
        """Take a mark in; returns whether it was believed. Marks come in order of tick."""
        if self.state is ClockState.ACQUIRING or self.state is ClockState.INVALID:
            return self._acquire(mark)
        time_ns, period_ns, covariance = self._propagated(mark.tick)
        innovation = mark.time_ns - time_ns
        variance = covariance[0, 0] + mark.sigma_ns**2
        if innovation**2 > self.GATE_SIGMA**2 * variance:
            self.rejected += 1
            self.consecutive_rejects += 1
            if self.consecutive_rejects >= self.REJECTS_TO_REACQUIRE:
                self.restart()
                self._pending.append(mark)
            return False
        gain = covariance[:, 0] / variance
        self._tick = mark.tick
        self._time_ns = time_ns + float(gain[0]) * innovation
        self._period_ns = period_ns + float(gain[1]) * innovation
        # Joseph form: stays positive definite however sharp the mark
        keep = np.eye(2) - np.outer(gain, [1.0, 0.0])
        self._covariance = keep @ covariance @ keep.T + np.outer(gain, gain) * mark.sigma_ns**2
        self.consecutive_rejects = 0
        self._residual_square += 0.05 * (innovation**2 - self._residual_square)
        self._mark_square = mark.sigma_ns**2
        self.marks += 1
        self.state = ClockState.LOCKED
        return True

    def at(self, now_ns: int) -> ClockState:
        """The state at ``now_ns``: marks that stay away end in FLYWHEEL, then INVALID."""
        if self.state in (ClockState.LOCKED, ClockState.FLYWHEEL):
            silence_ns = now_ns - self._time_ns
            if silence_ns > self.flywheel_after_ns:
                self.state = ClockState.FLYWHEEL
                _, _, covariance = self._propagated(self._tick + silence_ns / self._period_ns)
                if covariance[0, 0] > self.invalid_sigma_ns**2:
                    self.restart()
                    self.state = ClockState.INVALID
        return self.state

    @property
    def trusted(self) -> bool:
        """Whether :meth:`time_ns` means anything."""
        return self.state in (ClockState.LOCKED, ClockState.FLYWHEEL)

    def time_ns(self, ticks: NDArray[np.generic] | float) -> NDArray[np.int64]:
        """Vehicle time [ns] of ``ticks`` (n,), int64 (n,)."""
        since = (np.asarray(ticks, np.float64) - self._tick) * self._period_ns
        whole = int(self._time_ns)
        times: NDArray[np.int64] = whole + np.rint(since + (self._time_ns - whole)).astype(np.int64)
        return times

    def sigma_ns(self, tick: float) -> float:
        """1-sigma of the vehicle time of ``tick`` [ns]."""
        return float(np.sqrt(self._propagated(tick)[2][0, 0] + self._undithered))

    @property
    def _undithered(self) -> float:
        """Variance [ns^2] that the residuals of quantised marks should show and do not.

        Pulses that beat with the sample clock fall on one place in the sample period: the residuals are small, and the
        common error, which no number of marks averages out, is as large as what is missing from them.
        """
        return max(0.0, 1 - self._residual_square / (0.5 * self._mark_square)) * self._mark_square

    @property
    def solution(self) -> ClockSolution:
        """What is known now."""
        return ClockSolution(
            self._tick,
            self._time_ns,
            self._period_ns,
            float(np.sqrt(self._covariance[0, 0] + self._undithered)),
            float(np.sqrt(self._covariance[1, 1])),
            float(np.sqrt(self._residual_square)),
            self.marks,
            self.state,
        )

    def _propagated(self, tick: float) -> tuple[float, float, Floats]:
        """Time, period and covariance carried to ``tick``, the period walking on the way (forwards or back)."""
        steps = tick - self._tick
        transition = np.array([[1.0, steps], [0.0, 1.0]])
        seconds = abs(steps) * self._period_ns * 1e-9
        walk = (self.wander * self._period_ns) ** 2 * seconds
        noise = walk * np.array([[steps**2 / 3, steps / 2], [steps / 2, 1.0]])
        covariance = transition @ self._covariance @ transition.T + noise
        return self._time_ns + self._period_ns * steps, self._period_ns, covariance

    def _acquire(self, mark: Mark) -> bool:
        """Lock when the last few marks lie on one line whose slope the data sheet allows."""
        self._pending = [*self._pending, mark][-self.MARKS_TO_LOCK :]
        if len(self._pending) < self.MARKS_TO_LOCK:
            return False
        first = self._pending[0]
        ticks = np.array([m.tick - first.tick for m in self._pending])
        times = np.array([float(m.time_ns - first.time_ns) for m in self._pending])
        weights = 1.0 / np.array([m.sigma_ns for m in self._pending])
        design = np.column_stack([np.ones_like(ticks), ticks])
        normal = (design * weights[:, None]).T @ (design * weights[:, None])
        if np.linalg.cond(normal) > 1e20:
            return False
        covariance: Floats = np.asarray(np.linalg.inv(normal), np.float64)
        offset, period = covariance @ ((design * weights[:, None]).T @ (times * weights))
        residuals = times - design @ np.array([offset, period])
        believable = abs(period / self.nominal_period_ns - 1) < self.tolerance
        if not believable or np.any(np.abs(residuals) * weights > 3.0):
            return False
        self._tick, self._time_ns, self._period_ns = first.tick, first.time_ns + float(offset), float(period)
        self._covariance = covariance
        self._time_ns, self._period_ns, self._covariance = self._propagated(mark.tick)
        self._tick = mark.tick
        self._residual_square = float(np.mean(residuals**2))
        self._pending = []
        self.marks, self.state = self.MARKS_TO_LOCK, ClockState.LOCKED
        return True
