"""``heft identify`` of a body without joints: its commands and its tracked pose, fitted in one batch."""

from collections.abc import Iterator
from contextlib import suppress
from functools import cache, reduce

import numpy as np
from scipy.special import stdtrit

from drivers.records import Rows, SampleStatus
from onboard import config
from onboard.devices.recorded import ThrusterKeys, thrusters_among, tracked_among
from onboard.estimation.arrays import PAUSE, FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.policy import HALF, INTERVAL, LARGEST_SIZE, MOST_CONTRADICTED, contradicted_text
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.body import body_model, key_of
from onboard.flight.estimate.problem.model import build_model, naming_the_file
from onboard.ground.identify.kinds.identified import Identified, judged, standings
from onboard.identification.body.fit import BODY, STATE, BodyFit, BodyModel, TrackedPoses
from onboard.identification.body.glitches import glitches
from onboard.identification.body.misread import others
from onboard.identification.body.stated import Valve, valve_of_on_times
from onboard.identification.corrections import contradicted, doubtful, expected_sigma, misfit_texts, together
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, Causes, Contribution, Findings, QuantityEstimate
from onboard.identification.verdict import Evidence
from onboard.identification.windows import SHORTEST, WINDOW_s
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader

_TOLD = "of what the motion tells"
_STEADY = ("body.uneven_sigma_m_s2", "body.uneven_sigma_m_s2", "body.turning_sigma_rad_s2")
_SENSORS = ("position", "yaw", "steady accelerations of the table")


