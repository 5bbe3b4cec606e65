"""Predicts the base IMU over a batch of ticks from a state propagated between batches.

The state has the unknowns of a free flight: current rate of the base, payload, current IMU biases and their drifts,
scale, misalignment and delay, uncertain links, the IMU's place, and errors of the joints' places and encoders. All but
the rate (:mod:`onboard.dynamics.free_flight`) and the biases are constant.

Cyclic errors of an encoder behind a gear are functions of its angle (eccentricity, transmission error); as noise they
would make the payload too light (errors in variables). Their functions come through the same smoothing as the joints.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.dynamics.free_flight import BasePrediction, at_sensor, predict_base_from_rate
from onboard.dynamics.joint_errors import PER_JOINT, JointErrors, Readings
from onboard.dynamics.kinematics import (
    bodies_of,
    chain_motion,
    composite_of,
    cross,
    hat,
    link_motions,
    relative_momentum,
    stacked,
    turned,
)
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.imu_errors import BIASES, DRIFTS, SIZE, ImuPrior, imu_blocks, imu_reading, tick_mean
from onboard.identification.exiddm.parameters import EXACT_GEOMETRY, Block, GeometryPrior, Layout, UncertainLinks
from onboard.identification.exiddm.ticks import Ticks

RATE, PAYLOAD = slice(0, 3), slice(3, 13)  # of the state: unknown, so always estimated
FIRST_TICKS = 10  # for the initial rate
_POSTURE_TICKS = 10  # over which the arm's posture is constant in the effect of its noise


class Prediction(NamedTuple):
    """Prediction of the ticks 1 .. b of b + 2, from a state at tick 0."""

    values: FloatArray  # (b, 6) rate and specific force, IMU axes
    jacobian: FloatArray  # (b, 6, p)
    state: FloatArray  # (p,) propagated to tick b
    transition: FloatArray  # (p, p) derivative of that


class ImuPredictor:
    """Predicts the base IMU of a vehicle.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the IMU's frame S, fixed in the base B.
        period_s: between ticks.
        samples: of the IMU in each tick's mean.
        link_covariance: see :class:`onboard.identification.exiddm.parameters.UncertainLinks`.
        imu_prior: on instrument errors; the clock rate error is taken for none.
        geometry: prior on places of IMU and joints, and on encoder errors.

    Attributes:
        names: of the p parameters.
        sigma: (p,) before the flight; NaN for rate and payload, of which nothing is known.
        biases: where each bias stands in the state, and where its drift.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        period_s: float,
        samples: int,
        link_covariance: Mapping[str, FloatArray],
        imu_prior: ImuPrior,
        geometry: GeometryPrior = EXACT_GEOMETRY,
    ) -> None:
        self.vehicle, self.period_s, self._samples = vehicle, period_s, samples
        self._links = UncertainLinks(vehicle, link_covariance)
        self._R_BS, self._p_BoSo_B = vehicle.pose_in_base(imu_frame)
        halves = [np.linalg.cholesky(block) for block in self._links.covariances]
        self._basis = block_diag(*halves) if halves else np.zeros((0, 0))  # of the links, one sigma long each
        r = len(self._basis)
        layout = Layout(
            {
                "start": Block(tuple(f"rate_{axis}" for axis in "xyz"), np.full(3, np.nan)),
                "payload": Block(self._links.payload_names, np.full(10, np.nan)),
                **imu_blocks(imu_prior._replace(clock_rate_error=0.0)),
                "links": Block(self._links.inertial_names, np.ones(r)),
                **geometry.blocks(vehicle),
            }
        )
        self._layout, self.names, self.sigma = layout, layout.names, layout.sigma
        self._errors = slice(PAYLOAD.stop, PAYLOAD.stop + SIZE)
        self._joint_errors = JointErrors(vehicle, geometry.cyclic_joints(vehicle))
        self._in_links, self._in_joints = layout.estimated("links"), layout.estimated("joints", "cyclic")
        self._joint_columns = 13 + r + layout.kept[self._in_joints] - layout["joints"].start  # of the base's motion
        self.biases: list[tuple[int, int]] = []
        for bias, drift in zip(BIASES, DRIFTS, strict=True):
            self.biases += zip(layout.estimated(bias).tolist(), layout.estimated(drift).tolist(), strict=False)

    def rate_in_base(self, rate_S: FloatArray) -> FloatArray:
        """A rate in the IMU's axes, (3,), in those of the base: ``w_B = R_BS w_S``."""
        return np.asarray(self._R_BS @ rate_S, np.float64)

    def joint_noise(self, q: FloatArray, joint_sigma: FloatArray, state: FloatArray) -> FloatArray:
        """Effect of the joints' noise on the prediction, one sigma, (n, 6).

        From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
        ``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint
        accelerations. Products of rates are neglected.

        Args:
            q: joint positions, (n, joints).
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            state: (p,).
        """
        n, joints = q.shape
        if not joint_sigma.any():
            return np.zeros((n, 6))
        some = np.arange(0, n, _POSTURE_TICKS)
        one = np.tile(np.eye(joints), (len(some), 1))  # each joint's unit rate by itself
        links = link_motions(self.vehicle, np.repeat(q[some], joints, axis=0), one, np.zeros_like(one))
        bodies = bodies_of(stacked(links), self._chi(state))
        twist = turned(np.asarray(np.linalg.inv(composite_of(bodies)), np.float64), relative_momentum(bodies))
        force = twist[:, :3] + cross(twist[:, 3:], self._p_BoSo_B)
        effect = np.stack([twist[:, 3:] @ self._R_BS, force @ self._R_BS], axis=1).reshape(len(some), joints, 2, 3) ** 2
        variance = np.einsum("njki,nkj->nki", effect[np.arange(n) // _POSTURE_TICKS], joint_sigma**2)
        return np.asarray(np.sqrt(variance).reshape(n, 6), np.float64)

    def predict(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, state: FloatArray, cyclic: FloatArray | None = None
    ) -> Prediction:
        """From a state at the first of b + 2 ticks.

        Args:
            q: joint positions at these ticks as read, (b + 2, joints).
            dq: joint rates.
            ddq: joint accelerations.
            state: (p,) at the first of them.
            cyclic: functions of the joints' cyclic errors and their derivatives, (b + 2, 3, m); None: zero.

        Raises:
            SignalError: fewer than four ticks.
        """
        n, layout = len(q), self._layout
        x = layout.whole(state)
        readings = Readings.of(q, dq, ddq, self.period_s, self._functions(n, cyclic))
        base = self._base(readings, x, self.period_s)
        p_BoSo_B = self._p_BoSo_B + x[layout["imu_place"]]
        true, d_true = at_sensor(base, self._R_BS, p_BoSo_B)
        d_place = np.zeros((n, 6, 3))
        d_place[:, 3:] = self._R_BS.T @ (hat(base.acceleration) + hat(base.rate) @ hat(base.rate))
        d_true = np.concatenate([d_true, d_place], axis=2)
        time_s = np.asarray(self.period_s * np.arange(n)[1:-1], np.float64)
        change = (true[2:] - true[:-2]) / (2.0 * self.period_s)
        own, d_own = tick_mean(true, self._samples)[1:-1], tick_mean(d_true, self._samples)[1:-1]
        shown = imu_reading(own, d_own, change, time_s, x[self._errors])
        r = len(self._basis)
        by_motion = shown.d_motion
        jacobian = np.concatenate(
            [
                by_motion[:, :, :13],
                shown.d_errors,
                by_motion[:, :, 13 : 13 + r] @ self._basis,
                by_motion[:, :, -3:],
                by_motion[:, :, 13 + r : -3],
            ],
            axis=2,
        )
        if jacobian.shape[2] < layout.size:  # joints without errors have no columns
            jacobian = np.pad(jacobian, ((0, 0), (0, 0), (0, layout.size - jacobian.shape[2])))
        carried, transition = state.copy(), np.eye(len(state))
        carried[RATE] = base.rate[-2]
        self._into(transition, base.d_rate[-2])
        for bias_at, drift_at in self.biases:
            carried[bias_at] += time_s[-1] * state[drift_at]
            transition[bias_at, drift_at] = time_s[-1]
        return Prediction(shown.values, jacobian[:, :, layout.kept], carried, transition)

    def bridge(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, state: FloatArray, cyclic: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Propagate the state over a gap of the joints, with the momentum constant in base axes.

        Args:
            q: joint positions as read at the tick of the state and at a later one, (2, joints).
            dq: joint rates.
            ddq: joint accelerations.
            state: (p,).
            cyclic: see :meth:`predict`, (2, 3, m).

        Returns:
            The state at the later tick, its derivative (p, p), and the rate's covariance, (3, 3), for a rotation of
            the momentum by 1 rad, one sigma.
        """
        parts = q, dq, ddq, np.zeros_like(q), self._functions(2, cyclic)
        readings = Readings(*(np.repeat(part, 2, axis=0) for part in parts))
        base = self._base(readings, self._layout.whole(state), 0.0)
        carried, transition = state.copy(), np.eye(len(state))
        carried[RATE] = base.rate[-1]
        self._into(transition, base.d_rate[-1])
        turned = np.linalg.norm(base.momentum[-1]) * base.d_rate[-1, :, :3] @ np.linalg.inv(base.d_momentum[-1, :, :3])
        return carried, transition, turned @ turned.T

    def _base(self, readings: Readings, x: FloatArray, period_s: float) -> BasePrediction:
        """Motion of the base, with all unknowns (every one, :meth:`Layout.whole`) as they are estimated."""
        vehicle, at = self.vehicle, self._layout
        chi = self._links.chi(x[PAYLOAD], self._basis @ x[at["links"]])
        if not self._in_joints.size:
            links = link_motions(vehicle, *readings[:3])
            return predict_base_from_rate(links, period_s, chi, x[RATE], self._links.indices)
        own = x[at["joints"]].reshape(-1, PER_JOINT)
        corrected = readings.corrected(own, x[at["cyclic"]], self._joint_errors.turns)
        chain = chain_motion(vehicle, *corrected, own[:, :3])
        errors = self._joint_errors.along(chain, readings)
        return predict_base_from_rate(chain.links, period_s, chi, x[RATE], self._links.indices, errors)

    def _functions(self, ticks: int, cyclic: FloatArray | None) -> FloatArray:
        return np.zeros((ticks, 3, len(self._joint_errors.turns))) if cyclic is None else cyclic

    def _into(self, transition: FloatArray, d_rate: FloatArray) -> None:
        transition[RATE, : PAYLOAD.stop] = d_rate[:, :13]
        transition[RATE, self._in_links] = d_rate[:, 13 : 13 + len(self._basis)] @ self._basis
        transition[RATE, self._in_joints] = d_rate[:, self._joint_columns]

    def _chi(self, state: FloatArray) -> FloatArray:
        """Standard parameters of all links, (10 x links,)."""
        return self._links.chi(state[PAYLOAD], self._basis @ state[self._in_links])


def first_rate(predictor: ImuPredictor, ticks: Ticks, state: FloatArray) -> FloatArray:
    """Rate of the base at the first tick, (3,), by least squares on the first gyro readings, with all else of a state.

    Args:
        predictor: of the IMU.
        ticks: in succession, :data:`FIRST_TICKS` + 2 of them at least.
        state: (p,).
    """
    state, some = state.copy(), ticks.part(slice(0, FIRST_TICKS + 2))
    seen = np.isfinite(some.measured[1:-1, :3]).all(axis=1)
    if not seen.any():
        return np.zeros(3)
    state[RATE] = predictor.rate_in_base(some.measured[1:-1, :3][seen].mean(axis=0))
    predicted = predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic)
    gap = some.measured[1:-1, :3] - predicted.values[:, :3]
    J = predicted.jacobian[seen, :3, RATE].reshape(-1, 3)
    return np.asarray(state[RATE] + np.linalg.lstsq(J, gap[seen].ravel())[0], np.float64)
