"""Tip paths in inertial space for a base that floats: joint rates by the generalized Jacobian (2.94), damped.

``dq = J*' (J* J*' + d^2 1)^-1 (P_dot + K e - P_dot_0)``, e the error of the tip's position so far. The damping d
(Nakamura and Hanafusa 1986) sets in where the least singular value of J* falls below 0.05 m and bounds the rates near
dynamic singularities; there the tip leaves its path. The base's pose is integrated beside the joints from the same
momentum, by the midpoint rule.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import BoolArray, FloatArray

TipPath = Callable[[float], FloatArray]
"""Time, s, to the tip's wanted position in inertial axes, ``p_WT (3,)`` m."""
_DAMPING_M = 0.05  # d at a singularity
_NEAR_M = 0.05  # least singular value from which on there is damping
_GAIN_1_S = 10.0  # K, of the correction of what the tip is off by


class TipMotion(NamedTuple):
    """Joints and base along a path; inertial axes are the base's at the start."""

    time_s: FloatArray  # (m,)
    q: FloatArray  # (m, n)
    dq: FloatArray  # (m, n)
    attitude: FloatArray  # (m, 3, 3) R_WB
    position: FloatArray  # (m, 3) m, p_WB
    error: FloatArray  # (m, 3) of the tip's position, m
    at_limit: BoolArray  # (m, n) joints held at their limits


def follow(
    arm: FloatingArm,
    q_start: FloatArray,
    path: TipPath,
    duration_s: float,
    period_s: float = 0.005,
    momentum: FloatArray | None = None,
) -> TipMotion:
    """Joint motion that moves the tip along a path while the base floats (2.94, damped).

    Args:
        arm: the vehicle.
        q_start: joint positions at the start, (n,).
        path: the tip's wanted position.
        duration_s: of the motion.
        period_s: of the integration.
        momentum: linear, and angular about the centre of mass, (6,), inertial axes; zero where not given.

    Raises:
        SignalError: joint positions of another shape, or a period that is not positive.
    """
    if not (period_s > 0.0 and duration_s > 0.0):
        raise SignalError(f"a period of {period_s} s and a duration of {duration_s} s: both must be positive")
    h_W = np.zeros(6) if momentum is None else np.asarray(momentum, np.float64)
    low = np.array([joint.low for joint in arm.vehicle.joints])
    high = np.array([joint.high for joint in arm.vehicle.joints])
    steps = round(duration_s / period_s)
    q, R_WB, p_WB = np.array(q_start, np.float64), np.eye(3), np.zeros(3)
    m, n = steps + 1, arm.joints
    out = TipMotion(
        np.asarray(period_s * np.arange(m), np.float64),
        np.empty((m, n)),
        np.empty((m, n)),
        np.empty((m, 3, 3)),
        np.empty((m, 3)),
        np.empty((m, 3)),
        np.zeros((m, n), np.bool_),
    )

    def damped(J: FloatArray, target: FloatArray) -> FloatArray:
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        d = _DAMPING_M**2 * max(0.0, 1.0 - (s[-1] / _NEAR_M) ** 2)
        return np.asarray(Vt.T @ (s / (s**2 + d + 1e-300) * (U.T @ target)), np.float64)

    def velocities(
        t: float, q: FloatArray, R_WB: FloatArray, p_WB: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        h_B = np.concatenate([R_WB.T @ h_W[:3], R_WB.T @ h_W[3:]])
        error = path(t) - (p_WB + R_WB @ arm.tip_pose(q)[1])
        wanted = (path(t + 0.5 * period_s) - path(t - 0.5 * period_s)) / period_s
        target = R_WB.T @ (wanted + _GAIN_1_S * error) - arm.tip_drift(q, h_B)[:3]
        J = arm.generalized_jacobian(q)[:3]
        dq = damped(J, target)
        stuck = ((q <= low) & (dq < 0.0)) | ((q >= high) & (dq > 0.0))
        if stuck.any():  # the others take over what they can
            dq = damped(np.where(stuck, 0.0, J), target)
        return dq, arm.base_motion(q, dq, h_B), error, stuck

    for k in range(m):
        t = float(out.time_s[k])
        dq, base, error, stuck = velocities(t, q, R_WB, p_WB)
        out.q[k], out.dq[k], out.attitude[k], out.position[k] = q, dq, R_WB, p_WB
        out.error[k], out.at_limit[k] = error, stuck
        half_R = R_WB @ pin.exp3(0.5 * period_s * base[3:])
        half_p = p_WB + 0.5 * period_s * R_WB @ base[:3]
        dq, base, _, _ = velocities(t + 0.5 * period_s, q + 0.5 * period_s * dq, half_R, half_p)
        q = np.clip(q + period_s * dq, low, high)
        p_WB = p_WB + period_s * half_R @ base[:3]
        R_WB = R_WB @ pin.exp3(period_s * base[3:])
    return out


def straight_line(arm: FloatingArm, q_start: FloatArray, step_W_m: FloatArray, duration_s: float) -> TipPath:
    """A path from where the tip is, by ``step_W_m`` (3,); minimum jerk, at rest at both ends."""
    _, start = arm.tip_pose(np.asarray(q_start, np.float64))

    def at(time_s: float) -> FloatArray:
        s = float(np.clip(time_s / duration_s, 0.0, 1.0))
        return start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * np.asarray(step_W_m, np.float64)

    return at
