"""What a joint's drive adds to the arm, ``tau = Ia ddq + Fv dq + Fc sign(dq)`` (2.112), identified from a trial.

The trial is flown with nothing in the gripper, before the capture: the arm's parameters are the drawing's, so that
what torque is left over is the drives'. Both sides of the equation go through the same low-pass filter.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.estimation.arrays import FloatArray

_MOVING_RAD_S = 0.02  # below it the sign of the rate is not known
_LOW_PASS_HZ = 8.0
_ROUNDING_RAD_S = 0.02  # of the sign, in what is fed forward
_FEWEST = 50


class Drives(NamedTuple):
    """Rotor inertia (behind the gear), viscous and Coulomb friction of each joint, (n,) each."""

    rotor_kg_m2: FloatArray
    viscous_n_m_s: FloatArray
    coulomb_n_m: FloatArray

    def torque(self, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """What they take, N m, at joint rates and accelerations (..., n)."""
        sign = np.tanh(dq / _ROUNDING_RAD_S)
        return np.asarray(self.rotor_kg_m2 * ddq + self.viscous_n_m_s * dq + self.coulomb_n_m * sign, np.float64)


def smoothed(values: FloatArray, period_s: float, low_pass_hz: float = _LOW_PASS_HZ) -> FloatArray:
    """Signals on an even grid, (m, n), without what is faster than a frequency; no phase is lost."""
    sos = butter(2, min(2.0 * low_pass_hz * period_s, 0.9), output="sos")
    return np.asarray(sosfiltfilt(sos, values, axis=0), np.float64)


def identified(space: JointSpace, q: FloatArray, torque: FloatArray, period_s: float) -> Drives:
    """Drives from one trial, by least squares without negative numbers.

    Args:
        space: the arm with nothing in the gripper.
        q: measured positions on an even grid, (m, n).
        torque: sent, in force at the same times, (m, n).
        period_s: of the grid.

    Raises:
        ValueError: a joint that hardly moved.
    """
    dq, ddq = np.gradient(q, period_s, axis=0), np.gradient(np.gradient(q, period_s, axis=0), period_s, axis=0)
    q, dq, ddq, torque = (smoothed(x, period_s) for x in (q, dq, ddq, torque))
    left = torque - np.array([space.torque(*row) for row in zip(q, dq, ddq, strict=True)])
    found = np.zeros((3, q.shape[1]))
    for joint in range(q.shape[1]):
        rows = np.abs(dq[:, joint]) > _MOVING_RAD_S
        if rows.sum() < _FEWEST:
            raise ValueError(f"joint {joint + 1} hardly moved: its drive's friction stays unknown; give it more room")
        columns = np.stack([ddq[rows, joint], dq[rows, joint], np.sign(dq[rows, joint])], 1)
        found[:, joint] = nnls(columns, left[rows, joint])[0]
    return Drives(*found)
