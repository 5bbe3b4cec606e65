"""Reaction moment compensation (Longman): what reaction wheels must do so that a moving arm does not turn the base.

The base keeps its attitude and translates freely. Its origin then accelerates by ``-sum_i m_i rho_i'' / M``, the arm is
pulled by ``F_s`` (2.20), and the wheels must give the base the moment ``M_r = M_s + r_q x F_s`` (2.23) that the arm's
joints take from it. Both come out of one inverse dynamics (recursive Newton-Euler): its first six rows are the wrench
on the base; the force is zero by the choice of the base's acceleration, and the moment is M_r.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import FREE_FLYER_NV
from onboard.estimation.arrays import FloatArray


class Reaction(NamedTuple):
    """Of one instant, base axes."""

    wheel_moment: FloatArray  # (3,) N m that the wheels must exert on the base (2.23)
    arm_force: FloatArray  # (3,) N that the base exerts on the arm (2.20)


def reaction(arm: FloatingArm, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> Reaction:
    """Moment and force of a moving arm on a base whose attitude is held (2.19-2.23).

    Args:
        arm: the vehicle.
        q: joint positions, (n,).
        dq: their rates, (n,).
        ddq: their accelerations, (n,).

    Raises:
        SignalError: shapes that do not fit.
    """
    if not q.shape == dq.shape == ddq.shape == (arm.joints,):
        raise SignalError(f"{arm.joints} joints need positions, rates and accelerations of shape ({arm.joints},)")
    full = arm.configuration(q)
    nu = np.concatenate([arm.base_velocity_attitude_held(q, dq), np.zeros(3), dq])
    resting = np.concatenate([np.zeros(FREE_FLYER_NV), ddq])
    force = arm.inverse_dynamics(full, nu, resting)[:3]
    acceleration = -force / arm.mass_kg
    wrench = arm.inverse_dynamics(full, nu, np.concatenate([acceleration, np.zeros(3), ddq]))
    return Reaction(wrench[3:6], -float(arm.model.inertias[1].mass) * acceleration)
