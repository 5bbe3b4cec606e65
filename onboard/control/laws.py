"""Torques of one SYNC: a feed-forward that was learned or computed, and feedback of position and rate.

Positions are sampled at SYNC i of a trial, time ``i T``; the torque that answers them is in force from SYNC i + 1 to
i + 2, so that a feed-forward is taken at ``(i + 1.5) T``. The rate of the error is its difference over ``WINDOW``
SYNCs: of reference and position alike, so that a perfect follower has none.
"""

from typing import Final, NamedTuple, Protocol

import numpy as np

from onboard.control.drives import Drives
from onboard.control.motion import Motion
from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.estimation.arrays import FloatArray

WINDOW: Final = 1
AHEAD: Final = 1.5  # SYNC periods from a sample to the middle of the interval in which its torque is in force
BANDWIDTH_RAD_S, DAMPING = 30.0, 1.25  # of the loops, with nothing in the gripper
_FASTEST: Final = 100.0  # 1/s, of the rate loops all together: 46 deg of phase in the 8 ms from a sample to its torque
SLOW_RAD_S = 8.0  # while the drives' own inertia is guessed


class Gains(NamedTuple):
    """Of position and rate, (n,) each: N m / rad, N m s / rad."""

    position: FloatArray
    rate: FloatArray

    @staticmethod
    def of(inertia: FloatArray, bandwidth_rad_s: float = BANDWIDTH_RAD_S) -> "Gains":
        """Gains of joints that are controlled one by one, each for its inertia while the others are free.

        Joints that turn each other make a loop faster than each has by itself; the bandwidth is then less.

        Args:
            inertia: of the arm, (n, n) kg m^2.
            bandwidth_rad_s: at most.
        """
        own = free_inertia(inertia)
        fastest = np.abs(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(2.0 * DAMPING * own)))).max()
        w = min(bandwidth_rad_s, _FASTEST / float(fastest))
        return Gains(w**2 * own, 2.0 * DAMPING * w * own)


def free_inertia(inertia: FloatArray) -> FloatArray:
    """Inertia of each joint while nothing holds the others, (n,), of the arm's (n, n)."""
    return np.asarray(1.0 / np.diag(np.linalg.inv(inertia)), np.float64)


class Law(Protocol):
    """A control law over one trial."""

    def torque(self, step: int, error: FloatArray, error_rate: FloatArray) -> FloatArray:
        """Joint torques (n,) N m; errors (n,) are reference less measured, rad and rad/s, at SYNC ``step``."""


class SyncedMotion(NamedTuple):
    """A motion at the SYNCs of a trial, and at the times that their torques are in force; (m, n) each."""

    q: FloatArray
    q_acting: FloatArray
    dq_acting: FloatArray
    ddq_acting: FloatArray

    @staticmethod
    def of(motion: Motion, period_s: float) -> "SyncedMotion":
        """Of a whole trial."""
        time_s = period_s * np.arange(round(motion.seconds / period_s), dtype=np.float64)
        return SyncedMotion(motion.at(time_s)[0], *motion.at(time_s + AHEAD * period_s))


class FeedForward(NamedTuple):
    """Torques learned, (m, n), and feedback of each joint by itself (figures 2.15 to 2.17)."""

    torques: FloatArray
    gains: Gains

    def torque(self, step: int, error: FloatArray, error_rate: FloatArray) -> FloatArray:
        """See :class:`Law`."""
        u: FloatArray = self.torques[step] + self.gains.position * error + self.gains.rate * error_rate
        return u


class ComputedTorque(NamedTuple):
    """``tau = H*(q) (ddq_d + k_v de + k_p e) + c*(q, dq)`` and the drives' own (2.110, 2.112)."""

    space: JointSpace
    drives: Drives
    reference: SyncedMotion

    def torque(self, step: int, error: FloatArray, error_rate: FloatArray) -> FloatArray:
        """See :class:`Law`."""
        _, q, dq, ddq = (rows[step] for rows in self.reference)
        pull = 2.0 * DAMPING * BANDWIDTH_RAD_S * error_rate + BANDWIDTH_RAD_S**2 * error
        told = self.space.torque(q - error, dq - error_rate, ddq + pull)
        u: FloatArray = told + self.drives.torque(dq, ddq) + self.drives.rotor_kg_m2 * pull
        return u


def feed_forward(space: JointSpace, drives: Drives, reference: SyncedMotion) -> FloatArray:
    """Torques of a motion by a model, (m, n): inverse dynamics and drives, without feedback."""
    _, q, dq, ddq = reference
    rigid = np.array([space.torque(*row) for row in zip(q, dq, ddq, strict=True)])
    return np.asarray(rigid + drives.torque(dq, ddq), np.float64)
