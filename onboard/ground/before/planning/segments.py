"""Library of short motions that a flight may ask for: planned for several payload masses, each from rest to rest.

Those planned for the heaviest payload keep the limits with every lighter one too, so that they are safe while nothing
is known; those for lighter ones are larger. What each tells is computed for each mass, so that the choice in flight is
a few products of matrices.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.config.methods import OF_A_FREE_BASE
from onboard.config.segments import Library
from onboard.dynamics.model.inertia import RigidBody
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.foresee.plan import plan_of
from onboard.ground.before.planning.bound import TICK_HZ, FreeBound
from onboard.ground.before.planning.limits import MotionLimits
from onboard.ground.before.planning.planning import (
    FEWEST_PIECES,
    FINE_HZ,
    PIECE_s,
    Search,
    Wanted,
    chosen_of,
    search,
    ticks_of,
)
from onboard.ground.before.planning.splines import Splines
from onboard.identification.free_flyer.segment_choice import reduced

KINDS = ("mass", "centre", "inertia", "all")
LADDER = (0.1, 0.3, 1.0, 3.0, 10.0)  # of the assumed payload's mass
_CSV_HZ = 100.0
_INDUCED = 0.7  # of the limit of the base's rate: the rest is for the rate that it has by itself
_SHRINK, _SHRINKS = 0.85, 40


def plan_segments(
    vehicle: config.Vehicle, rehearsed: Callable[[float], Any], wanted: Wanted, step: Callable[[float], None]
) -> Library:
    """Plan a library.

    Args:
        vehicle: its file.
        rehearsed: the rehearsal, as the simulator plans it, at ticks of so many seconds.
        wanted: of it; asked for is each of :data:`KINDS`, and masses are by :data:`LADDER` where none is given.
        step: is called with the share that is done.

    Raises:
        ConfigError: limits or payload do not fit the vehicle, or it has no free base.
    """
    if vehicle.prediction in (config.Prediction.ROWS, config.Prediction.PLANAR):
        raise config.ConfigError(f"{vehicle.label}: segments need {OF_A_FREE_BASE}")
    coarse = vehicle.with_row_rate(TICK_HZ)
    plan = plan_of(coarse, rehearsed(1.0 / TICK_HZ))
    if plan.payload is None:
        raise config.ConfigError("the rehearsal holds no payload; give the vehicle a payload_link")
    first, seconds = ticks_of(plan, wanted.start_s, wanted.end_s).start, wanted.end_s - wanted.start_s
    model = build_model(vehicle)
    masses = np.sort(wanted.masses or [plan.payload.mass_kg * by for by in LADDER])
    bodies = [scaled(plan.payload, float(mass)) for mass in masses]
    bounds = [FreeBound(coarse, plan._replace(payload=body), first, still=True) for body in bodies]
    rate = wanted.limits.base_rate_rad_s
    said = wanted.limits.model_copy(update={"base_rate_rad_s": None if rate is None else _INDUCED * rate})
    limits = [MotionLimits(model, said, body) for body in bodies]
    pieces = max(FEWEST_PIECES, round(seconds / PIECE_s))
    splines = Splines(plan.q[first], seconds, pieces)
    rng, names = np.random.default_rng(wanted.seed), list[str]()
    found: list[FloatArray] = []
    share = 1.0 / (len(masses) * len(KINDS))
    for at in reversed(range(len(masses))):
        for kind in KINDS:
            picked = chosen_of(bounds[at].names, () if kind == "all" else (kind,))
            over = Search(bounds[at], limits[at], splines, picked, wanted.criterion)
            own = search(over, wanted.starts, wanted.iterations, rng, lambda _: None).coefficients
            names.append(f"{kind}_{masses[at]:.3g}kg")
            found.append(_safe(own, splines, bounds, limits) if at == len(masses) - 1 else own)
            step(share * len(found))
    step(1.0)
    return _library(np.stack(found), tuple(names), masses, splines, bounds, limits, wanted)


def scaled(body: RigidBody, mass_kg: float) -> RigidBody:
    """A body of the same shape and density with another mass."""
    by = (mass_kg / body.mass_kg) ** (1.0 / 3.0)
    return RigidBody(mass_kg, body.centre_of_mass_m * by, body.inertia_kg_m2 * by**5)


class _Kept(NamedTuple):
    """How a motion stands to the limits with one payload."""

    base_rate: float  # rad/s, its own motion aside
    excess: float  # of the others, the worst
    name: str


def _kept(moved: FloatArray, bound: FreeBound, limits: MotionLimits) -> _Kept:
    base = bound.base(moved, 1.0 / FINE_HZ)
    excess = limits.excess(moved, base, 1.0 / FINE_HZ).max(axis=0)
    others = [k for k, name in enumerate(limits.names) if name != "base's rate"]
    worst = others[int(np.argmax(excess[others]))]
    rate = float(np.linalg.norm(base.rate_rad_s, axis=1).max())
    return _Kept(rate, float(excess[worst]), limits.names[worst])


def _safe(own: FloatArray, splines: Splines, bounds: list[FreeBound], limits: list[MotionLimits]) -> FloatArray:
    """A motion that keeps the limits with every payload, shrunk for it."""
    basis = splines.basis(np.arange(round(splines.duration_s * FINE_HZ)) / FINE_HZ)
    for _ in range(_SHRINKS):
        kept = [_kept(splines.move(basis, own), *of) for of in zip(bounds, limits, strict=True)]
        if all(one.excess <= 0.0 for one in kept):
            return own
        own = _SHRINK * own
    raise config.ConfigError(f"limits: no motion keeps {kept[-1].name} with every payload; widen it")


def _library(
    found: FloatArray,
    names: tuple[str, ...],
    masses: FloatArray,
    splines: Splines,
    bounds: list[FreeBound],
    limits: list[MotionLimits],
    wanted: Wanted,
) -> Library:
    ticks = round(splines.duration_s * _CSV_HZ) + 1
    time_s = np.arange(ticks) / _CSV_HZ
    shown, fine = splines.basis(np.minimum(time_s, splines.duration_s)), round(splines.duration_s * FINE_HZ)
    basis, coarse = (
        splines.basis(np.arange(n) / hz) for n, hz in ((fine, FINE_HZ), (round(splines.duration_s * TICK_HZ), TICK_HZ))
    )
    roots, kept = [], []
    for own in found:
        kept.append([_kept(splines.move(basis, own), *of) for of in zip(bounds, limits, strict=True)])
        roots.append([reduced(bound.whitened(splines.move(coarse, own)), bound.prior_sigma) for bound in bounds])
    most = max(len(root) for of in roots for root in of)
    padded = np.zeros((len(found), len(masses), most, len(bounds[0].unknowns)), np.float32)
    for k, of in enumerate(roots):
        for m, root in enumerate(of):
            padded[k, m, : len(root)] = root
    rate, middle = wanted.limits.base_rate_rad_s, bounds[len(bounds) // 2]
    noise = [middle.noise(splines.move(coarse, own)) for own in found]
    return Library(
        names=names,
        joints=limits[0].joints,
        time_s=time_s,
        q=np.stack([splines.move(shown, own)[0] for own in found]),
        ticks=np.full(len(found), ticks, np.int64),
        unknowns=bounds[0].unknowns,
        masses=masses,
        roots=padded,
        ticks_hz=TICK_HZ,
        sigma=np.stack([sigma for sigma, _ in noise]),
        cyclic=np.stack([cyclic for _, cyclic in noise]),
        base_rate=np.array([[one.base_rate for one in of] for of in kept]),
        excess=np.array([[one.excess for one in of] for of in kept]),
        breaks=tuple(tuple(one.name for one in of) for of in kept),
        most=np.inf if rate is None else rate,
    )
