"""``heft identify`` of a run on an air-bearing table: payload and drag of each puck by maximum likelihood.

The log goes through the estimator that flies, which makes the ticks; the longest time that the payload was held, in the
phases to identify in, is then fitted as a whole (:mod:`onboard.identification.exiddm.air_bearing`). Payload and drag of
each half predict the other half.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from onboard import config
from onboard.dynamics.errors import ModelError
from onboard.dynamics.payload import standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import GateReason, ReasonArray
from onboard.estimation.maximum_likelihood import fit
from onboard.flight.estimator import Estimator
from onboard.flight.identification import build_planar, exiddm_prior, samples_per_tick
from onboard.flight.roles import roles_of
from onboard.identification.exiddm.air_bearing import AirBearingPrior, DragPrior, PlanarExiddm, PlanarFit
from onboard.identification.exiddm.table_run import TableRun
from onboard.identification.exiddm.window import Ticks, ticks_of
from onboard.identification.observability import subspace
from onboard.identification.quantities import BODY, SUPPORTED_SHRINKAGE
from onboard.identification.rows.held_out import HeldOut, Prediction
from onboard.identification.rows.standard import link_estimate
from onboard.identification.verdict import Evidence, verdict
from onboard.offline.estimate_again.exiddm_log import EXIDDM, NOTHING, SHORTEST_S, body_answers, body_seen, longest_held
from onboard.offline.estimate_again.feed import feed
from onboard.offline.estimate_again.identified import Answer, Identified
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals

_PAYLOAD = slice(3, 13)
_OF_A_RUN = ("velocity", "rate", "tilt", "gyro_bias", "accelerometer_bias")  # not of the vehicle
_LEVEL = 0.95
_UNDERWAY_m_s = 0.5  # what the velocity may be at any other time than at the start


class _Recorder(TableRun):
    """What flies; it keeps its ticks, without joints where there is nothing to identify."""

    def __init__(self, payload: str, joints: int) -> None:
        super().__init__(payload)
        self.kept: list[Ticks] = [Ticks.none(joints)]
        self._told: list[BoolArray] = [np.zeros(0, np.bool_)]

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        found = super().update(signals, attached, excluded)
        told = attached & ((excluded & GateReason.PHASE) == 0)
        self._told.append(told)
        q, dq, ddq = (np.where(told[:, None], x, np.nan) for x in (signals.q, signals.dq, signals.ddq))
        measured = np.where(found == 0, signals.measured, np.nan)
        self.kept.append(ticks_of(signals._replace(q=q, dq=dq, ddq=ddq), measured))
        return found

    def begins_at(self, time_s: float) -> bool:
        """Whether a run begins at a tick: none with joints is before it since there is something to identify."""
        told = np.concatenate(self._told)
        known = np.concatenate([np.isfinite(ticks.q).all(axis=1) for ticks in self.kept])
        here = int(np.searchsorted(np.concatenate([ticks.time_s for ticks in self.kept]), time_s))
        silent = np.append(-1, np.flatnonzero(~told[:here]))
        return not known[silent[-1] + 1 : here].any()


class _Table(NamedTuple):
    """The vehicle, and what is known of it before the run."""

    vehicle: VehicleModel
    imu_frame: str
    period_s: float
    samples: int  # in a tick
    links: dict[str, FloatArray]
    payload_sigma: FloatArray
    doubt: AirBearingPrior

    def exiddm(self, ticks: Ticks, *, let_go: bool) -> PlanarExiddm:
        """The estimator of these ticks; ``let_go``: the first of them is where the run begins."""
        doubt = self.doubt if let_go else self.doubt._replace(velocity_m_s=_UNDERWAY_m_s)
        spread = np.nanmedian(ticks.sigma, axis=0)
        measured = ticks.measured[:, :3], ticks.measured[:, 3:]
        signals = FlightSignals(
            self.period_s, ticks.q, ticks.dq, ticks.ddq, *measured, spread[:3], spread[3:], self.samples
        )
        return PlanarExiddm(self.vehicle, self.imu_frame, signals, self.payload_sigma, self.links, doubt)


def identify_planar(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """What a log of a run on the table says of payload and drag.

    Raises:
        ConfigError: no [planar] in the vehicle file, or the file does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    asked = vehicle.file.planar
    if asked is None:
        raise config.ConfigError(f"{vehicle.path}: no section [planar]; it tells table and pucks")
    _, model = build_planar(vehicle)
    payload = str(model.spec.payload_link)
    recorder = _Recorder(payload, len(model.joints))
    for _ in feed(Estimator(vehicle, recorder), log):
        pass
    links, imu, payload_sigma = exiddm_prior(vehicle, model)
    pucks = {puck.frame: DragPrior(puck.viscous_sigma_N_s_m, puck.coulomb_sigma_N) for puck in asked.puck}
    doubt = AirBearingPrior(asked.velocity_sigma_m_s, asked.rate_sigma_rad_s, pucks, asked.tilt_sigma_m_s2, imu)
    period_s = 1.0 / vehicle.file.estimation.row_rate_hz
    frame = roles_of(vehicle).imu.frame
    table = _Table(model, frame, period_s, samples_per_tick(vehicle), links, payload_sigma, doubt)
    refused = {str(reason.name).lower(): count for reason, count in recorder.refused.items() if count}
    ticks = longest_held(recorder.kept, (), held=True, period_s=period_s)
    used = 6 * int(np.isfinite(ticks.measured).all(axis=1).sum())
    nothing = dict.fromkeys([f"{name}_{payload}" for name in BODY], False)
    if len(ticks.time_s) * period_s < SHORTEST_S or not used:
        none = verdict(Evidence(0, refused, nothing, None))
        return Identified(log.path, EXIDDM, (), 0, refused, log.damage, none)
    let_go = recorder.begins_at(float(ticks.time_s[0]))
    try:
        exiddm = table.exiddm(ticks, let_go=let_go)
        found = exiddm.fit()
    except (EstimationError, ModelError) as error:
        gave_up = verdict(Evidence(used, refused, nothing, None, failure=f"the fit gave up: {error}"))
        return Identified(log.path, EXIDDM, (), used, refused, log.damage, gave_up)
    held_out, unchecked = None, Evidence._field_defaults["unchecked"]
    if not found.reason:
        try:
            held_out = _held_out(table, ticks, exiddm, found, let_go=let_go)
        except (EstimationError, ModelError) as error:
            unchecked = f"not checked on motion that was not used: half of the run tells too little ({error})"
    misfit = found.fit.residual_sum / found.freedom
    wider = max(1.0, misfit)  # what the model leaves is not less than the noise
    link = link_estimate(payload, found.fit.x[_PAYLOAD], wider * found.fit.covariance[_PAYLOAD, _PAYLOAD])
    body = found.payload._replace(body=link.body or found.payload.body)
    answers = (*body_answers(tuple(nothing), *body, wider), *_drags(found, pucks, wider))
    if found.reason:
        answers = tuple(answer._replace(supported=False) for answer in answers)
    evidence = Evidence(
        used,
        refused,
        {answer.name: answer.supported for answer in answers},
        held_out,
        failure=found.reason,
        away={link.link: link.away},
        misfit=misfit,
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
        held_out=held_out,
        misfit=misfit,
        subspace=subspace(body_seen(body), tuple(nothing)),
        links=(link,),
    )


