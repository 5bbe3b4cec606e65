"""How a body moved before it was captured, from the momentum that it brought.

The capture changes the base's twist by ``d`` while the joints go on as they were told, and nothing acts from outside.
With A_s the locked inertia of the servicer about its base, A_p that of the payload about its frame in the gripper, and
X, X* the changes of frame of a twist and of a momentum from the base to there, conservation gives the payload's twist
before, against that of the gripper:

    U = X d + A_p^-1 X* A_s d

The rate's change is measured by the gyro, the velocity's by the accelerometer's impulse. A light payload brings little
momentum: what U does not tell, its covariance does.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.errors import SignalError
from onboard.dynamics.inertia import symmetric
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.spatial import hat
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.exiddm.ticks import Ticks

_SPREAD, _BESIDE = 2, 12  # ticks over which filters spread an impulse, on each side; that tell the motion there
_LATE = 0.15  # of a tick: sigma of the time of the jump
_RELATIVE = 0.01  # of a jump: scale and misalignment of the IMU, delays
_STEP = 1e-3  # of a derivative, in sigmas


class Jump(NamedTuple):
    """Change of the base's twist in a capture, base axes, at its origin."""

    at: int  # tick
    twist: FloatArray  # (6,) m/s, rad/s
    covariance: FloatArray  # (6, 6)


