"""Maximum likelihood fit of a log, with its verdict: choice of ticks, estimates, evidence.

Common to a free flight that is fitted as a whole (:mod:`onboard.ground.identify.kinds.free_flyer_log`), to parabolas
(:mod:`onboard.ground.identify.kinds.parabolic_log`) and to a run on a table
(:mod:`onboard.ground.identify.kinds.table_log`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import BodyEstimate, numbers_of
from onboard.estimation.arrays import FloatArray, eigen, finite, gaps
from onboard.estimation.errors import EstimationError
from onboard.estimation.policy import contradicted_text
from onboard.estimation.recursive.rls import Observability
from onboard.flight.estimate.answers import INSTRUMENTS, change_of
from onboard.flight.estimate.estimation import SUFFIX
from onboard.ground.identify.kinds.identified import Identified, Residuals, answers_of, by_axis, judged, standings
from onboard.identification.corrections import doubtful
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.observability import observed_directions
from onboard.identification.online import Change, CONTACT_s
from onboard.identification.quantities import BODY, BODY_UNITS, SUPPORTED_SHRINKAGE, Findings, QuantityEstimate, Useful
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.rows.standard import link_estimate
from onboard.identification.verdict import TOO_SHORT, Evidence
from onboard.identification.whole_flight.pooled import halves
from onboard.identification.whole_flight.witnesses import Tested, bound_of, leans_on
from onboard.recording.reader import LogReader

LONGEST_S = 60.0  # of flight that is fitted as a whole
_EVENTS = "event" + SUFFIX  # of the estimator, in a log


class Kept(NamedTuple):
    """Output of the onboard estimator for a log."""

    log: LogReader
    payload: str  # its link
    ticks: Ticks  # the longest time that one payload was held
    period_s: float  # between ticks
    refused: Mapping[str, int]  # rows by reason
    useful: Useful


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
    further: tuple[QuantityEstimate, ...] = ()  # answers besides the payload
    reason: str = ""  # for refusing it; empty if none
    findings: Findings = Findings()
    leans: tuple[str, ...] = ("",) * len(BODY)  # of each of the payload's numbers, on what is stated
    outer: FloatArray | None = None  # (2, 10) ends of their 99.9 % intervals about them, variances not yet wider


def half_too_short(error: Exception | str) -> str:
    """Why nothing was held out."""
    return f"not checked on motion that was not used: half of the run determines too little ({error})"


def no_answer(
    kept: Kept, used: int, failure: str = "", *, misread: bool = False, idle: Mapping[str, int] = MappingProxyType({})
) -> Identified:
    """A log without an estimate: rows used, and why the fit failed where it did, or was not tried.

    Args:
        kept: of it.
        used: rows.
        failure: why; empty where none was fitted.
        misread: the recording's mapping has a mistake.
        idle: rows not fitted for another reason.
    """
    nothing = dict.fromkeys(_names(kept), False)
    evidence = Evidence(used, {**kept.refused, **idle}, nothing, None, failure=failure)
    return replace(judged(kept.log, evidence, misread=misread), refused=dict(kept.refused))


def fitted_of(made: Tested, period_s: float, row_names: Sequence[str]) -> CheckedFit:
    """A fit, its tests as they were within the stated sigmas, and the prediction of its halves.

    Args:
        made: the fit.
        period_s: between ticks.
        row_names: of the lines.
    """
    flight, found = made.flight, made.found
    held_out, unchecked = None, TOO_SHORT
    try:
        held_out = halves(flight, found)
    except EstimationError as error:
        unchecked = half_too_short(error)
    return CheckedFit(
        found.payload,
        found.chi,
        found.chi_covariance,
        bound_of(flight, found),
        sum(block.rows for block in found.blocks),
        found.misfit,
        max(1.0, found.misfit, *found.by_instrument.values()),
        made.corrections,
        held_out,
        unchecked,
        by_axis(flight.time_s, found.residuals, period_s, row_names[6:]),
        findings=made.findings.plus(doubts=doubtful(made.of_bodies, "sigmas of what the flight tells of it")),
        leans=leans_on(flight, found),
        outer=found.outer,
    )


def identified_of(kept: Kept, found: CheckedFit) -> Identified:
    """Estimates and verdict of a fit."""
    names = _names(kept)
    link = link_estimate(kept.payload, found.chi, found.wider * found.chi_covariance)
    body = found.payload._replace(body=link.body or found.payload.body)
    of_payload = [*body_answers(names, *body, found.wider, found.bound)]
    if found.outer is not None:
        ends = zip(of_payload, (found.wider**0.5 * found.outer).T.tolist(), strict=True)
        of_payload = [one._replace(own_outer=(one.value + low, one.value + high)) for one, (low, high) in ends]
    answers = (*(one._replace(leans=on) for one, on in zip(of_payload, found.leans, strict=True)), *found.further)
    if found.reason:
        answers = tuple(answer._replace(supported=False) for answer in answers)
    residual = kept.refused.get("residual", 0)
    contradicted = contradicted_text(residual / max(found.rows_used + residual, 1))
    evidence = Evidence(
        found.rows_used,
        kept.refused,
        {answer.name: answer.supported for answer in answers},
        found.halves,
        failure=found.reason,
        away={link.link: link.away},
        misfit=found.misfit,
        findings=found.findings.plus([contradicted] if contradicted else []),
        standings=standings(answers, kept.useful),
        corrections=found.corrections,
        unchecked=found.unchecked,
    )
    seen = observed_directions(body_seen(body), names)
    made = judged(kept.log, evidence, answers, misfit=found.misfit, observability=seen)
    return replace(made, links=(link,), residuals=found.residuals)


def _names(kept: Kept) -> tuple[str, ...]:
    return tuple(f"{name}_{kept.payload}" for name in BODY)


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


class AnswerInLog(NamedTuple):
    """What the onboard estimator said in a log."""

    changes: list[Change]  # of the payload
    payload: FloatArray | None  # (10,) its last standard parameters; None where the log has none
    left_out: frozenset[str]  # instruments that it did without at the end


def answer_in(log: LogReader) -> AnswerInLog:
    """The onboard answer that a log has."""
    changes, payload, left_out = list[Change](), None, set[str]()
    for name, rows in log.batches([name for name in ("estimate", _EVENTS) if name in log.channels]):
        if name == _EVENTS:
            changes += filter(None, map(change_of, rows))
        elif rows["mean"].shape[1:] == (10,):
            known = np.isfinite(rows["mean"]).all(axis=1) & (rows["mean"][:, 0] > 0.0)
            payload = np.array(rows["mean"][known][-1], np.float64) if known.any() else payload
    for change in changes:
        if change.kind in INSTRUMENTS:
            (left_out.add if change.kind == "left_out" else left_out.discard)(change.what)
    of_payload = [change for change in changes if change.kind not in INSTRUMENTS]
    return AnswerInLog(sorted(of_payload, key=lambda change: change.time_s), payload, frozenset(left_out))


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
    which[~finite([ticks.q, ticks.dq, ticks.ddq])] = unknown
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
) -> tuple[QuantityEstimate, ...]:
    """Each is supported if its sigma is at most a fifth of the body's scale.

    Args:
        names: of the ten numbers.
        body: their values.
        covariance: of these, (10, 10).
        wider: factor of the variances.
        bound: least sigmas, (10,).
    """
    sigma = np.sqrt(wider * np.diag(covariance))
    fine = np.asarray(sigma <= SUPPORTED_SHRINKAGE * _size(body), np.bool_)
    return answers_of(names, BODY_UNITS, numbers_of(body), sigma, fine, bound)


def _size(body: RigidBody) -> FloatArray:
    """The scale of mass, centre of mass and inertia of a body, (10,): its mass, radius of gyration, half its trace."""
    half_trace = 0.5 * float(np.trace(body.inertia_kg_m2))
    return np.array([body.mass_kg, *[np.sqrt(half_trace / body.mass_kg)] * 3, *[half_trace] * 6])


def body_seen(payload: BodyEstimate) -> Observability:
    """Observability of the payload's ten numbers, with its own scale as prior."""
    size = _size(payload.body)
    values, vectors = eigen(payload.covariance / np.outer(size, size))
    gain = 1.0 / np.maximum(values[::-1], np.finfo(np.float64).tiny) - 1.0  # ascending
    shrinkage = np.sqrt(np.diag(payload.covariance)) / size
    return Observability(shrinkage, np.maximum(gain, 0.0), size[:, None] * vectors[:, ::-1])