def _drags(found: PlanarFit, pucks: dict[str, DragPrior], wider: float) -> list[Answer]:
    """Drag of each puck; supported when the data make it five times better known than it was."""
    names = [(f"{kind}_{frame}", unit) for frame in pucks for kind, unit in (("Fv", "N s/m"), ("Fc", "N"))]
    prior = [sigma for puck in pucks.values() for sigma in puck]
    reach = float(ndtri(0.5 + 0.5 * _LEVEL))
    answers = []
    for (name, unit), known, value, bound in zip(
        names, prior, found.drag.tolist(), found.drag_sigma.tolist(), strict=True
    ):
        sigma = wider**0.5 * bound
        half = reach * sigma
        fine = sigma <= SUPPORTED_SHRINKAGE * known
        answers.append(Answer(name, unit, value, sigma, value - half, value + half, fine, bound))
    return answers


def _held_out(table: _Table, ticks: Ticks, exiddm: PlanarExiddm, found: PlanarFit, *, let_go: bool) -> HeldOut | None:
    """Each half of the ticks with what the other says."""
    middle = len(ticks.time_s) // 2
    if middle * table.period_s < SHORTEST_S:
        return None
    earlier = table.exiddm(ticks.part(slice(0, middle)), let_go=let_go)
    later = table.exiddm(ticks.part(slice(middle, None)), let_go=False)
    first, second, whole = earlier.fit().fit.x, later.fit().fit.x, found.fit.x
    return HeldOut(
        _prediction(later, first, second), _prediction(earlier, second, first), _prediction(exiddm, whole, whole)
    )


def _prediction(exiddm: PlanarExiddm, x: FloatArray, own: FloatArray) -> Prediction:
    """What these parameters leave of an estimator's ticks, beside what is left when the payload is taken away.

    The velocity at the start, the tilt along the axes at the start, and the biases at the time are found anew; payload,
    drag, links and the rest of the IMU's errors stay. ``own``: what these ticks say by themselves, to begin with.
    """
    anew = np.array([k for k, name in enumerate(exiddm.names) if name.startswith(_OF_A_RUN)])
    tried = x.copy()

    def residuals(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        tried[anew] = z
        r, J = exiddm.residuals(tried)
        return r, J[:, anew]

    done = fit(residuals, own[anew], np.zeros(anew.size), exiddm.prior_information[np.ix_(anew, anew)], tolerance=1.0)
    tried[anew], tried[_PAYLOAD] = done.x, standard_of(NOTHING)
    none, _ = exiddm.residuals(tried)
    return Prediction(float(np.sqrt(done.residual_sum / (none @ none))), done.residual_sum / none.size)
