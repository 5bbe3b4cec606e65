"""Bound of a free-flyer's payload: the covariance of the filter that flies, along the planned motion.

The flight's predictor gives the IMU's readings, their derivatives by all unknowns and how these are carried; sigmas
of instruments, links and joints are the vehicle file's. No reading is made: the covariance of an extended Kalman filter
whose estimate is the truth depends on none, and is the Cramer-Rao bound of that truth with the prior (van Trees).
All that the flight fuses takes part: further IMUs, load cells, and cyclic errors of encoders as unknowns.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtrs

from onboard import config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_jacobian, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.smoothing import correlation_inflation
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.problem.identification import build_free_flyer, channels_of
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.flight.estimate.readings.torques import TorqueLines
from onboard.ground.before.foresee.plan import Foreseen, MotionNoise, MotionPlan, axes_words, body_values, expected
from onboard.identification.free_flyer.online import MotionIdentifier, rows_of
from onboard.identification.free_flyer.prediction.further import Further
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor

_BATCH_TICKS, _PART_TICKS = 50, 10  # of a prediction; of a gain, whose work grows with the cube of its readings
_BATCH_S = 0.5  # of few ticks: biases walk from one batch to the next
_ANY_RATE_rad_s = 10.0  # sigma of the base's rate where nothing is known
_NOTHING = standard_of(RigidBody(1e-9, np.zeros(3), 1e-9 * np.eye(3)))


def foresee_free(vehicle: config.Vehicle, plan: MotionPlan) -> Foreseen:
    """Expected intervals of the payload of a vehicle with ``method = "exiddm"`` and a free base.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    few = plan.few(vehicle)
    vehicle, plan = vehicle.with_row_rate(vehicle.file.estimation.row_rate_hz / few.step), plan.part(few)
    flown = fly(vehicle, plan, round(_BATCH_S * vehicle.file.estimation.row_rate_hz))
    if flown is None:
        return Foreseen((), (), None, 0.0, ())
    ekf, model = flown.identifier.ekf, flown.model
    # what is left at the end of the last time that it was held
    ekf.state, ekf.covariance, ekf.held = flown.state, flown.covariance, True
    ekf.ticks_used = int(plan.held.sum())
    found = flown.identifier.estimate().quantities
    spread = np.sqrt(np.diag(body_covariance(flown.payload, flown.covariance[PAYLOAD, PAYLOAD])))
    values = body_values(model, flown.payload)
    told = expected(found, values, spread.tolist(), useful_of(vehicle))
    both = plan.used(vehicle) & plan.held
    R_BS, _ = model.pose_in_base(roles_of(vehicle).imu.frame)
    words = axes_words(model, plan, flown.rate @ R_BS.T, both)
    return Foreseen(tuple(told), (), flown.payload, float(both.sum() * ekf.predictor.period_s), words)


class FilteredMotion(NamedTuple):
    """The filter after a planned motion, as it was when the payload was last held."""

    identifier: MotionIdentifier
    model: VehicleModel
    payload: RigidBody
    state: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    rate: FloatArray  # (n, 3) of the gyro


