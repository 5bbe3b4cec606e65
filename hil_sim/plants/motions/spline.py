"""Cubic splines through rows of numbers, as ``scipy.interpolate.CubicSpline``, whose import takes 0.2 s of every start.

The slopes at the knots make the second derivative continuous (de Boor, A Practical Guide to Splines, chapter IV): a
tridiagonal system, closed by slopes of zero at both ends (clamped) or by a third derivative that does not jump at the
knots next to the ends (not a knot).
"""

import numpy as np
from scipy.linalg import solve_banded

from hil_sim.arrays import FloatArray

_ROWS = 256  # evaluated at once: what they take stays in a processor's cache


class CubicSpline:
    """A curve through knots, twice continuously differentiable.

    Args:
        x: of the knots, (n,), rising.
        values: at them, (n, ...).
        clamped: whether the slope at both ends is zero; by default the curve is one cubic over the first three knots,
            and over the last three.
    """

    def __init__(self, x: FloatArray, values: FloatArray, *, clamped: bool = False) -> None:
        self.x = np.asarray(x, np.float64)
        y = np.asarray(values, np.float64)
        n, steps = len(self.x), np.diff(self.x)
        dx = steps.reshape(-1, *[1] * (y.ndim - 1))
        slope = np.diff(y, axis=0) / dx
        if n == 2 and not clamped:  # a straight line
            self._of_powers = np.stack([y[:-1], slope, np.zeros_like(slope), np.zeros_like(slope)])
            return
        if n == 3 and not clamped:  # a parabola: its slopes at the knots
            bend = (slope[1] - slope[0]) / (self.x[2] - self.x[0])
            s = np.stack([slope[0] - bend * dx[0], slope[0] + bend * dx[0], slope[1] + bend * dx[1]])
        else:
            A, b = np.zeros((3, n)), np.empty_like(y)  # upper, middle and lower diagonal
            A[1, 1:-1] = 2.0 * (steps[:-1] + steps[1:])
            A[0, 2:], A[2, :-2] = steps[:-1], steps[1:]
            b[1:-1] = 3.0 * (dx[1:] * slope[:-1] + dx[:-1] * slope[1:])
            if clamped:
                A[1, 0] = A[1, -1] = 1.0
                b[0] = b[-1] = 0.0
            else:
                first, last = self.x[2] - self.x[0], self.x[-1] - self.x[-3]
                A[1, 0], A[0, 1], A[1, -1], A[2, -2] = steps[1], first, steps[-2], last
                b[0] = ((dx[0] + 2.0 * first) * dx[1] * slope[0] + dx[0] ** 2 * slope[1]) / first
                b[-1] = (dx[-1] ** 2 * slope[-2] + (2.0 * last + dx[-1]) * dx[-2] * slope[-1]) / last
            s = solve_banded((1, 1), A, b.reshape(n, -1), check_finite=False).reshape(b.shape)
        t = (s[:-1] + s[1:] - 2.0 * slope) / dx
        self._of_powers = np.stack([y[:-1], s[:-1], (slope - s[:-1]) / dx - t, t / dx])  # (4, n - 1, ...)

    def __call__(self, x: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Value, or its first or second derivative, at x (...): (..., k); the end cubics go on beyond the ends."""
        at = np.asarray(x, np.float64)
        times, shape = at.reshape(-1), self._of_powers.shape[2:]
        out = np.empty((len(times), *shape))
        for first in range(0, len(times), _ROWS):
            rows = slice(first, first + _ROWS)
            part = np.clip(np.searchsorted(self.x, times[rows], side="right") - 1, 0, len(self.x) - 2)
            z = (times[rows] - self.x[part]).reshape(-1, *[1] * len(shape))
            made, factor = self._of_powers[derivative].take(part, axis=0), z
            if derivative:
                made *= derivative  # factorials of the first and of the second
            for power in range(derivative + 1, 4):
                term = self._of_powers[power].take(part, axis=0)
                term *= factor
                for k in range(derivative):
                    term *= power - k
                made += term
                factor = factor * z
            out[rows] = made
        return out.reshape((*at.shape, *shape))
