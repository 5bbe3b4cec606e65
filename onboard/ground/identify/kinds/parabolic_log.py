"""``heft identify`` of parabolic flights: each run between release and catch by itself, and all of them together.

The log is cut by :func:`cut`. Every run is fitted and tested as a flight of its own, and refused where a test fails.
The answer pools the others (:mod:`onboard.identification.whole_flight.pooled`), also those that determine too little by
themselves; a run whose payload differs from that of all is named and left out.

It is cut into releases, motions and catches (Limparis, appendix A.2) by a state machine:

| state | begins with |
|---|---|
| SECURED | the aircraft pulls up: a specific force of g or so, or no reading |
| HELD | free fall of the aircraft; the vehicle shows the unrest of hands or straps |
| FREE | the release: nothing but the instrument's noise and what the arm does |
| MOTION | the arm moves while nothing holds the vehicle |

From FREE and MOTION a contact leads back to HELD. A contact shorter than ``settle_s`` was a bump, and the run goes on
with another momentum; a longer one was the catch, and ends the run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np

from onboard import config
from onboard.config.bases.parabola import Parabola
from onboard.dynamics.model.errors import ModelError
from onboard.estimation.arrays import BoolArray, FloatArray, finite, gaps
from onboard.estimation.errors import EstimationError
from onboard.estimation.free_fall import CUBIC_s, WINDOW_s, is_free
from onboard.estimation.gates import named_refusals
from onboard.estimation.policy import MISFIT_REFUSED, REFUSE, of_each
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.ground.identify.kinds.identified import Identified, RunAnswer
from onboard.ground.identify.kinds.likelihood_log import CheckedFit, Kept, fitted_of, identified_of, no_answer
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.identification.corrections import misfit_texts
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.ticks import RESTS_rad_s, Ticks
from onboard.identification.quantities import BODY, Findings
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.pooled import Pool, Pooled
from onboard.identification.whole_flight.segments import Segment
from onboard.identification.whole_flight.witnesses import Tested, fitted
from onboard.identification.windows import SHORTEST, STAGES_s
from onboard.recording.reader import LogReader


class Stage(StrEnum):
    """State of a vehicle that is flown by hand."""

    SECURED = "secured"
    HELD = "held"
    FREE = "free"
    MOTION = "motion"


@dataclass(frozen=True)
class ParabolaRun:
    """A release by hand with what follows, or a parabola without one."""

    parabola: int  # its number, from 0
    parts: tuple[slice, ...]  # ticks of free flight, divided at bumps; what is fitted
    release_s: float = float("nan")
    catch_s: float = float("nan")
    bumps_s: tuple[float, ...] = ()  # middle of each
    motions_s: tuple[tuple[float, float], ...] = ()  # begin and end of each
    reason: str = ""  # why nothing can be fitted; empty if it can

    def as_json(self) -> dict[str, Any]:
        """Plain values; times since the log's first tick."""
        return {
            "parabola": self.parabola,
            "release_s": None if np.isnan(self.release_s) else self.release_s,
            "catch_s": None if np.isnan(self.catch_s) else self.catch_s,
            "bumps_s": list(self.bumps_s),
            "motions_s": [list(motion) for motion in self.motions_s],
        }


def stages(ticks: Ticks, period_s: float, settings: Parabola) -> list[Stage]:
    """State at each tick; bumps and catches are distinguished by :func:`cut`."""
    low, free = _low(ticks.measured[:, 3:6], period_s, settings.low_m_s2), _free(ticks, period_s, settings)
    moving = np.any(np.nan_to_num(np.abs(ticks.dq)) > RESTS_rad_s, axis=1)
    found, stage = [], Stage.SECURED
    for is_low, is_free_, moves in zip(low.tolist(), free.tolist(), moving.tolist(), strict=True):
        if not is_low:
            stage = Stage.SECURED
        elif not is_free_:
            stage = Stage.HELD
        elif moves:
            stage = Stage.MOTION
        elif stage in (Stage.SECURED, Stage.HELD, Stage.MOTION):
            stage = Stage.FREE
        found.append(stage)
    return found


def cut(ticks: Ticks, period_s: float, settings: Parabola) -> list[ParabolaRun]:
    """Runs of a log, and parabolas without one, in the order of their times.

    Args:
        ticks: of the whole log.
        period_s: between ticks.
        settings: of the vehicle file.
    """
    at = np.array(stages(ticks, period_s, settings))
    joints = finite([ticks.q, ticks.dq, ticks.ddq])
    found: list[ParabolaRun] = []
    bump_s = settings.settle_s + CUBIC_s + WINDOW_s  # of a contact, with what is not free beside it
    fall = [one for one in _spans(at != Stage.SECURED) if (one.stop - one.start) * period_s >= settings.shortest_s]
    for number, low in enumerate(fall):
        flying = (at == Stage.FREE) | (at == Stage.MOTION)
        flying[: low.start], flying[low.stop :] = False, False
        groups: list[list[slice]] = []
        for part in (one for one in _spans(flying) if (one.stop - one.start) * period_s > 2.0 * settings.settle_s):
            if groups and (part.start - groups[-1][-1].stop) * period_s <= bump_s:
                groups[-1].append(part)
            else:
                groups.append([part])
        runs = [_run(number, group, ticks, at, joints, period_s, settings) for group in groups]
        fitted = [run for run in runs if not run.reason]
        if not runs:
            runs = [ParabolaRun(number, (), reason="it was never let go: strapped down, or held all the time")]
        elif not fitted:
            runs = [max(runs, key=lambda run: run.catch_s - run.release_s)]
        found += fitted or runs
    return found


