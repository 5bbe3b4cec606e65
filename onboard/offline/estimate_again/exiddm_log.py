"""``heft identify --method exiddm``: a free-flyer's log by maximum likelihood.

The log goes through the estimator that flies, which finds when something was captured and let go and makes the ticks;
the ticks of the longest time that one payload was held are then fitted as a whole
(:mod:`onboard.identification.exiddm.batch`). The payload of each half of them predicts the other half, the momentum
found anew.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from onboard import config
from onboard.dynamics.errors import ModelError
from onboard.dynamics.inertia import RigidBody, elements
from onboard.dynamics.payload import BodyEstimate, body_of
from onboard.dynamics.ticks import FlightSignals
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import ReasonArray
from onboard.estimation.maximum_likelihood import fit
from onboard.estimation.rls import Observability
from onboard.flight.estimator import Estimator
from onboard.flight.identification import build_exiddm, exiddm_prior
from onboard.flight.roles import roles_of
from onboard.identification.change import Change
from onboard.identification.exiddm.batch import ImuPrior, NonLinearExiddm, PayloadFit
from onboard.identification.exiddm.window import Ticks, ticks_of
from onboard.identification.observability import subspace
from onboard.identification.online import ExiddmIdentifier
from onboard.identification.quantities import BODY_UNITS, SUPPORTED_SHRINKAGE
from onboard.identification.rows.held_out import HeldOut, Prediction
from onboard.identification.rows.standard import link_estimate
from onboard.identification.verdict import Evidence, verdict
from onboard.offline.estimate_again.feed import feed
from onboard.offline.estimate_again.identified import Answer, Identified
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals

EXIDDM = "exiddm"
LONGEST_S = 60.0  # of flight that is fitted as a whole
SHORTEST_S = 2.0
NOTHING = RigidBody(1e-9, np.zeros(3), 1e-9 * np.eye(3))
_PAYLOAD = slice(3, 13)
_LEVEL = 0.95


class _Recorder(ExiddmIdentifier):
    """The identifier that flies; it keeps its ticks."""

    def __init__(self, online: ExiddmIdentifier) -> None:
        super().__init__(online.exiddm)
        self.kept: list[Ticks] = []

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        found = super().update(signals, attached, excluded)
        measured = np.where(found == 0, signals.measured, np.nan)
        self.kept.append(ticks_of(signals, measured))
        return found


class _Flight(NamedTuple):
    """The vehicle, and what is known of it before the flight."""

    vehicle: VehicleModel
    imu_frame: str
    period_s: float
    samples: int  # in a tick
    prior: tuple[dict[str, FloatArray], ImuPrior, FloatArray]  # of links, of the IMU, sigmas of a payload

    def exiddm(self, ticks: Ticks) -> NonLinearExiddm:
        """The estimator of these ticks."""
        rate, force = ticks.measured[:, :3], ticks.measured[:, 3:]
        spread = np.nanmedian(ticks.sigma, axis=0)
        signals = FlightSignals(
            self.period_s, ticks.q, ticks.dq, ticks.ddq, rate, force, spread[:3], spread[3:], self.samples
        )
        links, doubt, payload_sigma = self.prior
        return NonLinearExiddm(self.vehicle, self.imu_frame, signals, payload_sigma, links, doubt)


def identify_exiddm(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """What a log of a free-flyer says of the payload that it held the longest.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    online, model = build_exiddm(vehicle)
    recorder = _Recorder(online)
    for _ in feed(Estimator(vehicle, recorder), log):
        pass
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    period_s = 1.0 / settings.row_rate_hz
    samples = round(period_s / roles.signals[roles.imu.channels[0]].period_s)
    flight = _Flight(model, roles.imu.frame, period_s, samples, exiddm_prior(vehicle, model))
    refused = {str(reason.name).lower(): count for reason, count in recorder.refused.items() if count}
    nothing_yet = Ticks.none(len(model.joints))
    changes, held = online.exiddm.changes, settings.exiddm.held_at_start or settings.carried is not None
    ticks = longest_held([nothing_yet, *recorder.kept], changes, held, period_s)
    used = 6 * int(np.isfinite(ticks.measured).all(axis=1).sum())
    names = recorder.quantity_names
    nothing = dict.fromkeys(names, False)
    if len(ticks.time_s) * period_s < SHORTEST_S or not used:
        none = verdict(Evidence(0, {**refused, "while nothing was held": recorder.rows_used}, nothing, None))
        return Identified(log.path, EXIDDM, (), 0, refused, log.damage, none)
    exiddm = flight.exiddm(ticks)
    try:
        found = exiddm.fit()
        held_out = _held_out(flight, ticks, exiddm, found)
    except (EstimationError, ModelError) as error:
        gave_up = verdict(Evidence(used, refused, nothing, None, failure=f"the fit gave up: {error}"))
        return Identified(log.path, EXIDDM, (), used, refused, log.damage, gave_up)
    misfit = found.fit.residual_sum / found.freedom
    wider = max(1.0, misfit)  # what the model leaves is not less than the noise
    link = link_estimate(
        str(model.spec.payload_link), found.fit.x[_PAYLOAD], wider * found.fit.covariance[_PAYLOAD, _PAYLOAD]
    )
    body = found.payload._replace(body=link.body or found.payload.body)
    answers = body_answers(names, *body, wider)
    asked = {answer.name: answer.supported for answer in answers}
    evidence = Evidence(used, refused, asked, held_out, away={link.link: link.away}, misfit=misfit)
    return Identified(
        log.path,
        EXIDDM,
        answers,
        used,
        refused,
        log.damage,
        verdict(evidence),
        held_out=held_out,
        misfit=misfit,
        subspace=subspace(body_seen(body), names),
        links=(link,),
    )


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
            number = {"capture": count, "ejection": 0}.get(change.kind, number)
    which[~whole] = 0
    joined = (np.diff(which) == 0) & (np.abs(np.diff(ticks.time_s) / period_s - 1.0) < 0.5)
    edges = [0, *(np.flatnonzero(~joined) + 1), len(which)]
    runs = [slice(a, b) for a, b in pairwise(edges) if b > a and which[a]]
    longest = max(runs, key=lambda run: run.stop - run.start, default=slice(0, 0))
    return ticks.part(slice(longest.start, min(longest.stop, longest.start + round(LONGEST_S / period_s))))


