"""Rotation vectors as matrices, without the overhead of general libraries."""

import math

import numpy as np

from onboard.estimation.arrays import FloatArray, hat


def turn(v: FloatArray) -> FloatArray:
    """The matrix of a rotation vector, (3, 3) (Rodrigues)."""
    angle, K = math.hypot(*v.tolist()), hat(v)
    if not angle:
        return np.eye(3)
    out = math.sin(angle) / angle * K + 2.0 * (math.sin(0.5 * angle) / angle) ** 2 * (K @ K)
    out.flat[::4] += 1.0
    return out


def rotation_vector(M: FloatArray) -> FloatArray:
    """The inverse of :func:`turn`, (3,), by the quaternion's largest element (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = M.tolist()
    squares = 1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i  # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    w, *xyz = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )[squares.index(max(squares))]
    length = math.hypot(*xyz)
    times = math.copysign(2.0 * math.atan2(length, abs(w)) / length, w) if length else 0.0
    return times * np.array(xyz)
