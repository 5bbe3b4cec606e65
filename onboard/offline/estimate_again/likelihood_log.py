"""Maximum likelihood fit of a log's longest interval with one payload, with its verdict.

Common to all kinds of base: choice of ticks, fit, held-out halves, estimates. The payload of each half of the ticks
predicts the other half (:func:`onboard.identification.exiddm.batch.held_out`).
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from onboard.dynamics.errors import ModelError
from onboard.dynamics.inertia import RigidBody, elements
from onboard.dynamics.payload import BodyEstimate
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.rls import Observability
from onboard.identification.change import Change
from onboard.identification.exiddm.batch import Exiddm, PayloadFit, held_out
from onboard.identification.exiddm.ticks import Ticks
from onboard.identification.observability import observed_directions
from onboard.identification.quantities import BODY, BODY_UNITS, SUPPORTED_SHRINKAGE
from onboard.identification.rows.standard import link_estimate
from onboard.identification.verdict import Evidence, is_positive, verdict
from onboard.offline.estimate_again.identified import Answer, Identified
from onboard.recording.reader import LogReader

EXIDDM = "exiddm"
LONGEST_S = 60.0  # of flight that is fitted as a whole
SHORTEST_S = 2.0
LEVEL = 0.95


class Kept(NamedTuple):
    """Output of the onboard estimator for a log."""

    log: LogReader
    payload: str  # its link
    ticks: Ticks  # the longest time that one payload was held
    period_s: float  # between ticks
    refused: Mapping[str, int]  # rows by reason
    idle: Mapping[str, int]  # rows not fitted for another reason


class Judged(NamedTuple):
    """Result specific to a kind of base, besides the payload."""

    answers: tuple[Answer, ...] = ()
    reason: str = ""  # reason for refusing the fit; empty if none


Build = Callable[[Ticks, bool], Exiddm]  # the estimator of ticks; whether their first is the first of all
Judge = Callable[[PayloadFit, float], Judged]  # what else a fit says, its variances so much wider


def identified(kept: Kept, build: Build, judge: Judge) -> Identified:
    """Estimates and verdict of a log.

    Args:
        kept: its ticks.
        build: makes the estimator of some of them.
        judge: what the kind of base says of the fit.
    """
    log, ticks, refused = kept.log, kept.ticks, dict(kept.refused)
    names = tuple(f"{name}_{kept.payload}" for name in BODY)
    nothing = dict.fromkeys(names, False)
    used = 6 * int(np.isfinite(ticks.measured).all(axis=1).sum())

    def no_answer(evidence: Evidence) -> Identified:
        return Identified(log.path, EXIDDM, (), evidence.rows_used, refused, log.damage, verdict(evidence))

    if len(ticks.time_s) * kept.period_s < SHORTEST_S or not used:
        return no_answer(Evidence(0, {**refused, **kept.idle}, nothing, None))
    try:
        exiddm = build(ticks, True)
        found = exiddm.fit()
    except (EstimationError, ModelError) as error:
        return no_answer(Evidence(used, refused, nothing, None, failure=f"the fit failed: {error}"))
    wider = max(1.0, found.misfit)  # the residual is not below the noise
    judged = judge(found, wider)
    halves, unchecked, middle = None, Evidence._field_defaults["unchecked"], len(ticks.time_s) // 2
    if not judged.reason and middle * kept.period_s >= SHORTEST_S:
        try:
            earlier, later = build(ticks.part(slice(0, middle)), True), build(ticks.part(slice(middle, None)), False)
            halves = held_out(exiddm, earlier, later, found)
        except (EstimationError, ModelError) as error:
            unchecked = f"not checked on motion that was not used: half of the run determines too little ({error})"
    link = link_estimate(kept.payload, found.chi, wider * found.chi_covariance)
    body = found.payload._replace(body=link.body or found.payload.body)
    answers = (*body_answers(names, *body, wider), *judged.answers)
    if judged.reason:
        answers = tuple(answer._replace(supported=False) for answer in answers)
    evidence = Evidence(
        used,
        refused,
        {answer.name: answer.supported for answer in answers},
        halves,
        failure=judged.reason,
        away={link.link: link.away},
        misfit=found.misfit,
        standings={answer.name: answer.standing for answer in answers if answer.supported},
        sizes=frozenset(answer.name for answer in answers if is_positive(answer.name, answer.unit)),
        corrections=_corrections(exiddm, found, kept.payload),
        unchecked=unchecked,
    )
    return Identified(
        log.path,
        EXIDDM,
        answers,
        used,
        refused,
        log.damage,
        verdict(evidence),
        held_out=halves,
        misfit=found.misfit,
        observability=observed_directions(body_seen(body), names),
        links=(link,),
    )


def _corrections(exiddm: Exiddm, found: PayloadFit, payload: str) -> dict[str, float]:
    """What was fitted besides the payload, in the sigmas that were stated; nothing of what has none."""
    stated = np.sqrt(np.diag(exiddm.prior_information))
    return {
        name: float(x * information)
        for name, x, information in zip(found.names, found.fit.x, stated, strict=True)
        if information > 0.0 and not name.endswith(f"_{payload}")
    }


def longest_held(parts: Sequence[Ticks], changes: Sequence[Change], held: bool, period_s: float) -> Ticks:
    """The longest run of ticks, joints known at each of them, while one payload was held; at most ``LONGEST_S``.

    Args:
        parts: ticks in the order of their times, one part at least.
        changes: of the payload, in the same order.
        held: whether one is held at the start.
        period_s: between ticks.
    """
    ticks = Ticks(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    whole = np.isfinite(np.concatenate([ticks.q, ticks.dq, ticks.ddq], axis=1)).all(axis=1)
    which = np.zeros(len(ticks.time_s), np.int64)  # whose; zero while nothing is held
    number, begin_s = int(held), -np.inf
    for count, change in enumerate([*changes, None], 2):
        end_s = np.inf if change is None else change.since_s
        which[(ticks.time_s > begin_s) & (ticks.time_s < end_s)] = number
        if change is not None:
            begin_s = change.time_s
            number = {"capture": count, "ejection": 0, "instrument": 0}.get(change.kind, number)
    which[~whole] = 0
    joined = (np.diff(which) == 0) & (np.abs(np.diff(ticks.time_s) / period_s - 1.0) < 0.5)
    edges = [0, *(np.flatnonzero(~joined) + 1), len(which)]
    runs = [slice(a, b) for a, b in pairwise(edges) if b > a and which[a]]
    longest = max(runs, key=lambda run: run.stop - run.start, default=slice(0, 0))
    return ticks.part(slice(longest.start, min(longest.stop, longest.start + round(LONGEST_S / period_s))))


def body_answers(names: tuple[str, ...], body: RigidBody, covariance: FloatArray, wider: float) -> tuple[Answer, ...]:
    """Each is supported if its sigma is at most a fifth of the body's own scale."""
    values = np.array([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
    bound = np.sqrt(np.diag(covariance))
    sigma = bound * np.sqrt(wider)
    half = float(ndtri(0.5 + 0.5 * LEVEL)) * sigma
    fine = sigma <= SUPPORTED_SHRINKAGE * _size(body)
    return tuple(
        Answer(*told)
        for told in zip(
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
