"""Maximum likelihood fit of a log, with its verdict: choice of ticks, estimates, evidence.

:func:`identified` fits the longest interval with one payload (an air-bearing table); the payload of each half of the
ticks predicts the other half (:func:`onboard.identification.free_flyer.batch.held_out`). A free flight is fitted as a
whole (:mod:`onboard.ground.identify.kinds.free_flyer_log`), with the same estimates and evidence.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.model.errors import ModelError
from onboard.dynamics.model.inertia import RigidBody, elements
from onboard.dynamics.model.payload import BodyEstimate
from onboard.estimation.arrays import FloatArray, gaps
from onboard.estimation.errors import EstimationError
from onboard.estimation.policy import HALF, contradicted_text
from onboard.estimation.recursive.rls import Observability
from onboard.ground.identify.kinds.identified import Identified, IdentifiedQuantity, standings
from onboard.ground.identify.kinds.residuals import Residuals, by_axis
from onboard.identification.change import Change, CONTACT_s
from onboard.identification.corrections import contradicted
from onboard.identification.free_flyer.batch import MotionFit, PayloadFit, held_out
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.observability import observed_directions
from onboard.identification.quantities import BODY, BODY_UNITS, SUPPORTED_SHRINKAGE, Findings
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.rows.standard import link_estimate
from onboard.identification.table.air_bearing import TableFit
from onboard.identification.table.rivals import answered
from onboard.identification.useful import Useful
from onboard.identification.verdict import Evidence, standings_of, verdict
from onboard.identification.windows import SHORTEST
from onboard.recording.reader import LogReader

LONGEST_S = 60.0  # of flight that is fitted as a whole


class Kept(NamedTuple):
    """Output of the onboard estimator for a log."""

    log: LogReader
    payload: str  # its link
    ticks: Ticks  # the longest time that one payload was held
    period_s: float  # between ticks
    refused: Mapping[str, int]  # rows by reason
    idle: Mapping[str, int]  # rows not fitted for another reason
    useful: Useful


class BaseResult(NamedTuple):
    """Result specific to a kind of base, besides the payload."""

    answers: tuple[IdentifiedQuantity, ...] = ()
    reason: str = ""  # reason for refusing the fit; empty if none


class CheckedFit(NamedTuple):
    """A fit and how it was checked."""

    payload: BodyEstimate
    chi: FloatArray  # (10,) standard parameters of the payload
    chi_covariance: FloatArray  # (10, 10)
    bound: FloatArray  # (10,) Cramér-Rao: least sigmas of the payload's numbers, at what is stated
    rows_used: int
    misfit: float  # of all rows
    wider: float  # factor of the variances
    corrections: Mapping[str, float]  # what was fitted besides the payload, in stated sigmas
    halves: HeldOut | None
    unchecked: str  # why nothing is held out, where it is not
    residuals: Residuals  # by axis of the base IMU
    judged: BaseResult = BaseResult()
    findings: Findings = Findings()
    leans: tuple[str, ...] = ("",) * len(BODY)  # of each of the payload's numbers, on what is stated
    outer: FloatArray | None = None  # (2, 10) ends of their 99.9 % intervals about them, variances not yet wider


Build = Callable[[Ticks, bool], TableFit]  # the estimator of ticks; whether their first is the first of all
Judge = Callable[[PayloadFit, float], BaseResult]  # what else a fit says, its variances so much wider


def identified(kept: Kept, build: Build, judge: Judge) -> Identified:
    """Estimates and verdict of a log's longest interval with one payload.

    Args:
        kept: its ticks.
        build: makes the estimator of some of them.
        judge: what the kind of base says of the fit.
    """
    ticks = kept.ticks
    seen = np.asarray(np.isfinite(ticks.measured).all(axis=1), np.bool_)
    used = 6 * int(seen.sum())
    if len(ticks.time_s) < SHORTEST or not used:
        return no_answer(kept, 0)
    try:
        motion_fit = build(ticks, True)
        found = motion_fit.fit()
        corrected, stated, joints, of_encoders = answered(motion_fit, found)
    except (EstimationError, ModelError) as error:
        return no_answer(kept, used, f"the fit failed: {error}")
    wider = max(1.0, stated.misfit)  # the residual is not below the noise
    judged = judge(corrected, wider)
    halves, unchecked, middle = None, Evidence._field_defaults["unchecked"], len(ticks.time_s) // 2
    if not (seen[:middle].any() and seen[middle:].any()):
        unchecked = half_too_short("of which the IMU has no reading")
    elif not judged.reason and middle >= SHORTEST:
        try:
            earlier, later = build(ticks.part(slice(0, middle)), True), build(ticks.part(slice(middle, None)), False)
            halves = held_out(motion_fit, earlier, later, found)
        except (EstimationError, ModelError) as error:
            unchecked = half_too_short(error)
    corrections = _corrections(motion_fit, corrected, kept.payload) | joints.in_stated_sigmas
    bound = np.sqrt(np.diag(stated.payload.covariance))
    numbers = corrected.payload, corrected.chi, corrected.chi_covariance, bound
    together = round(motion_fit.period_s / kept.period_s)
    time_s = ticks.time_s[(together - 1) // 2 :: together][: motion_fit.ticks]
    left = by_axis(time_s, motion_fit.residuals_by_tick(found.fit.x), motion_fit.period_s)
    findings = of_encoders.plus(contradicted(joints.in_told_sigmas))
    fit = CheckedFit(*numbers, used, stated.misfit, wider, corrections, halves, unchecked, left, judged, findings)
    return identified_of(kept, fit)


def half_too_short(error: Exception | str) -> str:
    """Why nothing was held out."""
    return f"not checked on motion that was not used: half of the run determines too little ({error})"


def no_answer(kept: Kept, used: int, failure: str = "", *, misread: bool = False) -> Identified:
    """A log without an estimate: rows used, and why the fit failed where it did, or was not tried."""
    log, nothing = kept.log, dict.fromkeys(_names(kept), False)
    refused = dict(kept.refused) if used else {**kept.refused, **kept.idle}
    evidence = Evidence(used, refused, nothing, None, failure=failure)
    return Identified(
        log.path, config.PREDICTING.name, (), used, dict(kept.refused), log.damage, verdict(evidence), misread=misread
    )


def identified_of(kept: Kept, found: CheckedFit) -> Identified:
    """Estimates and verdict of a fit."""
    log, names, judged = kept.log, _names(kept), found.judged
    link = link_estimate(kept.payload, found.chi, found.wider * found.chi_covariance)
    body = found.payload._replace(body=link.body or found.payload.body)
    of_payload = body_answers(names, *body, found.wider, found.bound)
    of_payload = tuple(one._replace(leans=on) for one, on in zip(of_payload, found.leans, strict=True))
    if found.outer is not None:
        ends = (found.wider**0.5 * found.outer).T.tolist()
        of_payload = tuple(
            one._replace(own_outer=(one.value + low, one.value + high))
            for one, (low, high) in zip(of_payload, ends, strict=True)
        )
    answers = (*of_payload, *judged.answers)
    if judged.reason:
        answers = tuple(answer._replace(supported=False) for answer in answers)
    residual = kept.refused.get("residual", 0)
    contradicted = contradicted_text(residual / max(found.rows_used + residual, 1))
    evidence = Evidence(
        found.rows_used,
        kept.refused,
        {answer.name: answer.supported for answer in answers},
        found.halves,
        failure=judged.reason,
        away={link.link: link.away},
        misfit=found.misfit,
        findings=found.findings.plus([contradicted] if contradicted else []),
        standings=standings(answers, kept.useful),
        corrections=found.corrections,
        unchecked=found.unchecked,
    )
    return Identified(
        log.path,
        config.PREDICTING.name,
        answers,
        found.rows_used,
        dict(kept.refused),
        log.damage,
        verdict(evidence),
        held_out=found.halves,
        misfit=found.misfit,
        observability=observed_directions(body_seen(body), names),
        links=(link,),
        standings=standings_of(evidence),
        residuals=found.residuals,
    )


def _names(kept: Kept) -> tuple[str, ...]:
    return tuple(f"{name}_{kept.payload}" for name in BODY)


def _corrections(motion_fit: MotionFit, found: PayloadFit, payload: str) -> dict[str, float]:
    """What was fitted besides the payload, in the sigmas that were stated; nothing of what has none."""
    stated = motion_fit.layout.sigma
    return {
        name: float(x / sigma)
        for name, x, sigma in zip(found.names, found.fit.x, stated, strict=True)
        if sigma > 0.0 and not name.endswith(f"_{payload}")
    }


def longest_held(parts: Sequence[Ticks], changes: Sequence[Change], held: bool, period_s: float) -> Ticks:
    """The longest run of ticks, joints known at each of them, while one payload was held; at most ``LONGEST_S``.

    Args:
        parts: ticks in the order of their times, one part at least.
        changes: of the payload, in the same order.
        held: whether one is held at the start.
        period_s: between ticks.
    """
    ticks = Ticks.joined(parts)
    runs = [run for run in runs_of(ticks, changes, held, period_s) if run.payload > 0]
    longest = max((run.ticks for run in runs), key=lambda run: run.stop - run.start, default=slice(0, 0))
    return ticks.part(slice(longest.start, min(longest.stop, longest.start + round(LONGEST_S / period_s))))


class TickRun(NamedTuple):
    """Ticks in succession, joints known at each of them."""

    ticks: slice
    payload: int  # which one is held: numbered; 0: nothing


def runs_of(ticks: Ticks, changes: Sequence[Change], held: bool, period_s: float) -> list[TickRun]:
    """Runs of ticks with one payload or nothing held; times in which that is not known are left out.

    Args:
        ticks: in the order of their times.
        changes: of the payload, in the same order.
        held: whether one is held at the start.
        period_s: between ticks.
    """
    unknown = -1
    which = np.full(len(ticks.time_s), unknown, np.int64)
    number, before, begin_s = int(held), int(held), -np.inf
    for count, change in enumerate([*changes, None], 2):
        end_s = np.inf if change is None else change.since_s
        which[(ticks.time_s > begin_s) & (ticks.time_s < end_s)] = number
        if change is not None:
            noticed = change.since_s < change.time_s  # and not announced
            begin_s = change.time_s + (CONTACT_s if noticed else 0.0)
            if change.kind == "capture_contradicted":
                which[which == number] = unknown
            numbers = {"capture": count, "ejection": 0, "instrument": unknown}
            numbers |= {"capture_contradicted": 0, "release_contradicted": before}
            before, number = number, numbers.get(change.kind, number)
    which[~np.isfinite(np.concatenate([ticks.q, ticks.dq, ticks.ddq], axis=1)).all(axis=1)] = unknown
    joined = (np.diff(which) == 0) & ~gaps(ticks.time_s, period_s)
    edges = [0, *(np.flatnonzero(~joined) + 1), len(which)]
    return [TickRun(slice(a, b), int(which[a])) for a, b in pairwise(edges) if b > a and which[a] != unknown]


def held_ticks(runs: Sequence[TickRun]) -> dict[int, int]:
    """By the number of each payload, for how many ticks it was held."""
    lengths: dict[int, int] = {}
    for run in runs:
        if run.payload > 0:
            lengths[run.payload] = lengths.get(run.payload, 0) + run.ticks.stop - run.ticks.start
    return lengths


def body_answers(
    names: tuple[str, ...], body: RigidBody, covariance: FloatArray, wider: float, bound: FloatArray
) -> tuple[IdentifiedQuantity, ...]:
    """Each is supported if its sigma is at most a fifth of the body's scale.

    Args:
        names: of the ten numbers.
        body: their values.
        covariance: of these, (10, 10).
        wider: factor of the variances.
        bound: least sigmas, (10,).
    """
    values = np.array([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
    sigma = np.sqrt(wider * np.diag(covariance))
    half = HALF * sigma
    fine = sigma <= SUPPORTED_SHRINKAGE * _size(body)
    return tuple(
        IdentifiedQuantity(*fields)
        for fields in zip(
            names,
            BODY_UNITS,
            *(x.tolist() for x in (values, sigma, values - half, values + half, fine, bound)),
            strict=True,
        )
    )


def _size(body: RigidBody) -> FloatArray:
    """The scale of mass, centre of mass and inertia of a body, (10,): its mass, radius of gyration, half its trace."""
    half_trace = 0.5 * float(np.trace(body.inertia_kg_m2))
    return np.array([body.mass_kg, *[np.sqrt(half_trace / body.mass_kg)] * 3, *[half_trace] * 6])


def body_seen(payload: BodyEstimate) -> Observability:
    """Observability of the payload's ten numbers, with its own scale as prior."""
    size = _size(payload.body)
    values, vectors = np.linalg.eigh(payload.covariance / np.outer(size, size))
    gain = 1.0 / np.maximum(values[::-1], np.finfo(np.float64).tiny) - 1.0  # ascending
    shrinkage = np.sqrt(np.diag(payload.covariance)) / size
    return Observability(shrinkage, np.maximum(gain, 0.0), size[:, None] * vectors[:, ::-1])
