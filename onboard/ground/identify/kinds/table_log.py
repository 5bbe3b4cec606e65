"""``heft identify`` of a run on an air bearing: of a table, payload and drag of each puck; spherical, the body.

Of a table the onboard estimator makes the ticks; the longest interval with the payload in the identification phases is
then fitted in one batch. Payload and drag of each half predict the other half
(:func:`onboard.identification.free_flyer.batch.held_out`), with velocity and tilt at its first tick re-estimated.

On a spherical bearing it is the onboard estimator's fit of all ticks.
"""

from collections.abc import Callable, Mapping

import numpy as np

from onboard import config
from onboard.dynamics.model.errors import ModelError
from onboard.estimation.arrays import BoolArray, finite
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import GateReason, ReasonArray, named_refusals
from onboard.estimation.smoothing import uncorrelated_s
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import samples_per_tick
from onboard.flight.estimate.problem.priors import free_flyer_prior, geometry_prior, imu_prior_of
from onboard.flight.estimate.problem.table import build_table
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.ground.identify.kinds.identified import Identified, answers_of, by_axis, judged, standings
from onboard.ground.identify.kinds.likelihood_log import (
    CheckedFit,
    Kept,
    half_too_short,
    identified_of,
    longest_held,
    no_answer,
)
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.identification.corrections import contradicted
from onboard.identification.free_flyer.batch import MotionFit, PayloadFit, held_out
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.pivot.online import PivotRun
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, QuantityEstimate
from onboard.identification.table import air_bearing, floating_base
from onboard.identification.table.rivals import answered
from onboard.identification.verdict import TOO_SHORT, Evidence
from onboard.identification.windows import SHORTEST
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals

_UNDERWAY_m_s = 0.5  # sigma of the velocity at any time but the start


class PlanarTickRecorder(TickRecorder):
    """Keeps ticks without joints outside identification phases; ``attached``: within."""

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """See :class:`TickRecorder`."""
        told: BoolArray = np.asarray(attached & ((excluded & GateReason.PHASE) == 0), np.bool_)
        found = super().update(signals, told, excluded)
        q, dq, ddq = (np.where(told[:, None], x, np.nan) for x in self.ticks[-1][1:4])
        self.ticks[-1] = self.ticks[-1]._replace(q=q, dq=dq, ddq=ddq)
        return found

    def begins_at(self, time_s: float) -> bool:
        """Whether a run begins at a tick: none with joints is before it since there is something to identify."""
        ticks, told = Ticks.joined(self.ticks), np.concatenate(self.attached)
        known, here = finite([ticks.q]), int(np.searchsorted(ticks.time_s, time_s))
        silent = np.append(-1, np.flatnonzero(~told[:here]))
        return not known[silent[-1] + 1 : here].any()


