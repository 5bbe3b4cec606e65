"""Bound of what a run on a spherical air bearing tells, from the wheels' planned speeds."""

import numpy as np

from onboard import config
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.problem.model import samples_per_tick
from onboard.flight.estimate.problem.pivot import build_pivot
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.before.foresee.plan import Foreseen, MotionPlan, expected
from onboard.identification.free_flyer.prediction.ticks import Ticks


def foresee_pivot(vehicle: config.Vehicle, plan: MotionPlan) -> Foreseen:
    """Expected intervals of a body on a pivot that is as drawn, upright at the start.

    Args:
        vehicle: its file.
        plan: the motion of the wheels, at the estimator's ticks.

    Raises:
        ConfigError: the file does not fit the URDF or the devices.
        EstimationError: the motion leaves something open that nothing else tells.
    """
    run, _ = build_pivot(vehicle)
    roles, n = roles_of(vehicle), len(plan.time_s)
    noise = np.concatenate([np.array(roles.signals[c].noise) for c in roles.imu.channels])
    sigma = np.tile(noise / np.sqrt(samples_per_tick(vehicle)), (n, 1))
    none = Ticks.none(plan.dq.shape[1])
    ticks = Ticks(plan.time_s, plan.q, plan.dq, plan.ddq, np.zeros((n, 6)), sigma, *none[6:])
    used = plan.used(vehicle)
    run.foresee(ticks, plan.held, plan.rate_rad_s)
    found = run.estimate().quantities
    values, sigmas = {one.name: one.value for one in found}, [one.sigma for one in found]
    told = expected(found, values, sigmas, useful_of(vehicle))
    return Foreseen(tuple(told), (), None, float(used.sum() * (plan.time_s[1] - plan.time_s[0])), ())
