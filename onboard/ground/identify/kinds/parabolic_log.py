"""``heft identify`` of parabolic flights: each run between release and catch by itself, and all of them together.

The log is cut by :mod:`onboard.ground.identify.kinds.parabolas`. Every run is fitted and tested as a flight of its
own, and refused where a test fails. The answer pools the others (:mod:`onboard.identification.whole_flight.pooled`),
also those that determine too little by themselves; a run whose payload differs from that of all is named and left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from onboard import config
from onboard.dynamics.model.errors import ModelError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import named_refusals
from onboard.estimation.policy import MISFIT_REFUSED, REFUSE, of_each
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.ground.identify.kinds.identified import Identified, RunAnswer
from onboard.ground.identify.kinds.likelihood_log import CheckedFit, Kept, fitted_of, identified_of, no_answer
from onboard.ground.identify.kinds.parabolas import ParabolaRun, cut
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.identification.corrections import misfit_texts
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.quantities import BODY, Findings
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.pooled import Pool, Pooled
from onboard.identification.whole_flight.segments import Segment
from onboard.identification.whole_flight.witnesses import Tested, fitted
from onboard.identification.windows import STAGES_s
from onboard.recording.reader import LogReader

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
