"""From a table of poses to an answer: the likeliest meaning, outliers left out, wrong axes tried, quantities."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr

from onboard.estimation.arrays import FloatArray, hat
from onboard.estimation.calibration import wrist, wrist_model
from onboard.estimation.calibration.wrist_model import Linearisation, Priors
from onboard.estimation.policy import INTERVAL, ODDS, ODDS_OF_PART
from onboard.ground.calibrate.weigh.changed import PART, BodyChange, change
from onboard.ground.calibrate.weigh.columns import Meaning
from onboard.ground.calibrate.weigh.conventions import DOWN, Known, Poses, Said, averaged, meanings, rotations, still
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, Causes, QuantityEstimate
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut

AXES = ("force x", "force y", "force z", "moment x", "moment y", "moment z")
MOST_POSES = 3000
_ROUGH = 5  # rounds of fits that are only compared
_RUN = 3  # equal readings, steps of a reading
IndexArray = NDArray[np.intp]


class SensorAxis(NamedTuple):
    """What one axis of the sensor says.

    Attributes:
        name: of it.
        alone_kg: mass by this axis alone, its zero taken as constant; NaN of a moment.
        alone_sigma_kg: likewise.
        mass_kg: mass by this axis, zero and cross-talk fitted; NaN of a moment.
        mass_sigma_kg: likewise.
        noise: 1 sigma of a pose, N or N m.
        zero: at the last pose.
        zero_sigma: likewise.
        moved: of the zero between the first and the last pose.
        moved_sigma: likewise.
        scale: fitted, in stated sigmas.
        frozen: it reads the same in poses that differ, as one that is stuck or saturated.
    """

    name: str
    alone_kg: float
    alone_sigma_kg: float
    mass_kg: float
    mass_sigma_kg: float
    noise: float
    zero: float
    zero_sigma: float
    moved: float
    moved_sigma: float
    scale: float
    frozen: bool


class WrenchError(NamedTuple):
    """The likeliest error in the axes of the wrench."""

    what: str
    nats: float  # of evidence over the axes as they are


class ChangedBody(NamedTuple):
    """Another body in some poses."""

    row: int  # of the table, counted from 0, that is the first with it
    body: BodyChange


@dataclass(frozen=True)
class Answer:
    """What a table tells, before it is judged."""

    known: Known  # by the likeliest direction of gravity, where nobody said
    said_down: bool
    poses: Poses  # used
    weighing: wrist.Weighing
    quantities: tuple[QuantityEstimate, ...]  # m, c_x, c_y, c_z, mounting, tilt
    axes: tuple[SensorAxis, ...]
    plain: tuple[float, float]  # mass by plain least squares of all forces, zeros constant, and its sigma, kg
    zeros: FloatArray  # (n, 6) at each pose
    outliers: tuple[int, ...]  # rows of the table, counted from 0
    rows: tuple[int, ...]  # first row of each pose that is used
    count: Mapping[str, int]  # rows: all, bad, moving; poses
    others: tuple[tuple[Any, float], ...]  # conventions and their evidence less that of the chosen one, nats
    wrong: WrenchError | None
    changed: ChangedBody | None
    held_out: HeldOut | None
    left_over: HeldOutFit  # of all readings, zeros apart
    unnamed: tuple[str, ...]  # `force`, `moment`, where nobody named a unit


def weigh(meaning: Meaning, known: Known, tell: Callable[[str], None] = lambda _: None) -> Answer:
    """Weigh.

    Args:
        meaning: of the table.
        known: besides it.
        tell: what is being done.

    Raises:
        PosesError: too few poses, or a meaning that a person has to say.
    """
    if meaning.kind == "up":
        known = known.by_up
    found = [(poses, _positive(one), count) for poses, one, count in _fits(meaning, known, tell)]
    most = max(one.evidence for _, one, _ in found)
    near = [each for each in found if each[1].evidence > most + np.log(ODDS)]
    poses, rough, count = near[0]
    said_down, known = known.down is not None, known._replace(down=poses.convention.down)
    prior, groups = known.prior, count.pop("groups")
    others = tuple((other.convention, one.evidence - rough.evidence) for other, one, _ in found)
    tell("whether it is a single body")
    first = wrist.fit(poses.R, poses.wrench, prior)
    changed = change(poses, prior, first)
    tell("rows that contradict the others")
    out = wrist.outliers(poses.R, poses.wrench, prior)
    if (~out).sum() < max(wrist.FEWEST, len(out) // 2):
        out = np.zeros_like(out)
    if out.any():
        poses = poses._replace(R=poses.R[~out], wrench=poses.wrench[~out])
        first = wrist.fit(poses.R, poses.wrench, prior)
    tell("what may be wrong with the axes")
    wrong = _wrong_axes(poses, prior, first, known.said)
    if wrong is None:
        _same_answer(near)
    tell("how sure it is")
    weighing = wrist.weigh(poses.R, poses.wrench, prior, first)
    rows = [int(group[0]) for group in groups]
    value, sigma, moved = wrist.zeros(weighing.best, wrist_model.jacobian(poses.R, weighing.best.state, prior))
    return Answer(
        known,
        said_down,
        poses,
        weighing,
        tuple(_answers(weighing, poses, prior, known)),
        tuple(_axes(weighing, poses, prior, (value, sigma, moved), known)),
        _plain(poses, prior, weighing.best, (0, 1, 2)),
        value,
        tuple(row for row, bad in zip(rows, out.tolist(), strict=True) if bad),
        tuple(row for row, bad in zip(rows, out.tolist(), strict=True) if not bad),
        count,
        others,
        wrong,
        changed and ChangedBody(int(groups[changed.at][0]), changed),
        _held_out(poses, prior, weighing.best),
        _left_over(poses, prior, weighing.best.noise, weighing.best.state),
        meaning.unnamed,
    )


def _fits(
    meaning: Meaning, known: Known, tell: Callable[[str], None]
) -> Iterator[tuple[Poses, wrist.PoseFit, dict[str, Any]]]:
    """A fit of each meaning."""
    ways = list(rotations(meaning))
    failed: Exception | None = None
    made = 0
    for orientation, R in ways:
        held = still(R, meaning.wrench)
        if len(held.groups) < wrist.FEWEST:
            failed = PosesError(
                f"{len(held.groups)} poses that can be used (of {len(R)} rows {held.bad} hold what is no number, "
                "or a quaternion or matrix that is no rotation): four or more are needed, and twelve or more with the "
                "wrist turned all ways are good"
            )
            continue
        if len(held.groups) > MOST_POSES:
            raise PosesError(f"{len(held.groups)} poses, {MOST_POSES} at most: average the rows of each pose")
        means = averaged(R, meaning.wrench, held.groups)
        count = {"rows": len(R), "bad": held.bad, "moving": held.moving, "poses": len(held.groups)}
        for poses in meanings(orientation, *means, known.said, known.down):
            tell(f"fit: {poses.convention.text}")
            down = poses.convention.down
            one = wrist.fit(poses.R, poses.wrench, known._replace(down=down).prior, _ROUGH)
            odds = 1.0 if down in (DOWN, known.down) else ODDS
            yield poses, one._replace(evidence=one.evidence + np.log(odds)), count | {"groups": held.groups}
            made += 1
    if not made:
        raise failed or PosesError("no orientation in any row: check the columns")


def _positive(one: wrist.PoseFit) -> wrist.PoseFit:
    """With the evidence that its mass is positive: one that is certainly not is of the other sign of the readings."""
    return one._replace(evidence=one.evidence + float(log_ndtr(one.state.mass / np.sqrt(one.covariance[0, 0]))))


def _same_answer(near: list[tuple[Poses, wrist.PoseFit, dict[str, Any]]]) -> None:
    """Refuse meanings that are as likely and answer otherwise.

    Raises:
        PosesError: there are such.
    """
    (poses, one, _), *rest = near
    for other, fit, _ in rest:
        both = [np.array([each.state.mass, *each.state.first_moment]) for each in (one, fit)]
        sigma = np.sqrt(np.diag(one.covariance + fit.covariance)[:4])
        if (np.abs(both[0] - both[1]) > 2.0 * sigma).any():
            options = [
                f"--{name}={getattr(poses.convention, name)} or {getattr(other.convention, name)}"
                for name in ("sense", "axes", "sign", "gravity")
                if getattr(poses.convention, name) != getattr(other.convention, name)
            ]
            if poses.convention.orientation != other.convention.orientation:
                options.append("--orientation (xyzw or wxyz, rotvec, xyz ...)")
            raise PosesError(
                f"the readings do not tell what the table means ({poses.convention.text}; or {other.convention.text}), "
                f"and the answers differ: {both[0][0]:.4g} and {both[1][0]:.4g} kg; say {', and '.join(options)}"
            )


def _body(state: Linearisation) -> FloatArray:
    """Mass and centre of mass, (4,)."""
    return np.concatenate([[state.mass], state.first_moment / state.mass])


def body_gradient(state: Linearisation) -> FloatArray:
    """Of mass and centre by the unknowns, (4, 45)."""
    out = np.zeros((4, wrist_model.UNKNOWNS))
    out[0, 0] = 1.0
    out[1:, wrist_model.FIRST_MOMENT] = np.eye(3) / state.mass
    out[1:, 0] = -state.first_moment / state.mass**2
    return out


def _body_covariance(one: wrist.PoseFit) -> FloatArray:
    G = body_gradient(one.state)
    return np.asarray(G @ one.covariance @ G.T, np.float64)


def _answers(weighing: wrist.Weighing, poses: Poses, prior: Priors, known: Known) -> Iterator[QuantityEstimate]:
    place = known.place
    relative = place.sigma_m_s2 / place.gravity_m_s2
    wide = wrist.prior_sigmas(poses.wrench, prior, weighing.best.noise.cross)
    causes = Causes(["scale_percent" if 9 <= k < 15 else "" for k in range(wrist_model.UNKNOWNS)], wide)
    G = body_gradient(weighing.best.state)
    told = weighing.best.covariance
    leans = causes.said(
        causes.effects(G @ told), np.sqrt(np.diag(G @ told @ G.T)), np.array([weighing.best.state.mass, 0.0, 0.0, 0.0])
    )
    known_mass = True
    for k, (name, unit) in enumerate((("m", "kg"), ("c_x", "m"), ("c_y", "m"), ("c_z", "m"))):
        means = [float(_body(one.state)[k]) for one in weighing.fits]
        sigmas = [float(np.sqrt(_body_covariance(one)[k, k])) for one in weighing.fits]
        if not k:
            sigmas = [float(np.hypot(s, relative * m)) for s, m in zip(sigmas, means, strict=True)]
        mean, sigma, low, high = wrist.interval(means, sigmas, weighing, INTERVAL)
        shrinkage = float(np.sqrt(told[k, k]) / wide[k])
        supported = shrinkage <= SUPPORTED_SHRINKAGE and known_mass
        if not k:
            known_mass = low > 0.0 or high < 0.0
            supported = supported and known_mass
        note = "" if supported else "not known: these poses do not tell it from the sensor's zeros; turn the wrist more"
        one = name, unit, mean, sigma, low, high, supported
        yield QuantityEstimate(*one, leans=leans[k], shrinkage=shrinkage, note=note)
    yield from _angles(weighing, wide)


def _angles(weighing: wrist.Weighing, wide: FloatArray) -> Iterator[QuantityEstimate]:
    """Installation angle about the sensor's z, the tilt of its z, and the base's tilt, rad."""
    one = weighing.best
    along = one.state.mounting[:, 2]  # the frame's z, in sensor axes
    axis = np.cross([0.0, 0.0, 1.0], along)
    sine = float(np.linalg.norm(axis))
    tilt = axis * (np.arctan2(sine, along[2]) / sine if sine > 0.0 else 0.0)
    about = (Rotation.from_rotvec(-tilt) * Rotation.from_matrix(one.state.mounting)).as_rotvec()[2]
    values = {
        "installation_z": (-about, 6),
        "installation_x": (-tilt[0], 4),
        "installation_y": (-tilt[1], 5),
        "base_tilt_1": (one.state.tilt[0], 7),
        "base_tilt_2": (one.state.tilt[1], 8),
    }
    for name, (value, k) in values.items():
        sigmas = [float(np.sqrt(each.covariance[k, k])) for each in weighing.fits]
        _, sigma, low, high = wrist.interval([float(value)] * len(sigmas), sigmas, weighing, INTERVAL)
        shrinkage = sigma / wide[k]
        told = name, "rad", float(value), sigma, low, high, shrinkage <= SUPPORTED_SHRINKAGE
        yield QuantityEstimate(*told, shrinkage=shrinkage, note="as stated before")


def _axes(
    weighing: wrist.Weighing,
    poses: Poses,
    prior: Priors,
    zeros: tuple[FloatArray, FloatArray, FloatArray],
    known: Known,
) -> Iterator[SensorAxis]:
    one, (value, sigma, moved) = weighing.best, zeros
    made = wrist_model.predicted(poses.R, one.state, prior)
    for k, name in enumerate(AXES):
        alone = mass = (np.nan, np.nan)
        if k < 3:
            alone = _plain(poses, prior, one, (k,))
            gradient = np.zeros(wrist_model.UNKNOWNS)
            gradient[[0, 9 + k]] = 1.0 + one.state.scales[k], one.state.mass
            gradient[27 + 3 * k : 30 + 3 * k] = hat(one.state.first_moment)[:, k] / wrist_model.REACH_m
            own = float(np.sqrt(gradient @ one.covariance @ gradient))
            mass = float(one.state.sensitivity[k, k]), own
        zero = float(value[-1, k]), float(sigma[k])
        change = float(value[-1, k] - value[0, k]), float(moved[k])
        scale, frozen = float(one.state.scales[k] / known.scale), _frozen(poses.wrench[:, k], made[:, k])
        yield SensorAxis(name, *alone, *mass, float(one.noise.sigma[k]), *zero, *change, scale, frozen)


def _plain(poses: Poses, prior: Priors, one: wrist.PoseFit, axes: tuple[int, ...]) -> tuple[float, float]:
    """Mass by plain least squares of some forces with constant zeros, and its sigma by what is left over, kg."""
    state = one.state._replace(mass=1.0, scales=np.zeros(6), cross=np.zeros(30))
    d = wrist_model.predicted(poses.R, state, prior)[:, axes]
    d, f = d - d.mean(axis=0), poses.wrench[:, axes] - poses.wrench[:, axes].mean(axis=0)
    squares = max(float((d**2).sum()), 1e-300)
    mass = float((d * f).sum()) / squares
    left = float(((f - mass * d) ** 2).sum()) / max(f.size - len(axes) - 1, 1)
    return mass, float(np.sqrt(left / squares))


def _wrong_axes(poses: Poses, prior: Priors, first: wrist.PoseFit, said: Said) -> WrenchError | None:
    """Signs turned and axes exchanged, of forces or of moments, as rivals of the axes as they are.

    One turned force with the weight is one turned moment with the reaction and a sensor mounted the other way round:
    both are named where both are as likely.
    """
    limit = first.evidence - np.log(ODDS_OF_PART)
    rivals: dict[str, float] = {}
    for (what, columns, signs), way in product(_errors(), (1.0, -1.0) if said.sign is None else (1.0,)):
        try:
            one = wrist.fit(poses.R, way * signs * poses.wrench[:, columns], prior, _ROUGH)
        except np.linalg.LinAlgError:
            continue
        if one.evidence > limit and one.state.mass > 0.0:
            rivals[what] = max(one.evidence - first.evidence, rivals.get(what, 0.0))
    if not rivals:
        return None
    most = max(rivals.values())
    near = [what for what, nats in rivals.items() if nats > most + np.log(ODDS)]
    return WrenchError(", or ".join(near), most)


def _errors() -> Iterator[tuple[str, IndexArray, FloatArray]]:
    """Names, columns and signs of a wrench that is read otherwise."""
    as_is, plus = np.arange(6), np.ones(6)
    for k, name in enumerate(AXES):
        signs = plus.copy()
        signs[k] = -1.0
        yield f"the sign of {name} is turned (--turned {'fm'[k // 3]}{'xyz'[k % 3]})", as_is, signs
    for first, (a, b) in product((0, 3), ((0, 1), (1, 2), (0, 2))):
        columns = as_is.copy()
        columns[[first + a, first + b]] = first + b, first + a
        yield f"{AXES[first + a]} and {AXES[first + b][-1]} are exchanged (--columns)", columns, plus


def _frozen(read: FloatArray, made: FloatArray) -> bool:
    """Whether three equal readings, in a row or at an end of all, are where poses make more than three of its steps.

    At an end none is in the three steps before it: noise of some steps brings a few of many poses there by chance.
    """
    steps = np.diff(np.unique(read))
    step = float(steps.min()) if steps.size else 0.0
    edges = np.flatnonzero(np.concatenate([[True], np.diff(read) != 0.0, [True]]))
    runs = [made[a:b] for a, b in pairwise(edges.tolist())]
    for end in (read.min(), read.max()):
        at_end = read == end
        if (np.abs(read - end)[~at_end] > (_RUN + 0.5) * step).all():
            runs.append(made[at_end])
    return any(len(run) >= _RUN and float(np.ptp(run)) > _RUN * step + 1e-12 for run in runs)


def _held_out(poses: Poses, prior: Priors, one: wrist.PoseFit) -> HeldOut | None:
    """Each half of the poses predicted from the other; zeros are the half's own."""
    n = len(poses.R)
    if n < 2 * PART:
        return None
    halves = slice(0, n // 2), slice(n // 2, n)
    states = [wrist.fit(poses.R[half], poses.wrench[half], prior).state for half in halves]

    def error(part: slice, state: Linearisation) -> HeldOutFit:
        return _left_over(poses._replace(R=poses.R[part], wrench=poses.wrench[part]), prior, one.noise, state)

    return HeldOut(error(halves[1], states[0]), error(halves[0], states[1]), error(slice(0, n), one.state))


def _left_over(poses: Poses, prior: Priors, noise: wrist.Noise, state: Linearisation) -> HeldOutFit:
    """Of what readings change by from pose to pose, and of their noise."""
    whitened = [
        wrist.coefficients(each) / np.sqrt(wrist.variances(noise, len(each)))
        for each in (poses.wrench - wrist_model.predicted(poses.R, state, prior), poses.wrench)
    ]
    left, whole = (float((each**2).sum()) for each in whitened)
    return HeldOutFit(float(np.sqrt(left / max(whole, 1e-300))), left / whitened[0].size)
