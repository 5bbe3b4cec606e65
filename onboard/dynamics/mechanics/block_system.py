"""Stoneking's block system: Newton and Euler of bodies joined by passive spherical joints (2.102-2.109).

All accelerations and joint forces of a chain of N bodies are one linear system of order 6 N + 3 (N - 1): each body's
angular and linear acceleration, and the constraint that both bodies of a joint accelerate alike there. Rates are in
body axes, velocities and forces in inertial ones. Integrated by Runge and Kutta's fourth order; positions follow from
the first body's, so joints do not come apart.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.errors import SignalError
from onboard.dynamics.mechanics.chain import Chain
from onboard.estimation.arrays import FloatArray


class BlockState(NamedTuple):
    """Of N bodies."""

    R: FloatArray  # (N, 3, 3) R_Wi
    rate: FloatArray  # (N, 3) rad/s, body axes
    position: FloatArray  # (3,) m, centre of mass of the first body, inertial axes
    velocity: FloatArray  # (3,) m/s


class BlockSystem:
    """A chain of bodies with spherical joints.

    Args:
        chain: masses, centres of mass, inertias and joint places; its joints' axes are not used.

    Raises:
        SignalError: fewer than two bodies.
    """

    def __init__(self, chain: Chain) -> None:
        n = len(chain.mass)
        if n < 2:
            raise SignalError("a block system joins two bodies or more")
        self.bodies, self.order = n, 6 * n + 3 * (n - 1)
        self._inertia = chain.inertia
        self._to_next = _skews(chain.next_origin - chain.centre)  # lever to the next joint, body axes
        self._to_previous = _skews(-chain.centre)
        self._matrix = np.zeros((self.order, self.order))
        for i in range(n):
            self._matrix[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = chain.inertia[i]
            at = 3 * (n + i)
            self._matrix[at : at + 3, at : at + 3] = chain.mass[i] * np.eye(3)
        for joint in range(n - 1):
            force = slice(6 * n + 3 * joint, 6 * n + 3 * joint + 3)
            first, second = slice(3 * (n + joint), 3 * (n + joint) + 3), slice(3 * (n + joint + 1), 3 * (n + joint) + 6)
            self._matrix[first, force] = self._matrix[force, first] = -np.eye(3)
            self._matrix[second, force] = self._matrix[force, second] = np.eye(3)
        in_block, joints = np.arange(3), np.arange(n - 1)
        forces = 6 * n + 3 * joints[:, None, None] + in_block  # columns of each joint's force, (n - 1, 1, 3)
        self._levers = [  # where lever x R' of each joint and side stands; its transpose stands across the diagonal
            (3 * (joints + side)[:, None, None] + in_block[:, None], forces) for side in (0, 1)
        ]

    def accelerations(self, R: FloatArray, rate: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Angular accelerations (N, 3), body axes, and the first body's linear one (3,), inertial axes (2.109).

        Args:
            R: axes of the bodies, (N, 3, 3).
            rate: their rates, (N, 3), body axes.
            torque: of each joint on the body after it, (N - 1, 3), inertial axes.
        """
        n, A = self.bodies, self._matrix
        b = np.zeros(self.order)
        applied = -_cross(rate, (self._inertia @ rate[:, :, None])[:, :, 0])
        turning = np.swapaxes(R, 1, 2)  # R_iW
        applied[1:] += (turning[1:] @ torque[:, :, None])[:, :, 0]
        applied[:-1] -= (turning[:-1] @ torque[:, :, None])[:, :, 0]
        b[: 3 * n] = applied.ravel()
        constraint = np.zeros((n - 1, 3))
        sides = (slice(None, -1), self._to_next[:-1], -1.0), (slice(1, None), self._to_previous[1:], 1.0)
        for (bodies, lever, sign), (rows, columns) in zip(sides, self._levers, strict=True):
            block = sign * lever @ turning[bodies]
            A[rows, columns] = block
            A[np.swapaxes(columns, 1, 2), np.swapaxes(rows, 1, 2)] = np.swapaxes(block, 1, 2)
            spin = rate[bodies]
            swing = -(lever @ spin[:, :, None])[:, :, 0]  # rate x place
            constraint -= sign * (R[bodies] @ _cross(spin, swing)[:, :, None])[:, :, 0]
        b[6 * n :] = constraint.ravel()
        x: FloatArray = np.asarray(np.linalg.solve(A, b), np.float64)
        return x[: 3 * n].reshape(n, 3), x[3 * n : 3 * n + 3]

    def step(self, state: BlockState, step_s: float, torque: FloatArray | None = None) -> BlockState:
        """One step of Runge and Kutta, joint torques held, (N - 1, 3)."""
        tau = np.zeros((self.bodies - 1, 3)) if torque is None else torque
        slopes: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []
        for share in (0.0, 0.5, 0.5, 1.0):
            R, rate, velocity = state.R, state.rate, state.velocity
            if slopes:
                spin, acceleration, linear, _ = slopes[-1]
                R = _turned(state.R, share * step_s * spin)
                rate, velocity = state.rate + share * step_s * acceleration, state.velocity + share * step_s * linear
            acceleration, linear = self.accelerations(R, rate, tau)
            slopes.append((rate, acceleration, linear, velocity))
        spin, acceleration, linear, velocity = (
            (a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(*slopes, strict=True)
        )
        return BlockState(
            _turned(state.R, step_s * spin),
            state.rate + step_s * acceleration,
            state.position + step_s * velocity,
            state.velocity + step_s * linear,
        )


def _turned(R: FloatArray, angle: FloatArray) -> FloatArray:
    return np.stack([one @ pin.exp3(by) for one, by in zip(R, angle, strict=True)])


def _skews(places: FloatArray) -> FloatArray:
    return np.stack([pin.skew(place) for place in places])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """As ``np.cross`` of (n, 3) each, at a fifth of its overhead."""
    ax, ay, az, bx, by, bz = *a.T, *b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
