"""Finds the coefficients of a motion: drawn starts, then sequential quadratic programming, then a check.

Descent is scipy's SLSQP with derivatives by differences: its bounds keep the angles, and a constraint each of the other
limits, the soft maximum of its excess over the ticks. The motion found is shrunk towards its posture until it keeps
every limit on fine ticks.
"""

from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.ground.before.planning.bound import TICK_HZ, Bound
from onboard.ground.before.planning.criteria import Criterion, cost
from onboard.ground.before.planning.limits import MotionLimits
from onboard.ground.before.planning.splines import Splines

FINE_HZ = 50.0  # of the check
_SHARPNESS = 50.0  # of the soft maximum, per unit of excess
_STEP = 1e-4  # of the way to a joint's limit, for derivatives
_DRAWN = 0.5  # of the way to a joint's limit: standard deviation of a start's coefficients
_HALVINGS = 10


class Search(NamedTuple):
    """Where a motion is looked for."""

    bound: Bound
    limits: MotionLimits
    splines: Splines
    chosen: tuple[int, ...]  # of the bound's quantities
    criterion: Criterion = Criterion.D


class SearchResult(NamedTuple):
    """The motion."""

    coefficients: FloatArray  # (size, joints), about the posture
    cost: float
    start_cost: float  # of the best start, kept within the limits
    evaluations: int


def search(
    over: Search, starts: int, iterations: int, rng: np.random.Generator, step: Callable[[float], None]
) -> SearchResult:
    """Look for the motion.

    Args:
        over: what.
        starts: drawn; the better half of them, two at most, are gone on with.
        iterations: of each descent; 0: the best that was drawn.
        rng: draws the starts.
        step: is called with the share that is done, 0 to 1.

    Raises:
        ConfigError: the posture leaves a joint no room.
    """
    problem = PlanningProblem(over)
    drawn = [problem.kept(problem.draw(rng), coarse=True) for _ in range(starts)]
    drawn.sort(key=problem.value)
    best = problem.kept(drawn[0])
    best_value = start_value = problem.value(best)
    gone_on = drawn[: max(1, min(2, starts // 2)) if iterations else 0]
    rounds = count(1)
    for x in gone_on:
        found = descend(problem, x, iterations, lambda _: step(min(1.0, next(rounds) / (iterations * len(gone_on)))))
        kept = problem.kept(found)
        value = problem.value(kept)
        if value < best_value:
            best, best_value = kept, value
    step(1.0)
    return SearchResult(problem.coefficients(best), best_value, start_value, problem.evaluations)


def descend(
    problem: "PlanningProblem", x: FloatArray, iterations: int, told: Callable[[FloatArray], None]
) -> FloatArray:
    """Coefficients, (n,), that are better than ``x``, (n,), or the same; a limit may still be broken a little.

    Args:
        problem: what is looked for.
        x: the start.
        iterations: at most.
        told: is called after each.
    """
    limits = {"type": "ineq", "fun": lambda at: -problem.values(at)[1:], "jac": lambda at: -problem.slopes(at)[1:]}
    how: Any = {
        "jac": lambda at: problem.slopes(at)[0],
        "method": "SLSQP",
        "bounds": list(zip(problem.low.tolist(), problem.high.tolist(), strict=True)),
        "constraints": [limits],
        "callback": told,
        "options": {"maxiter": iterations},
    }
    return np.clip(np.asarray(minimize(problem.value, x, **how).x, np.float64), problem.low, problem.high)


class PlanningProblem:
    """Cost and limits as functions of the coefficients, each in units of the way to its joint's limit.

    Attributes:
        low, high: of the coefficients, (n,).
        evaluations: of the cost so far.
    """

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
        self._at: FloatArray | None = None  # of the last values
        self._slopes_at: FloatArray | None = None
        self._values = self._slopes = np.zeros(0)

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
        """Cost."""
        return float(self.values(x)[0])

    def values(self, x: FloatArray) -> FloatArray:
        """Cost, and of each limit the soft maximum of its excess over the ticks of the search, (1 + limits,)."""
        if self._at is None or not np.array_equal(x, self._at):
            own, excess = self.cost_and_excess(x)
            most = excess.max(axis=0)
            soft = most + np.log(np.exp(_SHARPNESS * (excess - most)).sum(axis=0)) / _SHARPNESS
            self._at, self._values = x.copy(), np.concatenate([[own], soft])
        return self._values

    def slopes(self, x: FloatArray) -> FloatArray:
        """Derivatives of :meth:`values` by forward differences, (1 + limits, n)."""
        if self._slopes_at is None or not np.array_equal(x, self._slopes_at):
            here, columns = self.values(x), []
            for k in range(len(x)):
                step = _STEP if x[k] + _STEP <= self.high[k] else -_STEP
                moved = x.copy()
                moved[k] += step
                columns.append((self.values(moved) - here) / step)
            self._slopes_at, self._slopes = x.copy(), np.stack(columns, axis=1)
        return self._slopes

    def cost_and_excess(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Cost, and the excess of each limit at each tick of the search, (ticks, limits)."""
        basis, period_s = self._coarse
        moved = self._over.splines.move(basis, self.coefficients(x))
        self.evaluations += 1
        found = self._over.bound.of(moved)
        chosen = list(self._over.chosen)
        own = cost(found.covariance[np.ix_(chosen, chosen)], self._over.bound.scales[chosen], self._over.criterion)
        return own, self._over.limits.excess(moved, found.base, period_s)

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