def identify_body(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of a body without joints.

    Raises:
        ConfigError: the vehicle file does not fit the URDF.
        ChannelError: commands or poses that cannot be used.
    """
    with naming_the_file(vehicle):
        poses, valves, lost, moved = _recorded(vehicle, log)
        model = body_model(vehicle, build_model(vehicle), valves)
    names = (*model.names[:BODY], "delay")
    refused = {"jumped_and_back": lost} if lost else {}
    fit, failure = None, contradicted_text(lost / len(poses.time_s), "poses", "the tracker loses the body")
    if not failure:
        fit, failure = _fitted(model, poses)
    if fit is None:
        return judged(log, Evidence(len(poses.time_s), refused, dict.fromkeys(names, False), None, failure=failure))
    (answers, budget), findings = _answers(vehicle, model, fit), _findings(model, fit)
    evidence = Evidence(
        fit.found.rows,
        refused,
        {one.name: one.supported for one in answers if one.name in names},
        None,
        findings=findings.plus(doubts=moved),
        standings=standings(answers, useful_of(vehicle)),
        unchecked="",  # its windows are held against each other
    )
    return judged(log, evidence, answers, misfit=max(fit.found.by_sensor[:2]), budget=budget)


def _recorded(vehicle: config.Vehicle, log: LogReader) -> tuple[TrackedPoses, dict[str, Valve], int, tuple[str, ...]]:
    """Poses, valves by thruster, how many poses jump and come back, which are left out, and words for other jumps."""
    name, tracker = tracked_among(vehicle.file.device)
    units = {"x": b"m", "y": b"m", "yaw": b"rad"}
    rows = [_usable(log.read(f"{name}_{of}")) for of in units]
    common = reduce(np.intersect1d, [one["host_ns"] for one in rows])
    if len(common) < 2:
        raise ChannelError(
            f"{log.path}: {name} has no poses of x, y and yaw at the same times; give them the same clock"
        )
    start_ns = int(common[0])
    values = []
    for one, (of, unit) in zip(rows, units.items(), strict=True):
        if (read := one["unit"][0]) != unit:
            raise ChannelError(f"{log.path}: {name}_{of} is in {read.decode()!r}; it needs {unit.decode()!r}")
        values.append((one["value_raw"] * one["scale"])[np.isin(one["host_ns"], common)])
    time_s, measured = 1e-9 * (common - start_ns).astype(np.float64), np.stack(values, axis=1)
    noise = np.array([tracker.position_noise_m, tracker.position_noise_m, tracker.yaw_noise_rad])
    found = glitches(time_s, measured, noise)
    time_s, measured = time_s[found.good], measured[found.good]
    measured[:, 2] = np.unwrap(measured[:, 2])
    moved = tuple(
        f"the tracked pose jumps at {a:.2f} s by {1e3 * far:.0f} mm and stays there" for a, _, far in found.moved
    )
    poses = _fresh(time_s, measured) if not tracker.repeats else TrackedPoses(time_s, measured)
    valves, begin_s, end_s, unknown = dict[str, Valve](), -np.inf, np.inf, [(a, b) for a, b, _ in found.moved]
    for thruster, own in thrusters_among(vehicle.file.device).items():
        commands = _usable(log.read(thruster))
        if not len(commands):
            raise ChannelError(f"{log.path}: {thruster} has no commands; leave it out if it never pushed")
        time_s = 1e-9 * (commands["host_ns"] - start_ns).astype(np.float64)
        valves[thruster] = _valve(own, thruster, time_s, commands, log)
        begin_s, end_s = max(begin_s, float(time_s[0])), min(end_s, float(time_s[-1]) + 1e-3 * own.period_ms)
        if own.reads == "level":
            missed = np.flatnonzero(np.diff(time_s) > PAUSE * 1e-3 * own.period_ms)
            unknown += [(float(time_s[k]), float(time_s[k + 1])) for k in missed]
    poses = poses._replace(known_s=(begin_s, end_s), unknown=tuple(unknown))
    return poses, valves, found.lost, moved


def _fresh(time_s: FloatArray, measured: FloatArray) -> TrackedPoses:
    """Poses without those that repeat the one before.

    A recorder that is faster than the tracker repeats poses while the body moves: each came at any time since the row
    before, in the mean half of that earlier. Poses repeat at rest, too, by rounding, and by frames that are lost.
    """
    fresh = np.append(True, (np.diff(measured, axis=0) != 0.0).any(axis=1))
    poses = TrackedPoses(time_s[fresh], measured[fresh])
    if fresh.all() or len(poses.time_s) < SHORTEST:
        return poses
    speed = np.abs(np.gradient(poses.measured, poses.time_s, axis=0)) / np.ptp(poses.measured, axis=0)
    moving = np.interp(time_s, poses.time_s, fast := speed.max(axis=1)) > np.median(fast)
    if np.mean(~fresh[moving]) < MOST_CONTRADICTED:
        return poses
    late_s = float(np.median(np.diff(time_s)))
    return TrackedPoses(poses.time_s - 0.5 * late_s, poses.measured, late_s)


def _usable(rows: Rows) -> Rows:
    good: Rows = rows[rows["status"] == SampleStatus.OK]
    return good


def _valve(own: ThrusterKeys, name: str, time_s: FloatArray, rows: Rows, log: LogReader) -> Valve:
    values, unit = np.asarray(rows["value_raw"] * rows["scale"], np.float64), rows["unit"][0]
    if own.reads == "on_time":
        if unit != b"s":
            raise ChannelError(f"{log.path}: {name} is in {unit.decode()!r}; an on-time needs s: correct the mapping")
        return valve_of_on_times(time_s, values)
    if unit not in (b"1", b"N"):
        raise ChannelError(f"{log.path}: {name} is in {unit.decode()!r}; a level needs 1, or N: correct the mapping")
    level = values / (own.force_N if unit == b"N" else 1.0)
    if (level < 0.0).any():
        raise ChannelError(f"{log.path}: {name} is negative; a thruster only pushes: give each a column")
    if level.max() > 1.0 + LARGEST_SIZE:
        text = f"{name} reaches {level.max():.3g} times its force"
        raise ChannelError(f"{log.path}: {text}; give its unit and scale in the mapping, or its force_N")
    return Valve(time_s, level)


def _answers(
    vehicle: config.Vehicle, model: BodyModel, fit: BodyFit
) -> tuple[tuple[QuantityEstimate, ...], dict[str, tuple[Contribution, ...]]]:
    """Body, delay and tilt with their intervals, and what these are made of."""
    found, p = fit.found, fit.found.globals
    P = found.fit.covariance[:p, :p]
    mass_kg, centre_m, inertia = model.body(fit.x)
    at = [*range(BODY), *(model.names.index(one) for one in ("delay", "tilt_x", "tilt_y") if one in model.names)]
    scale = np.array([mass_kg, 1.0, 1.0, inertia] + [1.0] * (len(at) - BODY))
    values = np.array([mass_kg, *centre_m, inertia, *fit.x[at[BODY:]]])
    shift_s, low_s, high_s, sigma_s = fit.lateness
    values[BODY] += shift_s
    half = float(stdtrit(found.noise.freedom, 0.5 + 0.5 * INTERVAL))
    own = np.sqrt(found.variances(model.sigma)[at])
    sigma = half / HALF * own
    sigma[BODY] = np.hypot(sigma[BODY], sigma_s)
    stretch = np.array([True, False, False, True] + [False] * (len(at) - BODY))  # logarithms
    low = np.where(stretch, values * np.exp(-half * own), values - half * own)
    high = np.where(stretch, values * np.exp(half * own), values + half * own)
    of_windows = STATE * len(fit.start_s)
    keys = [key_of(name, vehicle) for name in model.names] + [*[""] * (STATE - 3), *_STEADY] * len(fit.start_s)
    stated = np.full(of_windows, np.nan)
    stated.reshape(-1, STATE)[:, -3:] = model.steady_sigma
    causes = Causes(keys, np.append(model.sigma, stated))
    low[BODY], high[BODY] = low[BODY] - low_s, high[BODY] + high_s
    effects = causes.effects(scale[:, None] * found.fit.covariance[at])
    leans = causes.said(effects, scale * sigma, np.abs(values))
    told = sigma <= SUPPORTED_SHRINKAGE * model.sigma[at]
    if model.weighed:
        told[0] = bool(np.isfinite(sigma[0]))  # stated; what is found of it cannot be less known
    units = ("kg", "m", "m", "kg m^2", "s", "m/s^2", "m/s^2")
    bound = scale * np.sqrt(np.diag(P)[at])
    numbers = (of.tolist() for of in (values, scale * sigma, low, high, told, bound))
    names = [model.names[k] for k in at]
    answers = (QuantityEstimate(*one) for one in zip(names, units[: len(at)], *numbers, leans, strict=True))
    return tuple(answers), dict(zip(names, causes.budget(effects, scale * sigma), strict=True))


def _fitted(model: BodyModel, poses: TrackedPoses) -> tuple[BodyFit | None, str]:
    """The fit as stated; or as what the recording is to be read so that nothing refuses it, if that leaves much less.

    A first guess of a recording as stated may leave more than one of another reading. Where the first steps of the fits
    leave less as stated, that fit comes first, and is the answer where nothing refuses it.
    """
    begun = None
    with suppress(EstimationError):  # said by the fit
        begun = model.begun(poses)

    @cache
    def as_stated() -> BodyFit | EstimationError:
        try:
            return model.fit(poses, begun)
        except EstimationError as error:
            return error

    with suppress(EstimationError):  # of poses: said by the fit
        for other in others(model, poses):
            with suppress(EstimationError):
                first = other.model.begun(other.poses)
                if begun is not None and begun.fit.residual_sum < first.fit.residual_sum:
                    fit = as_stated()
                    if isinstance(fit, BodyFit) and not _findings(model, fit).against:
                        return fit, ""
                if not _findings(other.model, other.model.fit(other.poses, first)).against:
                    said = " and ".join(other.said)
                    return None, f"the poses are as predicted if {said}: correct the mapping, or the URDF"
    fit = as_stated()
    return (fit, "") if isinstance(fit, BodyFit) else (None, f"the fit failed: {fit}")


def _findings(model: BodyModel, fit: BodyFit) -> Findings:
    """Corrections larger than stated, windows in which something else pushed, and what is left over of a sensor."""
    found = fit.found
    P, x, names = found.fit.covariance, found.fit.x, model.names
    at = [k for k, name in enumerate(names) if k >= BODY and name != "delay"]
    at = [0, *at] if model.weighed else at
    sigma = model.sigma[at]
    in_told = x[at] / expected_sigma(sigma**2, np.diag(P)[at], found.wider)
    each = {names[k]: float(one) for k, one in zip(at, in_told, strict=True)}
    scales = [k for k, name in enumerate(names) if name.startswith("scale_")]
    if scales and model.weighed:
        weight = np.array([float(name == "common_force") for name in model.names])
        weight[scales] = 1.0 / len(scales)
        whole, own = (weight * model.sigma) @ (weight * model.sigma), weight @ P[: len(weight), : len(weight)] @ weight
        each["the thrusters' common force, the mass or the tracker's lengths"] = float(
            weight @ x[: len(weight)] / expected_sigma(whole, own)
        )
    each |= dict(_by_window(model, fit))
    of_all = together(x[at] / sigma, P[np.ix_(at, at)] / np.outer(sigma, sigma))
    bad = list(contradicted(each) or of_all.refused())
    if not fit.settled:
        bad.append(
            "the fit does not settle: thrusters, axes or units are not as stated, or the motion tells too little"
        )
    doubts = [*doubtful(each, _TOLD), *of_all.doubted()]
    if not model.weighed:
        doubts.append("nothing checks the thrusters' common force: weigh the body, give its mass and body.mass_sigma")
    larger, large = misfit_texts(zip(_SENSORS, found.by_sensor, strict=True))
    return Findings((*bad, *larger), (*doubts, *large))


def _by_window(model: BodyModel, fit: BodyFit) -> Iterator[tuple[str, float]]:
    """The largest steady acceleration of each window, in sigmas of what its poses tell of it."""
    P, x = np.diag(fit.found.fit.covariance), fit.found.fit.x
    for k, start_s in enumerate(fit.start_s.tolist()):
        own = slice(fit.found.globals + STATE * k + STATE - 3, fit.found.globals + STATE * (k + 1))
        sigmas = x[own] / expected_sigma(model.steady_sigma**2, P[own], fit.found.wider)
        which = int(np.abs(sigmas).argmax())
        what = ("push along x", "push along y", "turning")[which]
        yield f"the {what} besides the thrusters, {start_s:.0f} to {start_s + WINDOW_s:.0f} s", float(sigmas[which])
