"""From a vehicle, its rehearsal and limits to the motion that tells most, and what is expected of it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.flight.estimate.problem.identification import build_model
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.plan import Foreseen, MotionPlan, plan_of
from onboard.ground.before.planning.bound import TICK_HZ, Bound, FreeBound, RowsBound
from onboard.ground.before.planning.criteria import Criterion, weakest
from onboard.ground.before.planning.limits import LimitsFile, MotionLimits
from onboard.ground.before.planning.search import Search, SearchResult, search
from onboard.ground.before.planning.splines import Splines

PIECE_s = 1.0  # length of a spline's piece: motions up to some 0.5 Hz
FEWEST_PIECES = 6
_TOLD = 0.98  # share of the sigma at rest; a motion that leaves more does not determine the quantity


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
    signals = [signal.copy() for signal in (plan.q, plan.dq, plan.ddq)]
    for signal, own in zip(signals, moved, strict=True):
        signal[ticks] = own
    return plan._replace(q=signals[0], dq=signals[1], ddq=signals[2])


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
