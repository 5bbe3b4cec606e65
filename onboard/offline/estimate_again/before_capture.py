"""How a body moved before it was captured, from the momentum that it brought.

Between a tick before the first touch and one after the grip has closed nothing acts from outside, so the momentum of
vehicle and payload together is constant. That of the vehicle alone before, and that of both as one after it, differ by
what the payload brought; its own inertia makes the twist of that. The base's rate is that of the gyro, its velocity the
integral of the accelerometer; a light payload brings little momentum: what it does not tell, the covariance does.

How long the contact lasts is not known. The shortest time is taken that tells the same as all longer ones.
"""

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from onboard.dynamics.errors import SignalError
from onboard.dynamics.inertia import symmetric
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.spatial import hat
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.exiddm.ticks import Ticks

_EARLY_s: Final = 0.05  # of the strongest push, in which the first touch lies
_CONTACTS_s: Final = (0.03, 0.06, 0.12, 0.25, 0.5)  # from there until the grip has closed
_BESIDE: Final = 12  # ticks on each side that tell the rate there
_OTHER: Final = 1e-2  # chance below which two times tell different motions
_RELATIVE: Final = 0.01  # of a push: scale and misalignment of the IMU, delays
_STEP: Final = 1e-3  # of a derivative, in sigmas


class Imu(NamedTuple):
    """The base's IMU and its zeros at the capture."""

    R_BS: FloatArray  # (3, 3)
    p_BoSo_B: FloatArray  # noqa: N815 - (3,) m
    zeros: FloatArray  # (6,) gyro, accelerometer; its axes
    covariance: FloatArray  # (6, 6)


class Payload(NamedTuple):
    """Standard parameters of what was caught, as identified."""

    chi: FloatArray  # (10,)
    covariance: FloatArray  # (10, 10)


class BeforeCapture(NamedTuple):
    """The payload's motion against the gripper just before: its centre of mass, and its rate; the gripper's axes."""

    velocity_m_s: FloatArray  # (3,)
    rate_rad_s: FloatArray  # (3,)
    covariance: FloatArray  # (6, 6) in this order
    touched_s: float  # the strongest push

    @property
    def sigma(self) -> FloatArray:
        """(6,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)


def before_capture(servicer: FloatingArm, ticks: Ticks, imu: Imu, period_s: float, payload: Payload) -> BeforeCapture:
    """Motion of the payload before it was captured.

    Args:
        servicer: the vehicle without it, its tip the gripper's frame.
        ticks: about the capture, one second or more.
        imu: whose lines are the first six.
        period_s: between ticks.
        payload: what is held.

    Raises:
        SignalError: too few ticks, readings missing, or a payload without a mass or inertia.
    """
    early, latest = (round(part / period_s) for part in (_EARLY_s, _CONTACTS_s[-1]))
    n = len(ticks.time_s)
    if n < early + latest + 2 * _BESIDE + 1:
        raise SignalError(f"{n} ticks about the capture; {early + latest + 2 * _BESIDE + 1} are needed")
    force = ticks.measured[:, 3:6]
    away = np.linalg.norm(force - np.nanmedian(force, axis=0), axis=1)
    window = slice(_BESIDE + early, n - _BESIDE - latest)
    at = window.start + int(np.nanargmax(np.where(np.isfinite(away), away, -1.0)[window]))
    whole = slice(at - early - _BESIDE, at + latest + _BESIDE + 1)
    seen = ticks.part(whole)
    if not np.isfinite(np.column_stack([seen.measured[:, :6], seen.q, seen.dq])).all():
        raise SignalError("readings are missing about the capture")
    if not np.linalg.eigvalsh(_spatial(payload.chi)).min() > 0.0:
        raise SignalError("the payload found has no mass or inertia that a body can have")
    touched_s, zero = float(ticks.time_s[at]), _BESIDE
    found: list[_Told] = []
    for lasts_s in reversed(_CONTACTS_s):
        end = zero + early + max(2, round(lasts_s / period_s))
        one = _over(servicer, seen, imu, period_s, payload, slice(zero, end + 1))
        if not all(_agree(one, other) for other in found):
            break
        found.append(one)
    best = found[-1]
    return BeforeCapture(best.motion[:3], best.motion[3:], best.noise + best.common, touched_s)


class _Told(NamedTuple):
    motion: FloatArray  # (6,)
    noise: FloatArray  # (6, 6) covariance by the readings
    common: FloatArray  # by what is the same for every time


def _agree(short: _Told, long: _Told) -> bool:
    """Whether two times tell the same: the readings of the shorter are a part of the longer's."""
    away = short.motion - long.motion
    return bool(away @ np.linalg.solve(long.noise, away) < chdtri(6, _OTHER))


