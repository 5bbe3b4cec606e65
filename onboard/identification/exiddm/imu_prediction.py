"""What the base IMU shows over a few ticks, predicted from a state that is carried on from batch to batch.

The state holds what the prediction of a free flight depends on and nobody knows: the angular momentum now, the payload,
the IMU's biases now and their drifts, its scale, axes and time, and as far as they are doubted the other links. All
but the momentum (:mod:`onboard.dynamics.free_flight`) and the biases stay as they are.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from onboard.dynamics.errors import UnknownFrameError
from onboard.dynamics.free_flight import at_sensor, predict_base
from onboard.dynamics.kinematics import (
    LinkMotion,
    bodies_of,
    composite_of,
    cross,
    hat,
    link_motions,
    relative_momentum,
    stacked,
    turned,
)
from onboard.dynamics.vehicle import STANDARD, VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.exiddm.batch import ImuPrior

MOMENTUM, PAYLOAD = slice(0, 3), slice(3, 13)
_IMU = 13  # first column of the IMU's errors: bias, drift, scale, turn of the gyro, of the accelerometer, delay
_LINKS = _IMU + 25
_POSTURE_TICKS = 10  # over which the arm's posture is one, for what its noise does
_WHITE = (
    1e-3  # of an effect on a tick, in units of the noise of one: a direction of the links that has less is left out
)


class Prediction(NamedTuple):
    """Of the ticks 1 .. b of b + 2, from a state at tick 0."""

    values: FloatArray  # (b, 6) rate and specific force, IMU axes
    jacobian: FloatArray  # (b, 6, p)
    state: FloatArray  # (p,) carried on to tick b
    transition: FloatArray  # (p, p) derivative of that


class ImuPredictor:
    """Predicts the base IMU of a vehicle.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the IMU's frame, fixed in the base.
        period_s: between ticks.
        samples: of the IMU in each tick's mean.
        link_covariance: of the standard parameters of other links by name, (10, 10) each; links that are not named are
            taken for certain.
        doubt: what may be wrong with the IMU; no stretch of its clock.

    Attributes:
        names: of the p parameters.
        sigma: (p,) before the flight; NaN for momentum and payload, of which nothing is known.

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
        doubt: ImuPrior,
    ) -> None:
        payload = vehicle.spec.payload_link
        if payload is None:
            raise UnknownFrameError("this vehicle has no payload link; name one")
        unknown = set(link_covariance) - (set(vehicle.links) - {payload})
        if unknown:
            raise UnknownFrameError(f"covariances are for links other than the payload; {', '.join(unknown)} is none")
        self.vehicle, self.period_s = vehicle, period_s
        self._R, self._p = vehicle.pose_in_base(imu_frame)
        self._columns = vehicle.payload_columns()
        others = [k for k, link in enumerate(vehicle.links) if link in link_covariance]
        self._free = (vehicle.links.index(payload), *others)
        self._basis = np.zeros((10 * len(others), 10 * len(others)))  # directions of the links, one sigma long each
        for index, k in enumerate(others):
            block = slice(10 * index, 10 * index + 10)
            self._basis[block, block] = np.linalg.cholesky(link_covariance[vehicle.links[k]])
        self._others = (10 * np.repeat(others, 10) + np.tile(np.arange(10), len(others))).astype(np.intp)
        self._mean = (1.0 - 1.0 / samples**2) / 24.0  # of second differences, that makes a value a mean over its tick
        names = [f"momentum_{axis}" for axis in "xyz"] + [f"{kind}_{payload}" for kind in STANDARD]
        sigma = [np.nan] * 13
        for kind, value in list(doubt._asdict().items())[:9]:
            size = 1 if kind == "delay_s" else 3
            sigma += [value] * size
            names += [kind] if size == 1 else [f"{kind}_{axis}" for axis in "xyz"]
        self._kept: IndexArray = np.flatnonzero(np.not_equal(sigma, 0.0))
        self._imu = self._kept[13:]
        r = self._basis.shape[1]
        self.names = tuple(names[k] for k in self._kept) + tuple(f"links_{k}" for k in range(r))
        self.sigma = np.concatenate([np.asarray(sigma)[self._kept], np.ones(r)])
        self.links = slice(len(self._kept), len(self.names))
        self.biases: list[tuple[int, int]] = [  # where a bias is in the state, and where its drift
            (self.names.index(f"{kind}_bias_{unit}_{axis}"), self.names.index(f"{kind}_drift_{drift}_{axis}"))
            for kind, unit, drift in (("gyro", "rad_s", "rad_s2"), ("accelerometer", "m_s2", "m_s3"))
            for axis in "xyz"
            if f"{kind}_drift_{drift}_{axis}" in self.names and f"{kind}_bias_{unit}_{axis}" in self.names
        ]

    def joint_noise(self, q: FloatArray, joint_sigma: FloatArray, state: FloatArray) -> FloatArray:
        """What the joints' own noise makes of the prediction, one sigma, (n, 6).

        The base takes up what momentum the joints seem to have: its twist errs by ``-C^-1 M`` times the error of their
        rates, its acceleration by the same times that of their accelerations. The products of rates are left out.

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
        force = twist[:, :3] + cross(twist[:, 3:], self._p)
        effect = np.stack([twist[:, 3:] @ self._R, force @ self._R], axis=1).reshape(len(some), joints, 2, 3) ** 2
        variance = np.einsum("njki,nkj->nki", effect[np.arange(n) // _POSTURE_TICKS], joint_sigma**2)
        return np.asarray(np.sqrt(variance).reshape(n, 6), np.float64)

    def predict(self, links: tuple[LinkMotion, ...], state: FloatArray) -> Prediction:
        """From a state at the first of b + 2 ticks.

        Args:
            links: their motion at these ticks.
            state: (p,) at the first of them.

        Raises:
            SignalError: fewer than four ticks.
        """
        n, p = len(links[0].p), len(self.names)
        x = np.zeros(_LINKS)
        x[self._kept] = state[: self.links.start]
        base = predict_base(links, self.period_s, self._chi(state), x[MOMENTUM], self._free)
        true, d_true = at_sensor(base, self._R, self._p)
        time = self.period_s * np.arange(n)[1:-1]
        here, before, after = slice(1, -1), slice(0, -2), slice(2, None)
        change = (true[after] - true[before]) / (2.0 * self.period_s)
        own = true[here] + self._mean * (true[after] - 2.0 * true[here] + true[before])
        d_own = d_true[here] + self._mean * (d_true[after] - 2.0 * d_true[here] + d_true[before])
        gyro, accelerometer, delay_s = x[_IMU : _IMU + 12], x[_IMU + 12 : _IMU + 24], x[_IMU + 24]
        values, jacobian = np.empty((n - 2, 6)), np.zeros((n - 2, 6, p))
        errors = np.zeros((n - 2, 6, 25))
        for k, part in enumerate((gyro, accelerometer)):
            bias, drift, scale, turn = part.reshape(4, 3)
            rows = slice(3 * k, 3 * k + 3)
            late = own[:, rows] - delay_s * change[:, rows]
            E = np.eye(3) + np.diag(scale) - hat(turn)
            values[:, rows] = late @ E.T + bias + time[:, None] * drift
            d_own[:, rows] = E @ d_own[:, rows]
            columns = errors[:, rows, 12 * k : 12 * k + 12]
            columns[:, :, :3] = np.eye(3)
            columns[:, :, 3:6] = time[:, None, None] * np.eye(3)
            columns[:, :, 6:9] = late[:, :, None] * np.eye(3)
            columns[:, :, 9:] = hat(late)
            errors[:, rows, 24] = -change[:, rows] @ E.T
        jacobian[:, :, :13] = d_own[:, :, :13]
        jacobian[:, :, 13 : self.links.start] = errors[:, :, self._imu - _IMU]
        jacobian[:, :, self.links] = d_own[:, :, 13:] @ self._basis
        state, transition = state.copy(), np.eye(p)
        state[MOMENTUM] = base.momentum[-2]
        transition[MOMENTUM, :13] = base.d_momentum[-2, :, :13]
        transition[MOMENTUM, self.links] = base.d_momentum[-2, :, 13:] @ self._basis
        for bias_at, drift_at in self.biases:
            state[bias_at] += time[-1] * state[drift_at]
            transition[bias_at, drift_at] = time[-1]
        return Prediction(values, jacobian, state, transition)

    def _chi(self, state: FloatArray) -> FloatArray:
        """Standard parameters of all links, (10 x links,)."""
        chi = self.vehicle.chi.copy()
        chi[self._columns] = state[PAYLOAD]
        chi[self._others] += self._basis @ state[self.links]
        return chi
