"""From a vehicle, its rehearsal and limits to the motion that tells most, and what is expected of it.

Finds the coefficients of a motion: drawn starts, then sequential quadratic programming, then a check.

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
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.plan import Foreseen, MotionPlan, plan_of
from onboard.ground.before.planning.bound import TICK_HZ, Bound, FreeBound, RowsBound
from onboard.ground.before.planning.criteria import Criterion, cost, weakest
from onboard.ground.before.planning.limits import LimitsFile, MotionLimits
from onboard.ground.before.planning.splines import Splines

FINE_HZ = 50.0  # of the check
_SHARPNESS = 50.0  # of the soft maximum, per unit of excess
_STEP = 1e-4  # of the way to a joint's limit, for derivatives
_DRAWN = 0.5  # of the way to a joint's limit: standard deviation of a start's coefficients
_HALVINGS = 10
PIECE_s = 1.0  # length of a spline's piece: motions up to some 0.5 Hz
FEWEST_PIECES = 6
_TOLD = 0.98  # share of the sigma at rest; a motion that leaves more does not determine the quantity


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


class Wanted(NamedTuple):
    """What is asked of a motion, or of each of a library's."""

    start_s: float  # in the rehearsal
    end_s: float
    asked: tuple[str, ...] = ()  # quantities by name, or by its first part (mass: m); all where none is named
    criterion: Criterion = Criterion.D
    limits: LimitsFile = LimitsFile()
    starts: int = 64
    iterations: int = 15
    seed: int = 1
    masses: tuple[float, ...] = ()  # kg, of a library's payloads


class PlannedMotion(NamedTuple):
    """The motion of a whole rehearsal, and what is expected of it."""

    joints: tuple[str, ...]
    time_s: FloatArray  # (n,) of the rehearsal
    q: FloatArray  # (n, joints)
    start_s: float
    end_s: float
    expected: Foreseen
    expected_before: Foreseen  # of the swings in its place
    along_s: FloatArray  # (m,) from the motion's start
    along_sigma: FloatArray  # (m, k)
    names: tuple[str, ...]  # of the k quantities that motion tells anything of
    scales: FloatArray  # (k,)
    untold: tuple[str, ...]  # those that it does not
    asked: tuple[str, ...]
    weakest: str
    found: SearchResult


def plan_motion(
    vehicle: config.Vehicle, rehearsed: Callable[[float], Any], wanted: Wanted, step: Callable[[float], None]
) -> PlannedMotion:
    """Plan the motion.

    Args:
        vehicle: its file.
        rehearsed: the rehearsal, as the simulator plans it, at ticks of so many seconds.
        wanted: of it.
        step: is called with the share that is done.

    Raises:
        ConfigError: quantities, limits or payload do not fit the vehicle, or no motion tells what is asked.
        SignalError: a motion with which nothing can be predicted.
    """
    coarse, fine = vehicle.with_row_rate(TICK_HZ), vehicle
    plan = plan_of(coarse, rehearsed(1.0 / TICK_HZ))
    ticks = ticks_of(plan, wanted.start_s, wanted.end_s)
    free = vehicle.prediction not in (config.Prediction.ROWS, config.Prediction.PLANAR)
    bound: Bound = FreeBound(coarse, plan, ticks.start) if free else RowsBound(coarse, plan, ticks)
    told = told_by(bound, np.stack([signal[ticks] for signal in (plan.q, plan.dq, plan.ddq)]))
    nuisance = () if wanted.asked else vehicle.file.estimation.nuisance
    wished = [k for k in chosen_of(bound.names, wanted.asked) if bound.names[k] not in nuisance]
    chosen = tuple(k for k in wished if told[k])
    if not chosen:
        raise config.ConfigError(f"no motion of {vehicle.label} tells {', '.join(bound.names[k] for k in wished)}")
    model = build_model(vehicle)
    pieces = max(FEWEST_PIECES, round((wanted.end_s - wanted.start_s) / PIECE_s))
    splines = Splines(plan.q[ticks.start], wanted.end_s - wanted.start_s, pieces)
    over = Search(bound, MotionLimits(model, wanted.limits, plan.payload), splines, chosen, wanted.criterion)
    found = search(over, wanted.starts, wanted.iterations, np.random.default_rng(wanted.seed), step)
    moved = splines.move(splines.basis(plan.time_s[ticks] - wanted.start_s), found.coefficients)
    covariance, (at, sigma) = bound.of(moved).covariance, bound.along(moved)
    picked = list(chosen)
    swung = plan_of(fine, rehearsed(1.0 / vehicle.file.estimation.row_rate_hz))
    whole = _with(swung, splines, found.coefficients, wanted)
    own = tuple(bound.names[k] for k in chosen)
    return PlannedMotion(
        joints=tuple(joint.name for joint in model.joints),
        time_s=whole.time_s,
        q=whole.q,
        start_s=wanted.start_s,
        end_s=wanted.end_s,
        expected=foresee(fine, whole),
        expected_before=foresee(fine, swung),
        along_s=at / TICK_HZ,
        along_sigma=sigma[:, told],
        names=tuple(np.array(bound.names)[told].tolist()),
        scales=bound.scales[told],
        untold=tuple(np.array(bound.names)[~told].tolist()),
        asked=own,
        weakest=weakest(covariance[np.ix_(picked, picked)], bound.scales[picked], own),
        found=found,
    )


def told_by(bound: Bound, moved: FloatArray) -> BoolArray:
    """Which quantities a motion of all joints, (3, n, joints), tells anything of, (k,).

    The sigma at rest is NaN where nothing determines the quantity there.
    """
    rest = np.zeros_like(moved)
    rest[0] = moved[0, 0]
    still, moving = (np.diag(bound.of(one).covariance) for one in (rest, moved))
    return np.asarray(np.sqrt(moving) < _TOLD * np.nan_to_num(np.sqrt(still), nan=np.inf), np.bool_)


def ticks_of(plan: MotionPlan, start_s: float, end_s: float) -> slice:
    """Ticks of a plan between two of its times."""
    first, last = np.searchsorted(plan.time_s, [start_s - 1e-9, end_s - 1e-9])
    return slice(int(first), int(last))


def _with(plan: MotionPlan, splines: Splines, coefficients: FloatArray, wanted: Wanted) -> MotionPlan:
    """A plan with the motion in its place."""
    ticks = ticks_of(plan, wanted.start_s, wanted.end_s)
    moved = splines.move(splines.basis(plan.time_s[ticks] - wanted.start_s), coefficients)
    return plan.moved(ticks, moved)


def chosen_of(names: tuple[str, ...], asked: tuple[str, ...]) -> tuple[int, ...]:
    """Quantities by name or by the first part of it.

    Raises:
        ConfigError: a name that is no quantity's.
    """
    if not asked:
        return tuple(range(len(names)))
    chosen: list[int] = []
    for name in asked:
        own = {"mass": "m", "centre": "c", "inertia": "I"}.get(name, name)
        found = [k for k, known in enumerate(names) if known == own or known.startswith(f"{own}_")]
        if not found:
            raise config.ConfigError(f"--for {name}: the quantities are mass, centre, inertia, {', '.join(names)}")
        chosen += found
    return tuple(dict.fromkeys(chosen))
