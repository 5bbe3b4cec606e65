"""Joint motions that start and end at rest in one posture: clamped quintic B-splines on even knots.

A spline lies in the convex hull of its coefficients (de Boor), so a bound on these bounds the angles. The first and
last three coefficients are the posture, with which rate and acceleration are zero at both ends.
"""

import numpy as np
from scipy.interpolate import BSpline

from onboard.estimation.arrays import FloatArray

_DEGREE = 5
_AT_REST = 3  # coefficients at each end


class Splines:
    """Motions of some joints from a posture and back to it.

    Args:
        posture: rad or m, (joints,).
        duration_s: of the motion.
        pieces: of the splines; two at least.

    Attributes:
        size: coefficients of a joint that are free.
    """

    def __init__(self, posture: FloatArray, duration_s: float, pieces: int) -> None:
        self.posture, self.duration_s, self.size = posture, duration_s, pieces - 1
        inner = np.linspace(0.0, duration_s, pieces + 1)
        self._knots = np.concatenate([np.full(_DEGREE, inner[0]), inner, np.full(_DEGREE, inner[-1])])

    def basis(self, time_s: FloatArray) -> FloatArray:
        """Of angle, rate and acceleration at times from 0 to the duration, (3, n, size)."""
        unit = np.zeros((self.size + 2 * _AT_REST, self.size))
        unit[_AT_REST:-_AT_REST] = np.eye(self.size)
        spline = BSpline(self._knots, unit, _DEGREE)
        return np.stack([spline(time_s, order) for order in range(3)])

    def move(self, basis: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Angle, rate and acceleration, (3, n, joints).

        Args:
            basis: at the times, by :meth:`basis`.
            coefficients: about the posture, (size, joints).
        """
        out = np.asarray(basis @ coefficients, np.float64)
        out[0] += self.posture
        return out