def _run(
    number: int, parts: Sequence[slice], ticks: Ticks, at: Any, joints: BoolArray, period_s: float, settings: Parabola
) -> ParabolaRun:
    time_s, margin = ticks.time_s, round(settings.settle_s / period_s)
    release_s, catch_s = float(time_s[parts[0].start]), float(time_s[parts[-1].stop - 1])
    bumps = tuple(float(0.5 * (time_s[a.stop - 1] + time_s[b.start])) for a, b in pairwise(parts))
    moving, inside = np.zeros((2, len(at)), np.bool_)
    for one in parts:
        moving[one] = at[one] == Stage.MOTION
        inside[one.start + margin : one.stop - margin] = True
    motions = _motions(moving, time_s)
    whole = [piece for piece in _spans(joints & inside) if piece.stop - piece.start > 2 * margin]
    reason = ""
    if sum(one.stop - one.start for one in whole) * period_s < settings.shortest_s:
        reason = f"free for {catch_s - release_s:.1f} s only"
    elif not motions:
        reason = "the arm did not move while the vehicle was free"
    return ParabolaRun(number, tuple(whole), release_s, catch_s, bumps, motions, reason)


def _low(force: FloatArray, period_s: float, limit: float) -> BoolArray:
    """Whether the aircraft falls freely at each tick, by the mean specific force; missing readings do not count."""
    width = max(1, round(WINDOW_s / period_s))
    kernel, known = np.ones(width), np.isfinite(force).all(axis=1)
    counts = np.convolve(known, kernel, "same")
    sums = np.column_stack([np.convolve(np.where(known, axis, 0.0), kernel, "same") for axis in force.T])
    size = np.linalg.norm(sums, axis=1) / np.maximum(counts, 1.0)
    return np.asarray((counts > 0.0) & (size < limit), np.bool_)


def _free(ticks: Ticks, period_s: float, settings: Parabola) -> BoolArray:
    """Free fall of the vehicle, tick by tick, in each stretch of time without a gap."""
    found = np.zeros(len(ticks.time_s), np.bool_)
    apart = np.flatnonzero(gaps(ticks.time_s, period_s)) + 1
    for one in np.split(np.arange(len(found)), apart):
        found[one] = is_free(ticks.measured[one, 3:6], ticks.sigma[one, 3:6], period_s, settings.free_m_s2)
    return found


def _motions(moving: BoolArray, time_s: FloatArray) -> tuple[tuple[float, float], ...]:
    """Begin and end of motions; a pause between strokes belongs to one."""
    found: list[slice] = []
    for one in _spans(moving):
        if found and one.start - found[-1].stop < SHORTEST:
            found[-1] = slice(found[-1].start, one.stop)
        else:
            found.append(one)
    long = [one for one in found if one.stop - one.start >= SHORTEST]
    return tuple((float(time_s[one.start]), float(time_s[one.stop - 1])) for one in long)


