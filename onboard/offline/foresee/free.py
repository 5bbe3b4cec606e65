"""Bound of a free-flyer's payload by the ExIDDM: the covariance of the filter that flies, along the planned motion.

The flight's own predictor gives the IMU's readings, their derivatives by all unknowns and how these are carried; sigmas
of instruments, links and joints are the vehicle file's. No reading is made: the covariance of an extended Kalman filter
whose estimate is the truth depends on none, and is the Cramer-Rao bound of that truth with the prior (van Trees).
"""

from itertools import pairwise

import numpy as np

from onboard import config
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.payload import body_jacobian, standard_of
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.smoothing import correlation_inflation
from onboard.flight.identification import build_exiddm, build_model, samples_per_tick
from onboard.flight.roles import roles_of
from onboard.flight.signals import kernel_of
from onboard.identification.exiddm.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.exiddm.recursive import DRIFT_MEMORY_s
from onboard.offline.foresee.plan import Foreseen, Plan, axes_words, body_values, expected, joint_noise

_BATCH_TICKS = 50
_ANY_RATE_rad_s = 10.0  # sigma of the base's rate where nothing is known
_NOTHING = standard_of(RigidBody(1e-9, np.zeros(3), 1e-9 * np.eye(3)))


def foresee_free(vehicle: config.Vehicle, plan: Plan) -> Foreseen:
    """Expected intervals of the payload of a vehicle with ``method = "exiddm"`` and a free base.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    identifier, model = build_exiddm(vehicle)
    exiddm, predictor = identifier.exiddm, identifier.exiddm.predictor
    payload = plan.payload
    if payload is None or not plan.held.any():
        return Foreseen((), (), None, 0.0, ())
    used = plan.used(vehicle)
    sigma = _noise(vehicle, plan)
    state, covariance = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    state[RATE] = plan.rate_rad_s
    rate = np.zeros((len(plan.q), 3))
    edges = [0, *(np.flatnonzero(np.diff(plan.held)) + 1), len(plan.held)]
    for first, last in pairwise(edges):
        held = bool(plan.held[first])
        for block, width in ((RATE, np.full(3, _ANY_RATE_rad_s)), (PAYLOAD, held * exiddm.payload_sigma)):
            covariance[block], covariance[:, block] = 0.0, 0.0
            covariance[block, block] = np.diag(width**2)
        state[PAYLOAD] = standard_of(payload) if held else _NOTHING
        part = slice(first, last)
        state, covariance, rate[part] = _fly(predictor, plan, sigma, used, part, state, covariance)
        if held:  # what is left at the end of the last time that it was held
            exiddm.state, exiddm.covariance, exiddm.held = state.copy(), covariance.copy(), True
    found = identifier.estimate().quantities
    chi, P = standard_of(payload), exiddm.covariance[PAYLOAD, PAYLOAD]
    D = body_jacobian(chi)
    spread = np.sqrt(np.einsum("ij,jk,ik->i", D, P, D))
    values = body_values(model, payload)
    told = [expected(one, values[one.name], wide) for one, wide in zip(found, spread.tolist(), strict=True)]
    both = used & plan.held
    R_BS, _ = model.pose_in_base(roles_of(vehicle).imu.frame)
    words = axes_words(model, plan, rate @ R_BS.T, both)
    return Foreseen(tuple(told), (), payload, float(both.sum() * predictor.period_s), words)


def _fly(
    predictor: ImuPredictor,
    plan: Plan,
    sigma: tuple[FloatArray, FloatArray],
    used: BoolArray,
    part: slice,
    state: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State and covariance after a part of the motion in which one payload is held, or none; gyro's rates (n, 3)."""
    of_imu, of_joints = sigma
    q, dq, ddq = (signal[part] for signal in (plan.q, plan.dq, plan.ddq))
    here, joints = used[part], of_joints[part]
    rate = np.zeros((len(q), 3))
    drifts = np.array([at for _, at in predictor.biases], np.intp)
    for first in range(0, len(q) - 3, _BATCH_TICKS):
        ticks = slice(first, min(first + _BATCH_TICKS + 2, len(q)))
        now = predictor.predict(q[ticks], dq[ticks], ddq[ticks], state)
        noise = np.hypot(of_imu, predictor.joint_noise(q[ticks], joints[ticks], state))[1:-1]
        inside = slice(first + 1, first + 1 + len(now.values))
        rate[inside] = now.values[:, :3]
        whitened = (now.jacobian / noise[..., None])[here[inside]].reshape(-1, len(state))
        if len(whitened):
            HP = whitened @ covariance
            gained = HP.T @ np.linalg.solve(HP @ whitened.T + np.eye(len(HP)), HP)
            covariance = covariance - gained
        covariance = now.transition @ covariance @ now.transition.T
        aged_s = len(now.values) * predictor.period_s
        covariance[drifts, drifts] += 2.0 * aged_s / DRIFT_MEMORY_s * predictor.sigma[drifts] ** 2
        covariance = 0.5 * (covariance + covariance.T)
        state = now.state
    rate[0] = rate[min(1, len(rate) - 1)]
    return state, covariance, rate


def _noise(vehicle: config.Vehicle, plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Of the IMU's means over a tick, (6,); of rates and accelerations of the joints, inflated, (n, 2, joints)."""
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    means = [
        np.array(roles.signals[channel].noise) / np.sqrt(samples_per_tick(vehicle)) for channel in roles.imu.channels
    ]
    joints = joint_noise(vehicle, build_model(vehicle), plan.dq)
    inflation = correlation_inflation(settings.smoothing_ms * 1e-3, 1.0 / settings.row_rate_hz, kernel_of(vehicle))
    return np.concatenate(means), inflation * np.moveaxis(joints[1:], 0, 1)
