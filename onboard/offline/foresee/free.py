"""Bound of a free-flyer's payload by the ExIDDM: the covariance of the filter that flies, along the planned motion.

The flight's own predictor gives the IMU's readings, their derivatives by all unknowns and how these are carried; sigmas
of instruments, links and joints are the vehicle file's. No reading is made: the covariance of an extended Kalman filter
whose estimate is the truth depends on none, and is the Cramer-Rao bound of that truth with the prior (van Trees).

It is that of the first IMU alone, with cyclic errors of encoders as noise: a flight that fuses more knows more.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.payload import body_jacobian, standard_of
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.smoothing import correlation_inflation
from onboard.flight.identification import build_exiddm, samples_per_tick
from onboard.flight.roles import roles_of
from onboard.flight.signals import kernel_of
from onboard.identification.exiddm.imu_prediction import PAYLOAD, RATE, DRIFT_MEMORY_s, ImuPredictor
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.offline.foresee.plan import Foreseen, JointNoise, Plan, axes_words, body_values, expected

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
    flown = fly(vehicle, plan)
    if flown is None:
        return Foreseen((), (), None, 0.0, ())
    exiddm, model = flown.identifier.exiddm, flown.model
    # what is left at the end of the last time that it was held
    exiddm.state, exiddm.covariance, exiddm.held = flown.state, flown.covariance, True
    found = flown.identifier.estimate().quantities
    spread = np.sqrt(np.diag(body_covariance(flown.payload, flown.covariance[PAYLOAD, PAYLOAD])))
    values = body_values(model, flown.payload)
    told = [expected(one, values[one.name], wide) for one, wide in zip(found, spread.tolist(), strict=True)]
    both = plan.used(vehicle) & plan.held
    R_BS, _ = model.pose_in_base(roles_of(vehicle).imu.frame)
    words = axes_words(model, plan, flown.rate @ R_BS.T, both)
    return Foreseen(tuple(told), (), flown.payload, float(both.sum() * exiddm.predictor.period_s), words)


class Flown(NamedTuple):
    """The filter after a planned motion, as it was when the payload was last held."""

    identifier: ExiddmIdentifier
    model: VehicleModel
    payload: RigidBody
    state: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    rate: FloatArray  # (n, 3) of the gyro


def fly(vehicle: config.Vehicle, plan: Plan) -> Flown | None:
    """Covariance of the filter along a planned motion; None where no payload is held in it.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    identifier, model = build_exiddm(vehicle, fused=False)
    predictor, payload = identifier.exiddm.predictor, plan.payload
    if payload is None or not plan.held.any():
        return None
    noise = Noise(vehicle, model)
    used, sigma = plan.used(vehicle), (noise.of_imu, noise.of_joints(plan.dq))
    state, covariance = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    state[RATE] = plan.rate_rad_s
    rate = np.zeros((len(plan.q), 3))
    edges = [0, *(np.flatnonzero(np.diff(plan.held)) + 1), len(plan.held)]
    last_held = state, covariance
    for first, last in pairwise(edges):
        held = bool(plan.held[first])
        for block, width in ((RATE, np.full(3, _ANY_RATE_rad_s)), (PAYLOAD, held * identifier.exiddm.payload_sigma)):
            covariance[block], covariance[:, block] = 0.0, 0.0
            covariance[block, block] = np.diag(width**2)
        state[PAYLOAD] = standard_of(payload) if held else _NOTHING
        part = slice(first, last)
        state, covariance, rate[part] = _fly(predictor, plan, sigma, used, part, state, covariance)
        if held:
            last_held = state.copy(), covariance.copy()
    return Flown(identifier, model, payload, *last_held, rate)


def body_covariance(payload: RigidBody, covariance: FloatArray) -> FloatArray:
    """Covariance of mass, centre of mass and inertia about it, (10, 10), from that of the standard parameters."""
    D = body_jacobian(standard_of(payload))
    return np.asarray(D @ covariance @ D.T, np.float64)


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


class Noise:
    """White noise of what the filter takes in.

    Args:
        vehicle: its file.
        model: of it.

    Attributes:
        of_imu: means over a tick, (6,).
    """

    def __init__(self, vehicle: config.Vehicle, model: VehicleModel) -> None:
        settings, roles = vehicle.file.estimation, roles_of(vehicle)
        samples = samples_per_tick(vehicle)
        means = [np.array(roles.signals[channel].noise) / np.sqrt(samples) for channel in roles.imu.channels]
        self.of_imu: FloatArray = np.concatenate(means)
        self._joints = JointNoise(vehicle, model)
        width_s, period_s = settings.smoothing_ms * 1e-3, 1.0 / settings.row_rate_hz
        self._inflation = correlation_inflation(width_s, period_s, kernel_of(vehicle))

    def of_joints(self, dq: FloatArray) -> FloatArray:
        """Of rates and accelerations of the joints at rates (n, joints), inflated, (n, 2, joints)."""
        return np.asarray(self._inflation * np.moveaxis(self._joints.at(dq)[1:], 0, 1), np.float64)
