"""Measurement rows of a free base: the wrench on the whole vehicle is zero (Limparis 3.5).

With the other links known, ``W_payload chi_payload = -W_known chi_known``.

The regressor is made of measured base motion: plain least squares are biased by its noise.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import composite_inertia, link_motions, wrench_columns
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import possible_body
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray, cross
from onboard.estimation.smoothing import smooth

_ROUNDS = 5


class BaseSignals(NamedTuple):
    """Motion of the base frame, base axes, each (n, 3); NaN where unknown."""

    rate: FloatArray
    acceleration: FloatArray
    specific_force: FloatArray


def measured_base(vehicle: VehicleModel, imu_frame: str, signals: FlightSignals, width_s: float) -> BaseSignals:
    """The base's motion from its smoothed IMU (:func:`onboard.regressor.rows.base_motion`).

    Args:
        vehicle: has the IMU's pose.
        imu_frame: the IMU's frame.
        signals: the flight.
        width_s: width of the kernel, common to all signals.
    """
    return base_of(vehicle, imu_frame, smoothed_imu(signals, width_s))


def smoothed_imu(signals: FlightSignals, width_s: float) -> BaseSignals:
    """The motion of the IMU's frame, in its axes, by a kernel of such a width."""
    known = np.isfinite(np.concatenate([signals.rate, signals.specific_force], axis=1)).all(axis=1)
    at = signals.period_s * np.arange(len(known))
    w, dw = (smooth(at[known], signals.rate[known], at, width_s, derivative).values for derivative in (0, 1))
    return BaseSignals(w, dw, smooth(at[known], signals.specific_force[known], at, width_s).values)


def base_of(vehicle: VehicleModel, imu_frame: str, imu: BaseSignals) -> BaseSignals:
    """The base's motion from that of an IMU's frame, in its axes."""
    R, p = vehicle.pose_in_base(imu_frame)
    w, dw, f = (part @ R.T for part in imu)
    return BaseSignals(w, dw, f - cross(dw, p) - cross(w, cross(w, p)))


def zero_wrench_rows(
    vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, base: BaseSignals
) -> tuple[FloatArray, FloatArray]:
    """Rows ``W_payload chi_payload = -W_known chi_known``: Y (n, 6, 10), y (n, 6); wrench about the base's origin."""
    columns, links = vehicle.payload_columns(), link_motions(vehicle, q, dq, ddq)
    Y, y = np.empty((len(base.rate), 6, 10)), np.zeros((len(base.rate), 6))
    for index, link in enumerate(links):
        W = wrench_columns(link, base.rate, base.specific_force, base.acceleration)
        if 10 * index == columns.start:
            Y = W
        else:
            y -= W @ vehicle.chi[10 * index : 10 * index + 10]
    return Y, y


def rough_payload(
    vehicle: VehicleModel, imu_frame: str, signals: FlightSignals, width_s: float, sigma: FloatArray
) -> RigidBody:
    """Payload by least squares on :func:`zero_wrench_rows` with the accelerometer's offset: a biased initial guess.

    Args:
        vehicle: with a payload link.
        imu_frame: the IMU's frame.
        signals: the flight.
        width_s: width of the kernel that smooths the base's motion.
        sigma: prior standard deviations of the payload's standard parameters about none, (10,).

    Raises:
        SignalError: a mass that is not positive.
    """
    base = measured_base(vehicle, imu_frame, signals, width_s)
    whole = np.isfinite(base.specific_force).all(axis=1) & np.isfinite(base.acceleration).all(axis=1)
    q, dq, ddq = signals.q[whole], signals.dq[whole], signals.ddq[whole]
    moved = BaseSignals(*(part[whole] for part in base))
    links, chi, zero = link_motions(vehicle, q, dq, ddq), vehicle.chi.copy(), np.zeros(3)
    mean, covariance, noise = np.zeros(10), np.eye(10), 1.0
    for _ in range(_ROUNDS):  # Gauss-Newton: the offset acts on all masses, including the payload's
        Y, y = zero_wrench_rows(vehicle, q, dq, ddq, moved._replace(specific_force=moved.specific_force - zero))
        chi[vehicle.payload_columns()] = mean
        rows = np.concatenate([Y, -composite_inertia(links, chi)[:, :, :3]], axis=2).reshape(-1, 13)
        information = rows.T @ rows / noise + np.diag([*(1.0 / sigma**2), 1.0, 1.0, 1.0])
        covariance = np.linalg.inv(information)
        solution = covariance @ (rows.T @ y.ravel()) / noise
        mean, zero = solution[:10], zero + solution[10:]
        noise = float(np.mean((y.ravel() - rows @ solution) ** 2))
    return possible_body(mean, covariance[:10, :10])