class BeforeCapture(NamedTuple):
    """The payload's motion against the gripper just before, at the payload's frame, its axes."""

    velocity_m_s: FloatArray  # (3,)
    rate_rad_s: FloatArray  # (3,)
    covariance: FloatArray  # (6, 6) in this order

    @property
    def sigma(self) -> FloatArray:
        """(6,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)


def jump_of(ticks: Ticks, R_BS: FloatArray, p_BoSo_B: FloatArray, period_s: float) -> Jump:
    """The largest impulse in some ticks.

    Args:
        ticks: about a capture, half a second and more.
        R_BS: from the IMU's axes to the base's, (3, 3).
        p_BoSo_B: the IMU's place, (3,) m.
        period_s: between ticks.

    Raises:
        SignalError: too few ticks beside it, or without readings.
    """
    force, n = ticks.measured[:, 3:6], len(ticks.time_s)
    beside = _SPREAD + _BESIDE
    if n < 2 * beside + 1:
        raise SignalError(f"{n} ticks about the capture; {2 * beside + 1} are needed")
    away = np.linalg.norm(force - np.nanmedian(force, axis=0), axis=1)
    at = beside + int(np.nanargmax(np.where(np.isfinite(away), away, -1.0)[beside : n - beside]))
    whole = slice(at - beside, at + beside + 1)
    if not np.isfinite(ticks.measured[whole, :6]).all():
        raise SignalError("readings are missing about the capture")
    t = np.asarray(period_s * np.arange(-beside, beside + 1), np.float64)
    values, sigma = ticks.measured[whole, :6], ticks.sigma[whole, :6].mean(axis=0)
    middle = np.abs(t) < (_SPREAD + 0.5) * period_s
    (w0, w1), variance_rate = _sides(t, values[:, :3], (np.abs(t) > 1.5 * period_s), 3, period_s)
    (f0, f1), variance_force = _sides(t, values[:, 3:], ~middle, 2, period_s)
    apart = w1[0] - w0[0]
    share = float(np.clip((w1[0] - values[beside, :3]) @ apart / max(float(apart @ apart), 1e-12), 0.0, 1.0))
    at_s = period_s * (share - 0.5)  # of the jump, in its tick
    rate = (_powers(np.array([at_s]), 3) @ (w1 - w0))[0]
    own = np.where(t[middle, None] < 0.0, _powers(t[middle], 2) @ f0, _powers(t[middle], 2) @ f1)
    own[_SPREAD] = share * f0[0] + (1.0 - share) * f1[0]
    velocity = period_s * (values[middle, 3:] - own).sum(axis=0)
    ticks_of_it = float(middle.sum())
    of_velocity = period_s**2 * (ticks_of_it + 0.5 * ticks_of_it**2 * variance_force)
    late = _LATE * period_s
    variance = np.concatenate([of_velocity * sigma[3:] ** 2, 2.0 * variance_rate * sigma[:3] ** 2])
    variance += late**2 * np.concatenate([(f1 - f0)[0] ** 2, (w1 - w0)[1] ** 2])
    sensed = np.concatenate([velocity, rate])
    variance += _RELATIVE**2 * np.repeat([velocity @ velocity, rate @ rate], 3)
    into = np.zeros((6, 6))  # twist of the base by that of the IMU
    into[:3, :3] = into[3:, 3:] = R_BS
    into[:3, 3:] = hat(p_BoSo_B) @ R_BS
    return Jump(at, into @ sensed, into @ np.diag(variance) @ into.T)


def before_capture(
    vehicle: VehicleModel, q: FloatArray, jump: Jump, chi: FloatArray, chi_covariance: FloatArray
) -> BeforeCapture:
    """Motion of the payload before it was captured.

    Args:
        vehicle: with a payload link.
        q: joints at the capture, (n,).
        jump: of the base.
        chi: identified standard parameters of the payload, (10,).
        chi_covariance: of these, (10, 10).

    Raises:
        SignalError: a payload without a mass or inertia.
    """
    bare = vehicle.chi.copy()
    bare[vehicle.payload_columns()] = 0.0
    arm = FloatingArm(vehicle, str(vehicle.spec.payload_link), bare)
    servicer = arm.mass_matrix(q)[:6, :6]
    R, p = arm.tip_pose(q)
    X, force = np.zeros((6, 6)), np.zeros((6, 6))
    X[:3, :3] = X[3:, 3:] = force[:3, :3] = force[3:, 3:] = R.T
    X[:3, 3:], force[3:, :3] = -R.T @ hat(p), -R.T @ hat(p)
    momentum = force @ servicer

    def against(parameters: FloatArray) -> FloatArray:
        payload = _spatial(parameters)
        if not np.linalg.eigvalsh(payload).min() > 0.0:
            raise SignalError("the payload found has no mass or inertia that a body can have")
        return np.asarray(X + np.linalg.solve(payload, momentum), np.float64)

    gain = against(chi)
    U = gain @ jump.twist
    sigma = np.sqrt(np.diag(chi_covariance))
    D = np.column_stack(
        [
            (against(chi + _STEP * s * unit) @ jump.twist - U) / (_STEP * s)
            for s, unit in zip(sigma, np.eye(10), strict=True)
        ]
    )
    covariance = gain @ jump.covariance @ gain.T + D @ chi_covariance @ D.T
    return BeforeCapture(U[:3], U[3:], np.asarray(covariance, np.float64))


def _sides(
    t: FloatArray, values: FloatArray, beside: BoolArray, order: int, period_s: float
) -> tuple[list[FloatArray], float]:
    """Polynomials through values before and after time 0, (order, k) each, and the variance of their values there."""
    found, variance = [], 0.0
    for side in (beside & (t < 0.0), beside & (t > 0.0)):
        A = _powers(t[side] / period_s, order)
        found.append(np.linalg.lstsq(A, values[side], rcond=None)[0] / period_s ** np.arange(order)[:, None])
        variance = float(np.linalg.inv(A.T @ A)[0, 0])
    return found, variance


def _powers(t: FloatArray, order: int) -> FloatArray:
    return np.asarray(t[:, None] ** np.arange(order), np.float64)


def _spatial(chi: FloatArray) -> FloatArray:
    """Spatial inertia about the frame's origin, linear first, (6, 6)."""
    out, moment = np.zeros((6, 6)), hat(chi[1:4])
    out[:3, :3], out[:3, 3:], out[3:, :3] = chi[0] * np.eye(3), -moment, moment
    out[3:, 3:] = symmetric(chi[4:])
    return out
