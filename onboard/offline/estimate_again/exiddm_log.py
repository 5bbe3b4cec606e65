"""``heft identify --method exiddm``: a free-flyer's log by maximum likelihood, the whole flight in one fit.

The flight is divided at the changes of the payload, into segments with nothing held and with the payload that was held
the longest, and fitted by :mod:`onboard.identification.exiddm.whole_flight`. Changes and starting values are those of
the onboard answer in the log. A log without one, or whose fit leaves more than noise from there, is run through the
recursive estimator first, and the fit starts from its state.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.errors import ModelError
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import ReasonArray
from onboard.flight.answers import change_of
from onboard.flight.estimation import SUFFIX
from onboard.flight.estimator import Estimator
from onboard.flight.identification import build_exiddm
from onboard.identification.change import Change
from onboard.identification.exiddm.imu_prediction import PAYLOAD, RATE
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.identification.exiddm.parts import differences, halves
from onboard.identification.exiddm.recursive import BATCH_TICKS
from onboard.identification.exiddm.stated import Kind, freely, kinds_of, leans_on
from onboard.identification.exiddm.table_run import TableRun
from onboard.identification.exiddm.ticks import Ticks, ticks_of
from onboard.identification.exiddm.whole_flight import FlightFit, Segment, WholeFlight
from onboard.identification.quantities import Findings
from onboard.identification.verdict import WORST_MISFIT, Evidence
from onboard.offline.estimate_again.feed import feed
from onboard.offline.estimate_again.identified import Identified
from onboard.offline.estimate_again.likelihood_log import (
    LONGEST_S,
    SHORTEST_S,
    Fitted,
    Kept,
    Run,
    half_too_short,
    no_answer,
    runs_of,
    told,
)
from onboard.offline.estimate_again.residuals import Residuals, by_axis
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals

_DOUBTED, _REFUSED = 1e-4, 1e-6  # chance of a difference between parts of the flight
_NOT_AS_STATED = 1e-3  # chance of a correction, of a kind
_SUSPECT = 1.3  # misfit of an instrument beyond which another start is tried
_STAGES_s = (4.0,)  # part of each segment that is fitted first


_STEP_s = 1.0  # in which the log is read
_EVENTS = "event" + SUFFIX  # of the estimator, in a log


class _Recorder(TableRun):
    """Gates the ticks and keeps them."""

    def __init__(self, payload: str, joints: int) -> None:
        super().__init__(payload)
        self.ticks: list[Ticks] = [Ticks.none(joints)]
        self.attached: list[BoolArray] = [np.zeros(0, np.bool_)]

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        found = super().update(signals, attached, excluded)
        self.ticks.append(ticks_of(signals, np.where(found == 0, signals.measured, np.nan)))
        self.attached.append(attached)
        return found


class _Onboard(NamedTuple):
    """What an onboard estimator found."""

    changes: Sequence[Change]
    constants: FloatArray  # of the predictor's state without the rate; zeros where nothing is known
    stages_s: tuple[float, ...]  # lengths that are fitted first: it is far from the minimum


def identify_exiddm(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of the payload that a free-flyer held the longest.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    online, model = build_exiddm(vehicle, fused=False)
    payload = str(model.spec.payload_link)
    recorder = _Recorder(payload, len(model.joints))
    estimator = Estimator(vehicle, recorder)
    for _ in feed(estimator, log, _STEP_s):
        pass
    flight = _Flight(vehicle, online, Ticks.joined(recorder.ticks), np.concatenate(recorder.attached))
    refused = {str(reason.name).lower(): count for reason, count in recorder.refused.items() if count}

    def phase_at(time_s: float) -> int:
        return int(estimator.phase_at(np.array([round(1e9 * time_s)], np.int64))[0])

    return flight.identified(log, payload, refused, phase_at)


class _Flight:
    """The ticks of a flight, and the fits of them."""

    def __init__(self, vehicle: config.Vehicle, online: ExiddmIdentifier, ticks: Ticks, attached: BoolArray) -> None:
        settings = vehicle.file.estimation
        self._online, self._ticks, self._attached = online, ticks, attached
        self._period_s = 1.0 / settings.row_rate_hz
        self._held = settings.exiddm.held_at_start or settings.carried is not None

    def identified(
        self, log: LogReader, payload: str, refused: dict[str, int], phase_at: Callable[[float], int]
    ) -> Identified:
        """Estimates and verdict of the flight."""
        kept = Kept(log, payload, self._ticks, self._period_s, refused, {})
        seen = 6 * int(np.isfinite(self._ticks.measured).all(axis=1).sum())
        failure = ""
        best: tuple[WholeFlight, FlightFit] | None = None
        for known in self._starts(log):
            segments = self._segments(known.changes)
            if not any(one.held for one in segments):
                failure = ""
                continue
            flight = WholeFlight(self._online.exiddm.predictor, self._online.exiddm.payload_sigma, segments)
            try:
                found = flight.fit(flight.start(known.constants), known.stages_s)
            except (EstimationError, ModelError) as error:
                failure = f"the fit failed: {error}"
                continue
            if best is None or found.misfit < best[1].misfit:
                best = flight, found
            if max(found.by_instrument.values()) < _SUSPECT:
                break
        if best is None:
            idle = {} if failure else {"while nothing was held": seen}
            return no_answer(kept._replace(idle=idle), seen if failure else 0, failure)
        flight, found = best
        corrections, kinds = _corrections(flight, found), kinds_of(flight, found)
        try:
            found = freely(flight, found, kinds)
        except EstimationError as error:
            return no_answer(kept, seen, f"the fit failed: {kinds[0].text}, and without that: {error}")
        if found.glitches:
            refused = {**refused, "residual": refused.get("residual", 0) + 6 * found.glitches}
        left = by_axis(*flight.residuals(found.fit.x), self._period_s)
        return told(kept._replace(refused=refused), _fitted(flight, found, phase_at, corrections, kinds, left))

    def _segments(self, changes: Sequence[Change]) -> list[Segment]:
        """Segments with nothing held and those of the payload held the longest, ``LONGEST_S`` of each at most."""
        runs = runs_of(self._ticks, changes, self._held, self._period_s)
        lengths: dict[int, int] = {}
        for run in runs:
            lengths[run.payload] = lengths.get(run.payload, 0) + run.ticks.stop - run.ticks.start
        held = {payload: ticks for payload, ticks in lengths.items() if payload > 0}
        if not held or max(held.values()) * self._period_s < SHORTEST_S:
            return []
        longest = max(held, key=lambda payload: held[payload])
        runs = self._without_pauses(runs, longest)
        chosen = [*self._some(runs, longest), *self._some(runs, 0)]
        return [Segment(self._ticks.part(run.ticks), run.payload > 0) for run in sorted(chosen, key=_begin)]

    def _without_pauses(self, runs: Sequence[Run], payload: int) -> list[Run]:
        """Runs with no pause of ``LONGEST_S`` between them and the longest one of a payload: biases drift meanwhile."""
        longest = max((run for run in runs if run.payload == payload), key=lambda run: run.ticks.stop - run.ticks.start)
        begins, ends = (self._ticks.time_s[[at(run) for run in runs]] for at in (_begin, _end))
        stretch = np.concatenate([[0], np.cumsum(begins[1:] - ends[:-1] > LONGEST_S)])
        return [run for run, own in zip(runs, stretch, strict=True) if own == stretch[runs.index(longest)]]

    def _some(self, runs: Sequence[Run], payload: int) -> list[Run]:
        left, found = round(LONGEST_S / self._period_s), []
        for run in runs:
            ticks = slice(run.ticks.start, min(run.ticks.stop, run.ticks.start + left))
            if run.payload == payload and ticks.stop > ticks.start:
                found.append(Run(ticks, payload))
                left -= ticks.stop - ticks.start
        return found

    def _starts(self, log: LogReader) -> Iterator[_Onboard]:
        """Where a fit can begin: the onboard answer in the log, and what the recursive estimator says now."""
        in_log = self._in_log(log)
        if in_log is not None:
            yield in_log
        yield self._again()

    def _in_log(self, log: LogReader) -> _Onboard | None:
        """The onboard answer that the log has; None without one."""
        changes: list[Change] = []
        mean = np.zeros(10)
        for name, rows in log.batches([name for name in ("estimate", _EVENTS) if name in log.channels]):
            if name == _EVENTS:
                changes += [change for change in map(change_of, rows) if change is not None]
            elif rows["mean"].shape[1:] == (10,):
                known = np.isfinite(rows["mean"]).all(axis=1) & (rows["mean"][:, 0] > 0.0)
                mean = rows["mean"][known][-1] if known.any() else mean
        if not mean[0] > 0.0:
            return None
        rest = np.zeros(len(self._online.exiddm.predictor.names) - PAYLOAD.stop)
        return _Onboard(sorted(changes, key=lambda change: change.time_s), np.concatenate([mean, rest]), ())

    def _again(self) -> _Onboard:
        """What the recursive estimator makes of the ticks."""
        exiddm, before = self._online.exiddm, None
        edges = [0, *(np.flatnonzero(np.diff(self._attached)) + 1), len(self._attached)]
        for first, last in pairwise(edges):
            held = bool(self._attached[first]) if last > first else before
            if before is not None and held != before:
                exiddm.told(bool(held), float(self._ticks.time_s[first]))
            before = held
            for at in range(first, last, BATCH_TICKS):
                exiddm.update(self._ticks.part(slice(at, min(at + BATCH_TICKS, last))))
        exiddm.finish()
        size = len(exiddm.predictor.names) - RATE.stop
        state = exiddm.state if exiddm.state is not None and exiddm.held else np.zeros(size + RATE.stop)
        known = state[RATE.stop] > 0.0
        return _Onboard(list(exiddm.changes), state[RATE.stop :].copy(), () if known else _STAGES_s)


def _begin(run: Run) -> int:
    return int(run.ticks.start)


def _end(run: Run) -> int:
    return int(run.ticks.stop) - 1


def _corrections(flight: WholeFlight, found: FlightFit) -> dict[str, float]:
    """What was fitted besides the payload, in the sigmas that are stated."""
    return {
        name: float(x / sigma)
        for name, x, sigma in zip(found.names[10:], found.fit.x[10:], flight.sigma[10:], strict=True)
        if np.isfinite(sigma)
    }


def _fitted(
    flight: WholeFlight,
    found: FlightFit,
    phase_at: Callable[[float], int],
    corrections: Mapping[str, float],
    kinds: Sequence[Kind],
    residuals: Residuals,
) -> Fitted:
    """The checks of a fit: halves, parts, instruments, corrections as they were within the stated sigmas."""
    held_out, unchecked = None, ""
    try:
        held_out = halves(flight, found)
    except EstimationError as error:
        unchecked = half_too_short(error)
    against, doubts = [], []
    for difference in differences(found, phase_at):
        said = f"{difference.part} tells another payload than the rest (chi-squared {difference.squares:.0f} of "
        said += f"{difference.freedom})"
        if difference.chance < _REFUSED:
            against.append(said)
        elif difference.chance < _DOUBTED:
            doubts.append(said)
    for instrument, misfit in found.by_instrument.items():
        if misfit > WORST_MISFIT:
            against.append(f"residuals of the {instrument} are {misfit**0.5:.1f} times its noise")
        elif misfit > _SUSPECT:
            doubts.append(f"residuals of the {instrument} are {misfit**0.5:.1f} times its noise")
    rows = sum(block.rows for block in found.blocks)
    wider = max(1.0, found.misfit, *found.by_instrument.values())
    against += [kind.text for kind in kinds if kind.chance < _REFUSED]
    doubts += [kind.text for kind in kinds if _REFUSED <= kind.chance < _NOT_AS_STATED]
    return Fitted(
        found.payload,
        found.chi,
        found.chi_covariance,
        rows,
        found.misfit,
        wider,
        corrections,
        held_out,
        unchecked or Evidence._field_defaults["unchecked"],
        residuals,
        findings=Findings(tuple(against), tuple(doubts)),
        leans=leans_on(flight, found),
    )