def fly(vehicle: config.Vehicle, plan: MotionPlan, batch: int = _BATCH_TICKS) -> FilteredMotion | None:
    """Covariance of the filter along a planned motion; None where no payload is held in it.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.
        batch: ticks that are predicted at once.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    identifier, model = build_free_flyer(vehicle, tracked=False)
    predictor, payload = identifier.ekf.predictor, plan.payload
    if payload is None or not plan.held.any():
        return None
    noise, used = FilterNoise(vehicle, model, predictor.further), plan.used(vehicle)
    state, covariance = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    state[RATE] = plan.rate_rad_s
    rate = np.zeros((len(plan.q), 3))
    edges = [0, *(np.flatnonzero(np.diff(plan.held)) + 1), len(plan.held)]
    last_held = state, covariance
    for first, last in pairwise(edges):
        held = bool(plan.held[first])
        for block, width in ((RATE, np.full(3, _ANY_RATE_rad_s)), (PAYLOAD, held * identifier.ekf.payload_sigma)):
            covariance[block], covariance[:, block] = 0.0, 0.0
            covariance[block, block] = np.diag(width**2)
        state[PAYLOAD] = standard_of(payload) if held else _NOTHING
        part = slice(first, last)
        state, covariance, rate[part] = _fly(predictor, plan, noise, used, part, state, covariance, batch)
        if held:
            last_held = state.copy(), covariance.copy()
    return FilteredMotion(identifier, model, payload, *last_held, rate)


def body_covariance(payload: RigidBody, covariance: FloatArray) -> FloatArray:
    """Covariance of mass, centre of mass and inertia about it, (10, 10), from that of the standard parameters."""
    D = body_jacobian(standard_of(payload))
    return np.asarray(D @ covariance @ D.T, np.float64)


def _fly(
    predictor: ImuPredictor,
    plan: MotionPlan,
    noise: "FilterNoise",
    used: BoolArray,
    part: slice,
    state: FloatArray,
    covariance: FloatArray,
    batch: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State and covariance after a part of the motion in which one payload is held, or none; gyro's rates (n, 3)."""
    q, dq, ddq = (signal[part] for signal in (plan.q, plan.dq, plan.ddq))
    here, joints, cyclic = used[part], noise.of_joints(dq), noise.cyclic(q, dq)
    rate = np.zeros((len(q), 3))
    for first in range(0, len(q) - 3, batch):
        ticks = slice(first, min(first + batch + 2, len(q)))
        now = predictor.predict(q[ticks], dq[ticks], ddq[ticks], state, cyclic[ticks])
        sigma = np.hypot(noise.of_lines(dq[ticks]), predictor.joint_noise(q[ticks], joints[ticks], state))[1:-1]
        inside = slice(first + 1, first + 1 + len(now.values))
        rate[inside] = now.values[:, :3]
        whitened = (now.jacobian / sigma[..., None])[here[inside]]
        for at in range(0, len(whitened), _PART_TICKS):
            H = whitened[at : at + _PART_TICKS].reshape(-1, len(state))
            HP = H @ covariance
            W = dtrtrs(np.linalg.cholesky(HP @ H.T + np.eye(len(HP))).T, HP, lower=False, trans=True)[0]
            covariance = covariance - W.T @ W
        state, covariance = predictor.carried(now, state, state, 0.5 * (covariance + covariance.T))
    rate[0] = rate[min(1, len(rate) - 1)]
    return state, covariance, rate


class FilterNoise:
    """White noise of what the filter takes in, and its functions of the joints' cyclic errors.

    Args:
        vehicle: its file.
        model: of it.
        further: instruments besides the first IMU.
    """

    def __init__(self, vehicle: config.Vehicle, model: VehicleModel, further: Sequence[Further]) -> None:
        settings, roles = vehicle.file.estimation, roles_of(vehicle)
        names = [name for own in (roles.imu.channels, *channels_of(roles, further)) for name in own]
        signals = [roles.signals[name] for name in names]
        per_tick = [max(1.0, np.rint(1.0 / (one.period_s * settings.row_rate_hz))) for one in signals]
        means = [one.inflation * np.array(one.noise) / np.sqrt(n) for one, n in zip(signals, per_tick, strict=True)]
        self._of_lines: FloatArray = np.concatenate(means)
        self._torques = TorqueLines.of(roles, model, rows_of(further))
        self._joints = MotionNoise(vehicle, model)
        self.cyclic = self._joints.cyclic
        width_s, period_s = settings.smoothing_ms * 1e-3, 1.0 / settings.row_rate_hz
        self._inflation = correlation_inflation(width_s, period_s, kernel_of(vehicle))

    def of_lines(self, dq: FloatArray) -> FloatArray:
        """Of means over a tick of all instruments at joint rates (n, joints), (n, lines); infinite where not used."""
        sigma, refused = np.tile(self._of_lines, (len(dq), 1)), np.zeros((len(dq), len(self._of_lines)), np.int64)
        self._torques.state(dq, sigma, refused, self._inflation)
        return np.where(refused != 0, np.inf, sigma)

    def of_joints(self, dq: FloatArray) -> FloatArray:
        """Of rates, inflated, and accelerations of the joints at rates (n, joints), (n, 2, joints)."""
        _, rates, accelerations = self._joints.at(dq)
        return np.stack([self._inflation * rates, accelerations], axis=1)
