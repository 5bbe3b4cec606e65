"""A free-flyer's log by maximum likelihood, the whole flight in one fit.

The flight is divided at the changes of the payload, into segments with nothing held and with the payload that was
held the longest, and fitted by :mod:`onboard.identification.whole_flight.fit`, with all instruments that the flight
fused but one that was left out on board or contradicts the others
(:mod:`onboard.identification.whole_flight.witnesses`). Changes and starting values are those of the onboard answer in
the log. A log without one, or whose fit fails a test from there, is run through the recursive estimator first, and
the fit starts from its state.

How wide the smoothing of joints on a recorded base is, where its file does not say, its own motion tells. The base IMU
is predicted from smoothed joints. What a narrow kernel passes of rounded angles, differentiated twice, is taken for
motion and makes the payload too light; a wide one smooths the motion itself away. What is predicted is the same by
every width, so the width by which one half of the flight best predicts the other is taken.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.model.errors import ModelError, SignalError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError, EstimationError
from onboard.estimation.gates import named_refusals
from onboard.estimation.policy import MOSTLY
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.flight.estimate.readings.jumps import jumped_text
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.kinds import likelihood_log
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.as_recorded import FEWEST_SAMPLES, WIDTHS_ms, best_width, with_settings
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.identification.free_flyer.before_capture import (
    ANNOUNCED_s,
    BeforeCapture,
    Payload,
    Zeros,
    before_capture,
    margins_s,
)
from onboard.identification.free_flyer.misread import mistaken
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.recursion.recursive import feed_filter
from onboard.identification.free_flyer.steps import JumpedJoint
from onboard.identification.online import Change, CONTACT_s
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.segments import Changed, Segment, in_windows, pushed
from onboard.identification.whole_flight.witnesses import Tested, fitted
from onboard.identification.windows import SHORTEST, STAGES_s
from onboard.recording.reader import LogReader

_FLEXIBLE = "it does not know flexible joints, the filter on board does; see heft replay"
_TO_CHECK = (  # of a recording by other software
    "; check axes and units of the IMU, signs, units, order and zeros of the joints, the clock of each, and the URDF"
)


class _Onboard(NamedTuple):
    """What an onboard estimator found."""

    changes: Sequence[Change]
    constants: FloatArray  # of the predictor's state without the rate; zeros where nothing is known
    stages_s: tuple[float, ...]  # lengths that are fitted first: it is far from the minimum
    left_out: frozenset[str] = frozenset()  # instruments that it did without at the end


def identify_free_flyer(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of the payload that a free-flyer held the longest.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    online, model = build_free_flyer(vehicle, tracked=False)
    recorder = TickRecorder(str(model.spec.payload_link), len(model.joints), online.further)
    recorder.follows_jumps = True
    return _Flight(log, online, recorder, fed(Estimator(vehicle, recorder), log, AT_ONCE_s)).identified()


class _Flight:
    """The ticks of a flight, and the fits of them.

    Args:
        log: of it.
        online: a fresh estimator.
        recorder: of all ticks.
        estimator: that has made these.
    """

    def __init__(self, log: LogReader, online: MotionIdentifier, recorder: TickRecorder, estimator: Estimator) -> None:
        vehicle, predictor, jumps = estimator.vehicle, online.ekf.predictor, recorder.jumps
        settings = vehicle.file.estimation
        ticks, self._attached = Ticks.joined(recorder.ticks), np.concatenate(recorder.attached)
        self._jumps, times_s = jumps, [1e-9 * jump.vehicle_ns for _, jump in jumps]
        self._jumped = [(at_s, JumpedJoint(predictor, *one).changed) for at_s, one in zip(times_s, jumps, strict=True)]
        self._jumped_at: list[int] = np.searchsorted(ticks.time_s, times_s).tolist()
        self._vehicle, self._online, self._ticks, self._estimator = vehicle, online, ticks, estimator
        self._period_s = 1.0 / settings.row_rate_hz
        self._held = settings.exiddm.held_at_start or settings.carried is not None
        payload, refused = str(vehicle.file.vehicle.payload_link), named_refusals(recorder.refused)
        self._kept = likelihood_log.Kept(log, payload, ticks, self._period_s, refused, useful_of(vehicle))

    def identified(self) -> Identified:
        """Estimates and verdict of the flight."""
        kept = self._kept
        seen = int(np.isfinite(self._ticks.measured).sum())
        if self._online.ekf.predictor.bends.size:
            return likelihood_log.no_answer(kept, seen, f"the fit failed: {_FLEXIBLE}")
        if mistaken := self._misread():
            return likelihood_log.no_answer(kept, seen, mistaken, misread=True)
        failure, held_s = "", 0.0
        best: Tested | None = None
        for known in self._starts():
            segments, longest_s = self._segments(known.changes)
            if not segments:
                failure, held_s = "", max(held_s, longest_s)
                continue
            try:
                found, agrees = self._fitted_whole_or_in_windows(known, segments)
            except (EstimationError, ModelError) as error:
                failure = f"the fit failed: {error}{_TO_CHECK * self._vehicle.is_recorded}"
                continue
            if best is None or found.found.misfit < best.found.misfit:
                best = found
            if agrees:
                break
        if best is None:
            needed = f"{SHORTEST * self._period_s:g} s are needed"
            why = f"as a payload was held for {held_s:.2g} s, {needed}" if held_s else "while nothing was held"
            idle = {} if failure else {why: seen}
            return likelihood_log.no_answer(kept, seen if failure else 0, failure, idle=idle)
        if best.found.glitches:
            residual = kept.refused.get("residual", 0) + best.found.glitches
            kept = kept._replace(refused={**kept.refused, "residual": residual})
        checked = likelihood_log.fitted_of(best, self._period_s, self._online.row_names)
        return replace(likelihood_log.identified_of(kept, checked), before=self._before(best))

    def _misread(self) -> str:
        """As what a recording of somebody else is to be read so that a payload explains it; empty: as stated."""
        if not self._vehicle.is_recorded or not self._held or not self._attached.all():
            return ""
        ticks = self._ticks.part(slice(round(likelihood_log.LONGEST_S / self._period_s)))
        smoothing_s = 1e-3 * self._vehicle.file.estimation.smoothing_ms
        return mistaken(self._online.ekf.predictor, ticks, self._period_s, smoothing_s)

    def _before(self, made: Tested) -> BeforeCapture | None:
        """How the payload moved before it was captured; None where it was not, or what is needed is missing."""
        segments = made.flight.segments
        taken = [(k, a, b) for k, (a, b) in enumerate(pairwise(segments)) if b.held and not a.held]
        if not taken or 0 not in made.flight.devices:
            return None
        number, free, held = taken[0]
        from_s, until_s = float(free.ticks.time_s[-1]), float(held.ticks.time_s[0]) - CONTACT_s
        announced = until_s < from_s
        touched_s = (from_s - ANNOUNCED_s, from_s + ANNOUNCED_s) if announced else (from_s, until_s)
        before_s, after_s = margins_s(self._period_s)
        ends = touched_s[0] - before_s, touched_s[1] + after_s
        about = self._ticks.part(slice(*np.searchsorted(self._ticks.time_s, ends).tolist()))
        found, predictor = made.found, self._online.ekf.predictor
        state, zeros = made.flight.state(found.fit.x, number), Zeros(*made.flight.zeros(found.fit, touched_s[0]))
        try:
            payload = Payload(found.chi, found.chi_covariance)
            return before_capture(predictor, state, about, zeros, payload, touched_s)
        except SignalError:
            return None

    def _phase_at(self, time_s: float) -> int:
        return int(self._estimator.phase_at(np.array([round(1e9 * time_s)], np.int64))[0])

    def _fitted_whole_or_in_windows(self, known: _Onboard, segments: Sequence[Segment]) -> tuple[Tested, bool]:
        """As :meth:`_fitted`; in windows where something may push, or where no fit of whole segments converges."""
        parts, pushes = pushed(self._online.ekf.predictor, segments)
        changed = sorted([*self._jumped, *pushes], key=lambda one: one[0])
        try:
            return self._fitted(known, parts, changed)
        except ConvergenceError:
            if pushes:
                raise
            return self._fitted(known, in_windows(segments, self._period_s), changed)

    def _fitted(self, known: _Onboard, segments: Sequence[Segment], changed: Sequence[Changed]) -> tuple[Tested, bool]:
        """The fit with all instruments but those that contradict the others, its tests, and whether it passes them.

        ``changed``: errors that are others from some times on; no segment has ticks of before and after.

        Raises:
            EstimationError, ModelError: as :meth:`WholeFlight.fit`.
        """
        ekf, excluded = self._online.ekf, set[int]()
        names = ekf.predictor.instruments
        on_board = {at for at, name in enumerate(names) if name in known.left_out}
        hardly = {at: share for at, share in self._shares().items() if share < MOSTLY}

        def without(*more: int) -> WholeFlight:
            left_out = {*excluded, *hardly, *more}
            return WholeFlight(ekf.predictor, ekf.payload_sigma, segments, left_out, changed)

        failure: Exception | None = None
        for left_out in [set[int](), *([on_board] if on_board else [])]:  # that it was wrong may be known better now
            excluded.update(left_out)
            made, flight = None, without()
            start = flight.start(known.constants)
            try:
                made = fitted(flight, start, known.stages_s, self._phase_at)
                start = flight.start(made.found.fit.x[: flight.constants])
            except (EstimationError, ModelError) as error:
                failure = error
            if made is not None and made.passes:
                break
        if (made is None or not made.passes) and len(flight.devices) > 1 and not excluded:
            passing = list[tuple[int, Tested]]()
            for device in flight.devices:
                with suppress(EstimationError, ModelError):
                    found = fitted(without(device), start, STAGES_s, self._phase_at)
                    if found.passes:
                        passing.append((device, found))
            if len(passing) == 1:
                excluded, made = {passing[0][0]}, passing[0][1]
            elif passing and made is not None:
                either = " or ".join(names[device] for device, _ in passing)
                made = made.plus(against=[f"{either} contradicts the others"])
        if made is None:
            assert failure is not None
            raise failure
        doubts = [f"not as stated: {' or '.join(made.names)}"] if made.names else []
        doubts += [f"without {names[at]}, which contradicts the others" for at in sorted(excluded)]
        doubts += [f"without {names[at]}, of which {share:.0%} can be used" for at, share in hardly.items()]
        doubts += [jumped_text(", ".join(dict(self._jumps)))] * bool(self._jumps)
        several = [f"{' and '.join(names[at] for at in sorted(excluded))} contradict the others"] * (len(excluded) > 1)
        return made.plus(several, doubts), made.passes

    def _shares(self) -> dict[int, float]:
        """Of the ticks with any instrument, those with each one that is not the only IMU, by its number."""
        seen = np.isfinite(self._ticks.measured)
        ticks = max(1, int(seen.any(axis=1).sum()))
        predictor = self._online.ekf.predictor
        shares = {at: float(seen[:, own].all(axis=1).sum() / ticks) for at, own in enumerate(predictor.lines)}
        others = [shares[at] for at in range(1, len(predictor.imu_frames))]
        return shares if max(others, default=0.0) >= MOSTLY else {at: share for at, share in shares.items() if at}

    def _segments(self, changes: Sequence[Change]) -> tuple[list[Segment], float]:
        """Segments with nothing held and those of the payload held the longest, ``LONGEST_S`` of each at most.

        None where no payload was held for long enough; then, for how long one was, s.
        """
        runs = likelihood_log.runs_of(self._ticks, changes, self._held, self._period_s)
        held = likelihood_log.held_ticks(runs)
        most = max(held.values(), default=0)
        if most < SHORTEST:
            return [], self._period_s * most
        longest = max(held, key=lambda payload: held[payload])
        runs = self._without_pauses(runs, longest)
        chosen = [*self._some(runs, longest), *self._some(runs, 0)]
        found = list[Segment]()
        for run in sorted(chosen, key=lambda run: run.ticks.start):
            first, last = run.ticks.start, run.ticks.stop
            edges = sorted({first, *(at for at in self._jumped_at if first < at < last), last})
            found += [Segment(self._ticks.part(slice(*ends)), run.payload > 0) for ends in pairwise(edges)]
        return found, self._period_s * most

    def _without_pauses(self, runs: Sequence[likelihood_log.TickRun], payload: int) -> list[likelihood_log.TickRun]:
        """Runs with no pause of ``LONGEST_S`` between them and the longest one of a payload: biases drift meanwhile."""
        longest = max((run for run in runs if run.payload == payload), key=lambda run: run.ticks.stop - run.ticks.start)
        begins = self._ticks.time_s[[run.ticks.start for run in runs]]
        ends = self._ticks.time_s[[run.ticks.stop - 1 for run in runs]]
        stretch = np.concatenate([[0], np.cumsum(begins[1:] - ends[:-1] > likelihood_log.LONGEST_S)])
        return [run for run, own in zip(runs, stretch, strict=True) if own == stretch[runs.index(longest)]]

    def _some(self, runs: Sequence[likelihood_log.TickRun], payload: int) -> list[likelihood_log.TickRun]:
        left, found = round(likelihood_log.LONGEST_S / self._period_s), []
        for run in runs:
            ticks = slice(run.ticks.start, min(run.ticks.stop, run.ticks.start + left))
            if run.payload == payload and ticks.stop > ticks.start:
                found.append(likelihood_log.TickRun(ticks, payload))
                left -= ticks.stop - ticks.start
        return found

    def _starts(self) -> Iterator[_Onboard]:
        """Where a fit can begin: the onboard answer in the log, and what the recursive estimator says now."""
        said = likelihood_log.answer_in(self._kept.log)
        if said.payload is not None:
            rest = np.zeros(len(self._online.ekf.predictor.names) - PAYLOAD.stop)
            yield _Onboard(said.changes, np.concatenate([said.payload, rest]), (), said.left_out)
        yield self._again()

    def _again(self) -> _Onboard:
        """What the recursive estimator makes of the ticks."""
        ekf = self._online.ekf

        def take(ticks: Ticks) -> None:
            for at in range(0, len(ticks.time_s), BATCH_TICKS):
                ekf.update(ticks.part(slice(at, at + BATCH_TICKS)))

        feed_filter(ekf, self._ticks, self._attached, self._jumps, None, take)
        ekf.finish()
        size = len(ekf.predictor.names) - RATE.stop
        state = ekf.state if ekf.state is not None and ekf.held else np.zeros(size + RATE.stop)
        known = state[RATE.stop] > 0.0
        left_out = frozenset(ekf.fusion.contradicting)
        return _Onboard(list(ekf.changes), state[RATE.stop :].copy(), () if known else STAGES_s, left_out)


# Widths are tried in each order until the error grows: a fit of noise takes minutes.
*_NARROWER_ms, _WIDEST_ms = WIDTHS_ms


class ChosenWidth(NamedTuple):
    """A vehicle with the width of its smoothing, what is said of it, and the answer by it where it is known by now."""

    vehicle: config.Vehicle
    said: tuple[str, ...] = ()
    found: Identified | None = None


def with_chosen_width(
    vehicle: config.Vehicle, log: LogReader, identify: Callable[[config.Vehicle, LogReader], Identified] | None
) -> ChosenWidth:
    """A recorded vehicle that floats, with the width of smoothing that its recording asks for.

    As it is, without words, is any other vehicle, one whose file says how wide, and one whose recording does not tell.
    A recording whose mapping has a mistake is answered by the first width: by none it is another.

    Args:
        vehicle: its file.
        log: its recording.
        identify: estimates from it; None where rows do.
    """
    settings = vehicle.file.estimation
    floats = vehicle.prediction in (config.Prediction.FREE, config.Prediction.PLANAR)
    if identify is None or not floats or not vehicle.is_recorded or "smoothing_ms" in settings.model_fields_set:
        return ChosenWidth(vehicle)
    slowest_ms = 1e3 * max(signal.period_s for signal in roles_of(vehicle).signals.values())
    errors, tried = dict[float, float](), dict[float, Identified]()

    def try_in_turn(widths_ms: Sequence[float]) -> None:
        for width_ms in (one for one in widths_ms if one >= FEWEST_SAMPLES * slowest_ms):
            tried[width_ms] = identify(with_settings(vehicle, width_ms), log)
            held_out = tried[width_ms].held_out
            if held_out is None:
                break
            errors[width_ms] = math.sqrt(held_out.later.relative_error * held_out.earlier.relative_error)
            if errors[width_ms] > min(errors.values()):
                break

    try_in_turn(_NARROWER_ms[::-1])
    for width_ms, found in tried.items():
        if found.misread:
            return ChosenWidth(with_settings(vehicle, width_ms), (), found)
    try_in_turn([_WIDEST_ms] if errors else _NARROWER_ms[:-1])  # no fit by the widest: it smooths the motion away
    if not errors:
        return ChosenWidth(vehicle)
    best_ms, said = best_width(dict(sorted(errors.items())))
    return ChosenWidth(with_settings(vehicle, best_ms), (said,), tried[best_ms])
