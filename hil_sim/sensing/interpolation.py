"""Signals between the points of a plant's grid: a cubic through four of them, at one place or at many."""

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np

from hil_sim.arrays import FloatArray

Place = TypeVar("Place", float, FloatArray)


def interpolate(values: FloatArray, position: FloatArray) -> FloatArray:
    """Rows of ``values`` (n, c) at fractional rows ``position`` (m,): cubic through four points, clamped to the ends.

    Returns:
        Shape (m, c).
    """
    i = np.clip(np.floor(position), 1, len(values) - 3).astype(np.intp)
    u = np.clip(position - i, -1.0, 2.0)[:, None]
    before, here, after, beyond = _lagrange(u)
    rows: FloatArray = values[i - 1] * before + values[i] * here + values[i + 1] * after + values[i + 2] * beyond
    return rows


def interpolate_column(values: FloatArray, position: FloatArray) -> FloatArray:
    """``interpolate_one`` at each place, (m,): the same sums in the same order."""
    i = np.clip(np.floor(position), 1, len(values) - 3).astype(np.intp)
    w0, w1, w2, w3 = _lagrange(np.clip(position - i, -1.0, 2.0))
    column: FloatArray = w0 * values[i - 1] + w1 * values[i] + w2 * values[i + 1] + w3 * values[i + 2]
    return column


def interpolate_one(values: FloatArray, position: float) -> float:
    """``interpolate`` of one column (n,) at one place; ten times faster than through arrays of one element."""
    i, (w0, w1, w2, w3) = _place(position, len(values))
    v0, v1, v2, v3 = values[i - 1 : i + 3].tolist()
    one: float = w0 * v0 + w1 * v1 + w2 * v2 + w3 * v3
    return one


@lru_cache(maxsize=64)  # nodes that answer one SYNC measure at one time
def _place(position: float, rows: int) -> tuple[int, tuple[float, float, float, float]]:
    """The second of four rows, and their weights, at a place among so many."""
    i = min(max(math.floor(position), 1), rows - 3)
    return i, _lagrange(min(max(position - i, -1.0), 2.0))


def _lagrange(u: Place) -> tuple[Place, Place, Place, Place]:
    """Weights of the points at -1, 0, 1, 2 for a place ``u`` among them."""
    return (
        u * (u - 1.0) * (2.0 - u) / 6.0,
        (u * u - 1.0) * (u - 2.0) / 2.0,
        u * (u + 1.0) * (2.0 - u) / 2.0,
        u * (u * u - 1.0) / 6.0,
    )
