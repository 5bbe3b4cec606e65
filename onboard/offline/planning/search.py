"""Finds the coefficients of a motion: drawn starts, then quasi-Newton descent with limits as penalties, then a check.

Descent is scipy's L-BFGS-B with derivatives by differences; its bounds keep the angles, a penalty the other limits. The
motion found is shrunk towards its posture until it keeps every limit on fine ticks.
"""

from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.offline.planning.bound import TICK_HZ, Bound
from onboard.offline.planning.criteria import Criterion, cost
from onboard.offline.planning.limits import Limits
from onboard.offline.planning.splines import Splines

FINE_HZ = 50.0  # of the check
_PENALTY = 100.0  # times the mean square excess of each limit
_STEP = 1e-4  # of the way to a joint's limit, for derivatives
_DRAWN = 0.5  # of the way to a joint's limit: standard deviation of a start's coefficients
_HALVINGS = 10


class Search(NamedTuple):
    """Where a motion is looked for."""

    bound: Bound
    limits: Limits
    splines: Splines
    chosen: tuple[int, ...]  # of the bound's quantities
    criterion: Criterion = Criterion.D


class Found(NamedTuple):
    """The motion."""

    coefficients: FloatArray  # (size, joints), about the posture
    cost: float
    start_cost: float  # of the best start, kept within the limits
    evaluations: int


def search(
    over: Search, starts: int, iterations: int, rng: np.random.Generator, step: Callable[[float], None]
) -> Found:
    """Look for the motion.

    Args:
        over: what.
        starts: drawn; the better half of them, two at most, are gone on with.
        iterations: of each descent; 0: the best that was drawn.
        rng: draws the starts.
        step: is told the share that is done, 0 to 1.

    Raises:
        ConfigError: the posture leaves a joint no room.
    """
    problem = _Problem(over)
    drawn = [problem.kept(problem.draw(rng), coarse=True) for _ in range(starts)]
    drawn.sort(key=problem.value)
    best = problem.kept(drawn[0])
    best_value = start_value = problem.value(best)
    gone_on = drawn[: max(1, min(2, starts // 2)) if iterations else 0]
    bounds = list(zip(problem.low.tolist(), problem.high.tolist(), strict=True))
    rounds = count(1)

    def told(_: FloatArray) -> None:
        step(min(1.0, next(rounds) / (iterations * len(gone_on))))

    how: Any = {"callback": told, "options": {"maxiter": iterations, "maxfun": 10**9}}
    for x in gone_on:
        result = minimize(
            problem.slope,
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            **how,
        )
        kept = problem.kept(result.x)
        value = problem.value(kept)
        if value < best_value:
            best, best_value = kept, value
    step(1.0)
    return Found(problem.coefficients(best), best_value, start_value, problem.evaluations)


class _Problem:
    """Cost and limits as functions of the coefficients, each in units of the way to its joint's limit."""

    def __init__(self, over: Search) -> None:
        self._over, splines = over, over.splines
        low, high = over.limits.room(splines.posture)
        self._unit = np.minimum(-low, high)
        joints = len(low)
        self._shape = splines.size, joints
        self.low = np.tile(low / self._unit, splines.size)
        self.high = np.tile(high / self._unit, splines.size)
        self._coarse = self._grid(TICK_HZ)
        self._fine = self._grid(FINE_HZ)
        self.evaluations = 0

    def _grid(self, rate_Hz: float) -> tuple[FloatArray, float]:
        ticks = round(self._over.splines.duration_s * rate_Hz)
        return self._over.splines.basis(np.arange(ticks) / rate_Hz), 1.0 / rate_Hz

    def coefficients(self, x: FloatArray) -> FloatArray:
        """Of the splines."""
        return np.asarray(x.reshape(self._shape) * self._unit, np.float64)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """A start, clipped to the angles' limits."""
        return np.clip(_DRAWN * rng.standard_normal(len(self.low)), self.low, self.high)

    def value(self, x: FloatArray) -> float:
        """Cost and penalty."""
        basis, period_s = self._coarse
        moved = self._over.splines.move(basis, self.coefficients(x))
        self.evaluations += 1
        found = self._over.bound.of(moved)
        chosen = list(self._over.chosen)
        own = cost(found.covariance[np.ix_(chosen, chosen)], self._over.bound.scales[chosen], self._over.criterion)
        broken = np.maximum(self._over.limits.excess(moved, found.base, period_s), 0.0)
        return own + _PENALTY * float(np.mean(broken**2, axis=0).sum())

    def slope(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Cost and its derivatives by forward differences."""
        here, out = self.value(x), np.zeros(len(x))
        for k in range(len(x)):
            step = _STEP if x[k] + _STEP <= self.high[k] else -_STEP
            moved = x.copy()
            moved[k] += step
            out[k] = (self.value(moved) - here) / step
        return here, out

    def kept(self, x: FloatArray, coarse: bool = False) -> FloatArray:
        """The largest share of a motion that keeps all limits: all of it, or found by bisection.

        Args:
            x: the motion.
            coarse: on the ticks of the search only.

        Raises:
            ConfigError: the posture itself does not keep them, or no motion does.
        """
        if self._keeps(x, coarse):
            return x
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._keeps(middle * x, coarse) else (low, middle)
        for share, said in ((0.0, "at rest in its posture the vehicle breaks"), (high, "the smallest motion breaks")):
            broken = self._excess(share * x, coarse).max(axis=0) if low == 0.0 else np.zeros(0)
            names = [name for name, by in zip(self._over.limits.names, broken.tolist(), strict=False) if by > 0.0]
            if names:
                raise config.ConfigError(f"limits: {said}: {', '.join(names)}; widen them")
        return low * x

    def _keeps(self, x: FloatArray, coarse: bool) -> bool:
        return bool((self._excess(x, coarse) <= 0.0).all())

    def _excess(self, x: FloatArray, coarse: bool) -> FloatArray:
        basis, period_s = self._coarse if coarse else self._fine
        moved = self._over.splines.move(basis, self.coefficients(x))
        return self._over.limits.excess(moved, self._over.bound.base(moved, period_s), period_s)
