"""Attitude of a floating base after a motion of the arm: non-holonomic drift, and turning the base by arm cycles alone.

At zero momentum the base turns with ``w = -D^-1 D_q dq`` (2.100 with 2.35), whatever the pace: the attitude after a
path of the joints depends on the path and on nothing else. A closed path leaves the arm as it was and the base turned.
The planner looks for closed paths ``q(s) = q_0 + sum_k a_k sin(2 pi k s) + b_k (1 - cos(2 pi k s))`` whose net
rotation, repeated so many times, is the one asked for (Yoshida's guaranteed workspace leaves such drift out; here it is
used).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray, cross
from onboard.estimation.errors import ConvergenceError

JointPath = Callable[[float], tuple[FloatArray, FloatArray]]
"""Path parameter 0..1 to joint positions (n,) and their derivative by it (n,)."""

_GAUSS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)


class Reorientation(NamedTuple):
    """Arm cycles that turn the base."""

    path: JointPath  # one cycle, closed
    cycles: int
    rotation: FloatArray  # (3, 3) R_WB after all of them
    error_rad: float  # from what was asked for
    swing_rad: FloatArray  # (n,) farthest that each joint goes from the start


def attitude_after(arm: FloatingArm, path: JointPath, steps: int = 200) -> FloatArray:
    """``R_WB``, (3, 3), after a path of the joints from R = 1 and zero momentum; fourth-order Magnus integration."""
    R, h = np.eye(3), 1.0 / steps
    for k in range(steps):
        w = []
        for node in _GAUSS:
            q, slope = path((k + node) * h)
            w.append(arm.base_motion(q, slope)[3:])
        R = R @ pin.exp3(0.5 * h * (w[0] + w[1]) + np.sqrt(3.0) / 12.0 * h**2 * cross(*w))
    return np.asarray(R, np.float64)


def fourier_path(q_start: FloatArray, coefficients: FloatArray) -> JointPath:
    """A closed path; coefficients (2, harmonics, n): sines, then ``1 - cos`` terms, rad."""
    sines, cosines = coefficients
    rate = 2.0 * np.pi * np.arange(1, len(sines) + 1)

    def at(s: float) -> tuple[FloatArray, FloatArray]:
        sine, cosine = np.sin(rate * s), np.cos(rate * s)
        q = q_start + sine @ sines + (1.0 - cosine) @ cosines
        return q, (rate * cosine) @ sines + (rate * sine) @ cosines

    return at


def reorient(
    arm: FloatingArm, q_start: FloatArray, rotation_vector: FloatArray, most_cycles: int = 64, harmonics: int = 2
) -> Reorientation:
    """Arm cycles that turn the base by ``rotation_vector`` and return the arm (2.100; search derived here).

    The fewest cycles, doubled from one, for which a path within the joints' limits is found; Newton's method with the
    smallest step in the coefficients.

    Args:
        arm: the vehicle, at rest.
        q_start: joint positions before and after, (n,).
        rotation_vector: base axes at the start, (3,) rad, shorter than a half turn.
        most_cycles: to try.
        harmonics: of the path.

    Raises:
        SignalError: no rotation vector shorter than a half turn, or joint positions of another shape.
        ConvergenceError: no such path was found.
    """
    wanted = np.asarray(rotation_vector, np.float64)
    if wanted.shape != (3,) or not np.linalg.norm(wanted) < np.pi or q_start.shape != (arm.joints,):
        raise SignalError("give joint positions (n,) and a rotation vector (3,) shorter than pi")
    rng = np.random.default_rng(0)  # of the first guesses
    low = np.array([joint.low for joint in arm.vehicle.joints])
    high = np.array([joint.high for joint in arm.vehicle.joints])
    cycles = 1
    while cycles <= most_cycles:
        for _ in range(3):
            x = _solve(arm, q_start, wanted / cycles, rng.normal(0.0, 0.4, (2, harmonics, arm.joints)))
            if x is None:
                continue
            path = fourier_path(q_start, x)
            q = np.array([path(s)[0] for s in np.linspace(0.0, 1.0, 201)])
            if (q >= low).all() and (q <= high).all():
                R = np.linalg.matrix_power(attitude_after(arm, path, 400), cycles)
                error = float(np.linalg.norm(pin.log3(R.T @ pin.exp3(wanted))))
                return Reorientation(path, cycles, R, error, np.abs(q - q_start).max(axis=0))
        cycles *= 2
    raise ConvergenceError(f"no path of {most_cycles} cycles turns the base so; allow more, or ask for a smaller turn")


def _solve(arm: FloatingArm, q_start: FloatArray, wanted: FloatArray, x: FloatArray) -> FloatArray | None:
    """Coefficients whose cycle turns the base by ``wanted``; None where Newton's method does not get there."""
    goal = pin.exp3(wanted)

    def error(x: FloatArray) -> FloatArray:
        return np.asarray(pin.log3(attitude_after(arm, fourier_path(q_start, x), 40).T @ goal), np.float64)

    e = error(x)
    for iteration in range(30):
        if np.linalg.norm(e) < 1e-9:
            return x
        J = np.empty((3, x.size))
        for k in range(x.size):
            moved = x.ravel().copy()
            moved[k] += 1e-6
            J[:, k] = (error(moved.reshape(x.shape)) - e) / 1e-6
        step = -J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(3), e)
        if iteration < 10:  # towards shorter paths of the same effect
            step -= 0.1 * (x.ravel() - J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(3), J @ x.ravel()))
        shorter = min(1.0, 0.3 / float(np.abs(step).max()))
        x = x + shorter * step.reshape(x.shape)
        e = error(x)
    return x if np.linalg.norm(e) < 1e-6 else None