def _spans(true: Any) -> list[slice]:
    """Where it is true without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


_GUESS_kg = 1.0  # initial guess of the payload's mass


@dataclass
class _Flown:
    """A run that can be fitted."""

    run: ParabolaRun
    flight: WholeFlight
    said: Identified | None = None  # by itself
    start: FloatArray | None = None  # (p,) its own fit
    refused: str = ""


def identify_parabolas(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of the payload that was held in all runs of a log.

    Raises:
        ConfigError: no [parabola] in the vehicle file, or the file does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    settings = vehicle.file.parabola
    if settings is None:
        raise config.ConfigError(f"{vehicle.label}: no section [parabola], which says what free flight is")
    online, model = build_free_flyer(vehicle, tracked=False)
    payload = str(model.spec.payload_link)
    recorder = TickRecorder(payload, len(model.joints), online.further)
    fed(Estimator(vehicle, recorder), log, AT_ONCE_s)
    ticks, period_s = Ticks.joined(recorder.ticks), 1.0 / vehicle.file.estimation.row_rate_hz
    refused = named_refusals(recorder.refused)
    kept = Kept(log, payload, ticks, period_s, refused, useful_of(vehicle))
    runs = cut(ticks, period_s, settings)
    flown = [_Flown(run, _flight(online, ticks, run)) for run in runs if not run.reason]
    _each(online, kept, flown)
    found = _together(kept, flown)
    begin_s = float(ticks.time_s[0]) if len(ticks.time_s) else 0.0
    by_run = {id(one.run): one for one in flown}
    return replace(found, runs=tuple(_said(payload, run, by_run.get(id(run)), found, begin_s) for run in runs))


def _flight(online: MotionIdentifier, ticks: Ticks, run: ParabolaRun) -> WholeFlight:
    segments = [Segment(ticks.part(part), held=True) for part in run.parts]
    return WholeFlight(online.ekf.predictor, online.ekf.payload_sigma, segments)


def _each(online: MotionIdentifier, kept: Kept, flown: Sequence[_Flown]) -> None:
    """Fit and test every run by itself, the liveliest first: the others start from what it found."""
    constants = np.zeros(len(online.ekf.predictor.names) - 3)
    constants[0] = _GUESS_kg
    known = False
    for one in sorted(flown, key=lambda one: -_liveliness(one.flight)):
        try:
            start = one.flight.start(constants)
            made = fitted(one.flight, start, () if known else STAGES_s, lambda _: 0)
        except (EstimationError, ModelError):
            one.flight.free(())
            continue  # it may still count for something beside the others
        one.start = made.found.fit.x
        one.said = identified_of(kept, fitted_of(made, kept.period_s, online.row_names))
        one.refused = "; ".join(_against(made))
        if not one.refused and not known:
            constants, known = made.found.fit.x[: len(constants)].copy(), True


def _liveliness(flight: WholeFlight) -> float:
    return sum(float(np.abs(segment.ticks.dq).sum()) for segment in flight.segments)


def _against(made: Tested) -> tuple[str, ...]:
    """Why a run is not to be pooled: a test fails. That it determines little is no reason."""
    misfit = made.found.misfit
    against = made.findings.against
    against += (f"not as stated: {' or '.join(made.names)}",) * bool(made.names)
    return (*against, f"{misfit:.1f} times the noise is left over") if misfit > MISFIT_REFUSED else against


def _together(kept: Kept, flown: Sequence[_Flown]) -> Identified:
    """The estimate of all runs that agree."""
    seen = int(np.isfinite(kept.ticks.measured).sum())
    known = [one for one in flown if one.start is not None and not one.refused]
    if not known:
        why = "no run between release and catch could be used" if flown else "nothing was let go, or the arm rested"
        return no_answer(kept, seen, why)
    best = max(known, key=lambda one: _liveliness(one.flight))
    agreeing = [one for one in flown if not one.refused]
    while True:
        try:
            found = _pooled(agreeing, best)
        except (EstimationError, ModelError) as error:
            if len(agreeing) == len(known):
                return no_answer(kept, seen, f"the fit of all runs failed: {error}")
            agreeing = known  # without those that have no fit of their own
            continue
        worst = min(range(len(agreeing)), key=lambda k: found.disagreements[k].chance)
        test = found.disagreements[worst]
        if len(agreeing) < 3 or test.chance > of_each(REFUSE, len(agreeing)):
            break
        agreeing[worst].refused = test.text("it", "the others")
        agreeing = [one for one in agreeing if not one.refused]
        best = best if not best.refused else max(agreeing, key=lambda one: _liveliness(one.flight))
    doubts = [] if len(agreeing) > 1 else ["it is a single run"]
    if test.chance < of_each(REFUSE, len(agreeing)):
        doubts.append("the runs contradict each other, and nothing tells which is wrong")
    return identified_of(kept, _fitted(found, tuple(doubts)))


def _pooled(flown: Sequence[_Flown], best: _Flown) -> Pooled:
    """All runs in one fit, from the constants of the best one."""
    assert best.start is not None
    constants = best.start[: best.flight.constants]
    starts = [one.flight.start(constants) if one.start is None else one.start for one in flown]
    return Pool([one.flight for one in flown]).fit(starts, best.start)


def _fitted(found: Pooled, doubts: tuple[str, ...]) -> CheckedFit:
    against, _ = misfit_texts(found.by_instrument.items())
    return CheckedFit(
        found.payload,
        found.chi,
        found.chi_covariance,
        np.sqrt(np.diag(found.payload.covariance)),
        found.rows,
        found.misfit,
        max(1.0, found.misfit, *found.by_instrument.values()),
        {},
        found.held_out,
        "a single run was not checked on another",
        {},
        findings=Findings(tuple(against), doubts),
    )


def _said(payload: str, run: ParabolaRun, flown: _Flown | None, found: Identified, begin_s: float) -> RunAnswer:
    """What becomes of a run, all together being found so."""
    cut_of = {key: _since(value, begin_s) for key, value in run.as_json().items()} | {"log_start_s": begin_s}
    refused = run.reason if flown is None else flown.refused
    if not refused and not found.answers:
        refused = "the runs together gave no answer"
    if flown is None or refused:
        return RunAnswer(cut_of, "refused", refused, ())
    if flown.said is not None and flown.said.usable:
        answers = tuple(one for one in flown.said.answers if one.supported)
        return RunAnswer(cut_of, "identified", "", answers)
    missing = f"by itself it does not determine {BODY[0]}_{payload}; it counts beside the others"
    return RunAnswer(cut_of, "pooled", missing, ())


def _since(value: Any, begin_s: float) -> Any:
    """Times of a run since the log's first tick."""
    if isinstance(value, list):
        return [_since(one, begin_s) for one in value]
    return value - begin_s if isinstance(value, float) else value