def body_answers(names: tuple[str, ...], body: RigidBody, covariance: FloatArray, wider: float) -> tuple[Answer, ...]:
    """Each is supported when it is known to a fifth of the body's own size."""
    values = np.array([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
    bound = np.sqrt(np.diag(covariance))
    sigma = bound * np.sqrt(wider)
    half = float(ndtri(0.5 + 0.5 * _LEVEL)) * sigma
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
    """The payload's ten numbers against its own size, as if that had been the prior."""
    size = _size(payload.body)
    values, vectors = np.linalg.eigh(payload.covariance / np.outer(size, size))
    gain = 1.0 / np.maximum(values[::-1], np.finfo(np.float64).tiny) - 1.0  # ascending
    shrinkage = np.sqrt(np.diag(payload.covariance)) / size
    return Observability(shrinkage, np.maximum(gain, 0.0), size[:, None] * vectors[:, ::-1])


def _held_out(flight: _Flight, ticks: Ticks, exiddm: NonLinearExiddm, found: PayloadFit) -> HeldOut | None:
    """Each half of the ticks with what the other says."""
    middle = len(ticks.time_s) // 2
    if middle * flight.period_s < SHORTEST_S:
        return None
    earlier, later = (flight.exiddm(ticks.part(part)) for part in (slice(0, middle), slice(middle, None)))
    return HeldOut(
        _prediction(later, earlier.fit().fit.x),
        _prediction(earlier, later.fit().fit.x),
        _prediction(exiddm, found.fit.x),
    )


def _prediction(exiddm: NonLinearExiddm, x: FloatArray) -> Prediction:
    """What these parameters leave of an estimator's ticks, beside what is there without a payload.

    The momentum and the biases at the time are found anew; payload, links and the rest of the IMU's errors stay.
    """
    passing = ("momentum", "gyro_bias", "accelerometer_bias")
    anew = np.array([k for k, name in enumerate(exiddm.names) if name.startswith(passing)])
    start = x.copy()
    start[:3] = exiddm.start(body_of(x[_PAYLOAD]))[:3]

    def residuals(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        tried = start.copy()
        tried[anew] = z
        r, J = exiddm.residuals(tried)
        return r, J[:, anew]

    done = fit(residuals, start[anew], start[anew], np.zeros((anew.size, anew.size)))
    none, _ = exiddm.residuals(exiddm.start(NOTHING))
    return Prediction(float(np.sqrt(done.residual_sum / (none @ none))), done.residual_sum / none.size)