def identify_table(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of payload and drag from a run on the table.

    Raises:
        ConfigError: no [planar] in the vehicle file, or the file does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    _, model = build_table(vehicle)
    at_start = table_prior(vehicle)._replace(geometry=geometry_prior(vehicle, model))
    payload = str(model.spec.payload_link)
    recorder = PlanarTickRecorder(payload, len(model.joints))
    fed(Estimator(vehicle, recorder), log, AT_ONCE_s)
    period_s, samples = 1.0 / vehicle.file.estimation.row_rate_hz, samples_per_tick(vehicle)
    frame = roles_of(vehicle).imu.frame
    links, _, payload_sigma = free_flyer_prior(vehicle, model)
    refused = named_refusals(recorder.refused)
    ticks = longest_held(recorder.ticks, (), held=True, period_s=period_s)
    let_go = len(ticks.time_s) > 0 and recorder.begins_at(float(ticks.time_s[0]))

    def build(some: Ticks, first: bool) -> air_bearing.TableFit:
        prior, run = at_start if first and let_go else underway(at_start), some.flight(period_s, samples)
        return air_bearing.TableFit(model, frame, run.coarser(ticks_together(vehicle)), payload_sigma, links, prior)

    return _identified(Kept(log, payload, ticks, period_s, refused, useful_of(vehicle)), build, at_start.pucks)


def _identified(
    kept: Kept,
    build: Callable[[Ticks, bool], air_bearing.TableFit],
    pucks: Mapping[str, floating_base.DragPrior],
) -> Identified:
    """Estimates and verdict of a log's longest interval with one payload.

    Args:
        kept: its ticks.
        build: makes the estimator of some of them, be their first the first of all or not.
        pucks: what is known of their drag, by frame.
    """
    ticks = kept.ticks
    seen = finite([ticks.measured])
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
    drags, reason = _drags(corrected, pucks, wider)
    halves, unchecked, middle = None, TOO_SHORT, len(ticks.time_s) // 2
    if not (seen[:middle].any() and seen[middle:].any()):
        unchecked = half_too_short("of which the IMU has no reading")
    elif not reason and middle >= SHORTEST:
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
    checked = CheckedFit(*numbers, used, stated.misfit, wider, corrections, halves, unchecked, left)
    return identified_of(kept, checked._replace(further=drags, reason=reason, findings=findings))


def _corrections(motion_fit: MotionFit, found: PayloadFit, payload: str) -> dict[str, float]:
    """What was fitted besides the payload, in the sigmas that were stated; nothing of what has none."""
    stated = motion_fit.layout.sigma
    return {
        name: float(x / sigma)
        for name, x, sigma in zip(found.names, found.fit.x, stated, strict=True)
        if sigma > 0.0 and not name.endswith(f"_{payload}")
    }


def table_prior(vehicle: config.Vehicle) -> floating_base.AirBearingPrior:
    """What is known of a run besides payload and links where it begins as the base is let go.

    Raises:
        ConfigError: no [planar] in the vehicle file.
    """
    asked = vehicle.file.planar
    if asked is None:
        raise config.ConfigError(f"{vehicle.label}: no section [planar], which names table and pucks")
    pucks = {puck.frame: floating_base.DragPrior(puck.viscous_sigma_N_s_m, puck.coulomb_sigma_N) for puck in asked.puck}
    known = asked.velocity_sigma_m_s, asked.rate_sigma_rad_s, pucks, asked.tilt_sigma_m_s2, asked.sag_sigma
    return floating_base.AirBearingPrior(*known, imu_prior_of(vehicle))


def ticks_together(vehicle: config.Vehicle) -> int:
    """So many of the estimator's make one of the fit, so that neighbours have uncorrelated noise of the joints."""
    settings = vehicle.file.estimation
    apart_s = uncorrelated_s(settings.smoothing_ms * 1e-3, kernel_of(vehicle))
    return max(1, round(apart_s * settings.row_rate_hz))


def underway(at_start: floating_base.AirBearingPrior) -> floating_base.AirBearingPrior:
    """The same where it begins later: the velocity is hardly known."""
    return at_start._replace(velocity_m_s=_UNDERWAY_m_s)


def _drags(
    found: PayloadFit, pucks: Mapping[str, floating_base.DragPrior], wider: float
) -> tuple[tuple[QuantityEstimate, ...], str]:
    """Drag of each puck, supported if its sigma is at most a fifth of the prior's; and why the fit is refused."""
    drag = air_bearing.drag_of(found, pucks)
    known = np.array([sigma for puck in pucks.values() for sigma in puck])
    sigma = wider**0.5 * drag.sigma
    fine = np.asarray(sigma <= SUPPORTED_SHRINKAGE * known, np.bool_)
    units = ["N s/m", "N"] * len(pucks)
    return answers_of(drag.names, units, drag.drag, sigma, fine, drag.sigma), drag.reason


def identify_pivot(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of a body on a pivot.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    estimator = Estimator(vehicle, at_the_end=True)
    run = estimator.online
    assert isinstance(run, PivotRun)
    run.wait()
    fed(estimator, log)
    answers = tuple(
        one._replace(bound=bound) for one, bound in zip(run.estimate().quantities, run.bounds().tolist(), strict=True)
    )
    evidence = Evidence(
        run.rows_used,
        named_refusals(run.refused),
        {one.name: one.supported for one in answers},
        None,
        failure=f"the fit failed: {run.failure}" if run.failure else "",
        findings=run.findings(),
        standings=standings(answers, useful_of(vehicle)),
        unchecked="",  # its windows are held against each other
    )
    misfit = None if run.found is None else max(run.found.by_sensor)
    residuals = {} if run.found is None else by_axis(*run.residuals(), 1.0 / vehicle.file.estimation.row_rate_hz)
    return judged(log, evidence, answers, misfit=misfit, budget=run.budget(), residuals=residuals)
