"""Tip paths in inertial space for a base that floats: joint rates by the generalized Jacobian (2.94), damped.

``dq = J*' (J* J*' + d^2 1)^-1 (P_dot + K e - P_dot_0)``, e the error of the tip's pose so far. The damping d (Nakamura
and Hanafusa 1986) sets in where the least singular value of J* falls below ``near_m`` and bounds the rates near dynamic
singularities; there the tip leaves its path. The base's pose is integrated beside the joints from the same momentum, by
the midpoint rule.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import BoolArray, FloatArray

TipPath = Callable[[float], tuple[FloatArray, FloatArray]]
"""Time, s, to the tip's wanted pose in inertial axes: ``R_WT (3, 3)``, ``p_WT (3,)`` m."""


class TipMotion(NamedTuple):
    """Joints and base along a path; inertial axes are the base's at the start."""

    time_s: FloatArray  # (m,)
    q: FloatArray  # (m, n)
    dq: FloatArray  # (m, n)
    attitude: FloatArray  # (m, 3, 3) R_WB
    position: FloatArray  # (m, 3) m, p_WB
    error: FloatArray  # (m, 6) of the tip's position, m, and attitude, rad
    at_limit: BoolArray  # (m, n) joints held at their limits


def follow(
    arm: FloatingArm,
    q_start: FloatArray,
    path: TipPath,
    duration_s: float,
    period_s: float = 0.005,
    momentum: FloatArray | None = None,
    orientation: bool = False,
    damping_m: float = 0.05,
    near_m: float = 0.05,
    gain_1_s: float = 10.0,
) -> TipMotion:
    """Joint motion that moves the tip along a path while the base floats (2.94, damped).

    Args:
        arm: the vehicle.
        q_start: joint positions at the start, (n,).
        path: the tip's wanted pose; only positions are followed unless ``orientation``.
        duration_s: of the motion.
        period_s: of the integration.
        momentum: linear, and angular about the centre of mass, (6,), inertial axes; zero where not given.
        orientation: follow the attitude as well (six rows; needs six joints for every direction).
        damping_m: d at a singularity.
        near_m: least singular value from which on there is damping.
        gain_1_s: K, of the correction of what the tip is off by.

    Raises:
        SignalError: joint positions of another shape, or a period that is not positive.
    """
    if not (period_s > 0.0 and duration_s > 0.0):
        raise SignalError(f"a period of {period_s} s and a duration of {duration_s} s: both must be positive")
    h_W = np.zeros(6) if momentum is None else np.asarray(momentum, np.float64)
    rows = 6 if orientation else 3
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
        np.empty((m, 6)),
        np.zeros((m, n), np.bool_),
    )

    def damped(J: FloatArray, target: FloatArray) -> FloatArray:
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        d = damping_m**2 * max(0.0, 1.0 - (s[-1] / near_m) ** 2)
        return np.asarray(Vt.T @ (s / (s**2 + d + 1e-300) * (U.T @ target)), np.float64)

    def velocities(
        t: float, q: FloatArray, R_WB: FloatArray, p_WB: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        h_B = np.concatenate([R_WB.T @ h_W[:3], R_WB.T @ h_W[3:]])
        error = _pose_error(arm, q, R_WB, p_WB, path(t))
        ahead, behind = path(t + 0.5 * period_s), path(t - 0.5 * period_s)
        wanted = np.concatenate([ahead[1] - behind[1], pin.log3(ahead[0] @ behind[0].T)]) / period_s
        target = _rotated(R_WB.T, wanted + gain_1_s * error) - arm.tip_drift(q, h_B)
        J = arm.generalized_jacobian(q)[:rows]
        dq = damped(J, target[:rows])
        stuck = ((q <= low) & (dq < 0.0)) | ((q >= high) & (dq > 0.0))
        if stuck.any():  # the others take over what they can
            dq = damped(np.where(stuck, 0.0, J), target[:rows])
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
    """A path from where the tip is, by ``step_W_m`` (3,), attitude kept; minimum jerk, at rest at both ends."""
    R_WT, start = arm.tip_pose(np.asarray(q_start, np.float64))

    def at(time_s: float) -> tuple[FloatArray, FloatArray]:
        s = float(np.clip(time_s / duration_s, 0.0, 1.0))
        return R_WT, start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * np.asarray(step_W_m, np.float64)

    return at


def _rotated(R: FloatArray, twist: FloatArray) -> FloatArray:
    return np.concatenate([R @ twist[:3], R @ twist[3:]])


def _pose_error(
    arm: FloatingArm, q: FloatArray, R_WB: FloatArray, p_WB: FloatArray, wanted: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """What the tip lacks, (6,): metres, and a rotation vector, inertial axes."""
    R_BT, p_BT = arm.tip_pose(q)
    return np.concatenate([wanted[1] - (p_WB + R_WB @ p_BT), pin.log3(wanted[0] @ (R_WB @ R_BT).T)])