def _over(servicer: FloatingArm, ticks: Ticks, imu: Imu, period_s: float, payload: Payload, span: slice) -> _Told:
    """The payload's motion by the momentum between the first and the last tick of a span."""
    first, last = span.start, span.stop - 1
    t = np.asarray(period_s * np.arange(len(ticks.time_s)), np.float64)
    gyro, sigma = ticks.measured[:, :3], np.asarray(ticks.sigma[:, :6].mean(axis=0), np.float64)
    w0, variance0 = _value(t - t[first], gyro, t <= t[first])
    w1, variance1 = _value(t - t[last], gyro, (t >= t[last]) & (t < t[last] + _BESIDE * period_s))
    joints, count = servicer.joints, last - first
    push = period_s * np.abs(ticks.measured[span, 3:6] - imu.zeros[3:]).sum(axis=0)
    noise = [
        (variance0 * sigma[:3] ** 2, w0),
        (variance1 * sigma[:3] ** 2, w1),
        (period_s**2 * count * sigma[3:] ** 2 + (_RELATIVE * np.linalg.norm(push)) ** 2, np.zeros(3)),
        (ticks.joint_sigma[first, 0] ** 2, ticks.dq[first]),
        (ticks.joint_sigma[last, 0] ** 2, ticks.dq[last]),
    ]
    covariances = [*(np.diag(variance) for variance, _ in noise), imu.covariance, payload.covariance]
    values = np.concatenate([*(value for _, value in noise), imu.zeros, payload.chi])
    parts = np.cumsum([3, 3, 3, joints, joints, 6])

    def told(z: FloatArray) -> FloatArray:
        w0, w1, dv, dq0, dq1, zeros, chi = np.split(z, parts)
        R, v, p = _travelled(ticks.measured[span, :6] - zeros, imu.R_BS, period_s)
        v = v + imu.R_BS @ dv
        rate0, rate1 = imu.R_BS @ (w0 - zeros[:3]), imu.R_BS @ (w1 - zeros[:3])
        twist0 = np.concatenate([-np.cross(rate0, imu.p_BoSo_B), rate0, dq0])
        twist1 = np.concatenate([R.T @ v - np.cross(rate1, imu.p_BoSo_B), rate1, dq1])
        q0, q1 = ticks.q[first], ticks.q[last]
        before = servicer.mass_matrix(q0)[:6] @ twist0
        after = servicer.mass_matrix(q1)[:6] @ twist1 + _carried(servicer, q1, twist1, chi)
        moved = imu.p_BoSo_B + p - R @ imu.p_BoSo_B
        linear = R @ after[:3] - before[:3]
        angular = R @ after[3:] + np.cross(moved, R @ after[:3]) - before[3:]
        R_BT, p_BT = servicer.tip_pose(q0)
        brought = np.concatenate([R_BT.T @ linear, R_BT.T @ (angular - np.cross(p_BT, linear))])
        grip = servicer.tip_jacobian(q0) @ twist0
        U = np.linalg.solve(_spatial(chi), brought) - np.concatenate([R_BT.T @ grip[:3], R_BT.T @ grip[3:]])
        return np.concatenate([U[:3] + np.cross(U[3:], chi[1:4] / chi[0]), U[3:]])

    by = list(_propagated(told, values, covariances))
    return _Told(told(values), np.sum(by[:-2], axis=0), np.sum(by[-2:], axis=0))


def _propagated(
    told: Callable[[FloatArray], FloatArray], values: FloatArray, blocks: list[FloatArray]
) -> Iterator[FloatArray]:
    """Covariance, (6, 6), of a function of values by each of their parts with such covariances."""
    centre, at = told(values), 0
    for block in blocks:
        sigma = np.sqrt(np.diag(block))
        columns = np.zeros((6, len(sigma)))
        for k in np.flatnonzero(sigma):
            moved = values.copy()
            moved[at + k] += _STEP * sigma[k]
            columns[:, k] = (told(moved) - centre) / (_STEP * sigma[k])
        yield columns @ block @ columns.T
        at += len(sigma)


def _travelled(readings: FloatArray, R_BS: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitude of the base at the end of some ticks, velocity gained there by its IMU, and way; first axes."""
    rate, force = readings[:, :3] @ R_BS.T, readings[:, 3:] @ R_BS.T
    turn = Rotation.from_rotvec(0.5 * period_s * (rate[1:] + rate[:-1]))
    R = [np.eye(3)]
    for one in turn.as_matrix():
        R.append(R[-1] @ one)
    a = np.einsum("kij,kj->ki", R, force)
    v = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * period_s * (a[1:] + a[:-1]), axis=0)])
    return R[-1], v[-1], period_s * (v[:-1] + v[1:]).sum(axis=0) / 2.0


def _carried(servicer: FloatingArm, q: FloatArray, twist: FloatArray, chi: FloatArray) -> FloatArray:
    """Momentum of a payload in the gripper, (6,), base axes, about the base's origin."""
    R, p = servicer.tip_pose(q)
    tip = servicer.tip_jacobian(q) @ twist
    own = _spatial(chi) @ np.concatenate([R.T @ tip[:3], R.T @ tip[3:]])
    linear = R @ own[:3]
    return np.concatenate([linear, R @ own[3:] + np.cross(p, linear)])


def _value(t: FloatArray, values: FloatArray, beside: BoolArray) -> tuple[FloatArray, float]:
    """At time 0, of a parabola through the values of some ticks, and its variance for one of theirs."""
    A = (t[beside, None] / max(float(np.abs(t[beside]).max()), 1e-12)) ** np.arange(3)
    found = np.linalg.lstsq(A, values[beside], rcond=None)[0]
    return np.asarray(found[0], np.float64), float(np.linalg.inv(A.T @ A)[0, 0])


def _spatial(chi: FloatArray) -> FloatArray:
    """Spatial inertia about the frame's origin, linear first, (6, 6)."""
    out, moment = np.zeros((6, 6)), hat(chi[1:4])
    out[:3, :3], out[:3, 3:], out[3:, :3] = chi[0] * np.eye(3), -moment, moment
    out[3:, 3:] = symmetric(chi[4:])
    return out
