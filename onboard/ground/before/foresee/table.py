"""Bound of payload and drag of a run on an air-bearing table, which is fitted as one batch after it."""

import numpy as np

from onboard import config
from onboard.dynamics.model.payload import body_estimate
from onboard.dynamics.ticks import FlightSignals
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.problem.model import samples_per_tick
from onboard.flight.estimate.problem.priors import free_flyer_prior, geometry_prior
from onboard.flight.estimate.problem.table import build_table
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.before.foresee.plan import (
    UNDETERMINED,
    Expected,
    Foreseen,
    MotionNoise,
    MotionPlan,
    axes_words,
    body_values,
)
from onboard.ground.identify.kinds.identified import standings
from onboard.ground.identify.kinds.likelihood_log import LONGEST_S, body_answers
from onboard.ground.identify.kinds.table_log import table_prior, ticks_together, underway
from onboard.identification.quantities import SUPPORTED_SHRINKAGE
from onboard.identification.standing import Level
from onboard.identification.table.air_bearing import TableFit
from onboard.identification.table.rivals import bound


def foresee_table(vehicle: config.Vehicle, plan: MotionPlan) -> Foreseen:
    """Expected intervals of ``heft identify`` after a run on the table.

    Args:
        vehicle: its file, with the section of the table.
        plan: the motion, at the estimator's ticks.

    Raises:
        ConfigError: the file does not fit the URDF or the devices.
        EstimationError: the motion leaves something open that nothing else tells.
    """
    _, model = build_table(vehicle)
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    both = plan.used(vehicle) & plan.held
    payload = plan.payload
    if payload is None or not both.any():
        return Foreseen((), (), None, 0.0, ())
    period_s, samples = 1.0 / settings.row_rate_hz, samples_per_tick(vehicle)
    first = int(np.flatnonzero(both)[0])
    last = min(int(np.flatnonzero(both)[-1]) + 1, first + round(LONGEST_S / period_s))
    run = slice(first, last)
    links, _, payload_sigma = free_flyer_prior(vehicle, model)
    noise = np.concatenate([np.array(roles.signals[c].noise) for c in roles.imu.channels]) / np.sqrt(samples)
    nothing = np.zeros((last - first, 3))
    of_joints = MotionNoise(vehicle, model)
    _, rates, accelerations = of_joints.at(plan.dq[run])
    flight = FlightSignals(
        *(period_s, plan.q[run], plan.dq[run], plan.ddq[run], nothing, nothing, noise[:3], noise[3:], samples),
        np.stack([rates, accelerations], axis=1),
        of_joints.cyclic(plan.q[run], plan.dq[run]),
    ).coarser(ticks_together(vehicle))
    prior = table_prior(vehicle) if first == 0 else underway(table_prior(vehicle))
    prior = prior._replace(geometry=geometry_prior(vehicle, model))
    motion_fit = TableFit(model, roles.imu.frame, flight, payload_sigma, links, prior, payload)
    start = np.array([plan.velocity_m_s[0], plan.velocity_m_s[1], plan.rate_rad_s[2]])
    x = motion_fit.parameters(start, payload)
    drags = {name: k for k, name in enumerate(motion_fit.names) if name.startswith(("Fv_", "Fc_"))}
    for name, at in drags.items():
        x[at] = plan.drag[name.startswith("Fc_")]
    covariance = bound(motion_fit, x)
    own = motion_fit.layout.estimated("payload")
    body = body_estimate(x[own], covariance[np.ix_(own, own)])
    names = tuple(body_values(model, payload))
    answers = body_answers(names, *body, 1.0, np.sqrt(np.diag(body.covariance)))
    each = standings(answers, useful_of(vehicle))
    told = [
        Expected(one.name, one.unit, one.value, one.sigma, *each.get(one.name, (Level.WEAK, UNDETERMINED)))
        for one in answers
    ]
    sigma, stated = np.sqrt(np.diag(covariance)), motion_fit.layout.sigma
    drag = []
    for name, at in drags.items():
        fine = sigma[at] <= SUPPORTED_SHRINKAGE * stated[at]
        level, why = (Level.GOOD, "") if fine else (Level.WEAK, UNDETERMINED)
        drag.append(
            Expected(name, "N s/m" if name.startswith("Fv_") else "N", float(x[at]), float(sigma[at]), level, why)
        )
    about_z = np.tile([0.0, 0.0, 1.0], (len(plan.q), 1))  # the base turns about z alone
    return Foreseen(
        tuple(told), tuple(drag), payload, (last - first) * period_s, axes_words(model, plan, about_z, both)
    )
