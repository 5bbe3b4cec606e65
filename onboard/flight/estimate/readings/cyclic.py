"""Cyclic errors of encoders behind gears, as functions of the joint's angle."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray


def cyclic_functions(angle_rad: FloatArray) -> FloatArray:
    """Cosine and sine of the angle of each cyclic error, (n, m), as alternating columns, (n, 2 m)."""
    both = np.empty((*angle_rad.shape, 2))
    both[..., 0], both[..., 1] = np.cos(angle_rad), np.sin(angle_rad)
    return both.reshape(len(angle_rad), -1)


class Cyclic(NamedTuple):
    """Cyclic errors of some channels, beside each other: m in all."""

    columns: NDArray[np.intp]  # (m,) of each error's angle
    periods: FloatArray  # (m,) per radian
    rms: FloatArray  # (m,)
    ends: list[int]  # of each channel's errors
    rounds: list[NDArray[np.intp]]  # numbers of errors, of different columns in each


@lru_cache(maxsize=64)
def cyclic_of(ripples: tuple[tuple[tuple[float, float], ...], ...], widths: tuple[int, ...]) -> Cyclic:
    """Those of channels with these errors, each channel so many columns wide."""
    first = np.cumsum([0, *widths])
    errors = [(column, *error) for column, ripple in zip(first.tolist(), ripples, strict=False) for error in ripple]
    columns, periods, rms = zip(*errors, strict=True) if errors else ((), (), ())
    ends = np.cumsum([len(ripple) for ripple in ripples]).tolist()
    before = [columns[:k].count(column) for k, column in enumerate(columns)]
    rounds = [np.flatnonzero(np.array(before) == k) for k in range(max(before, default=-1) + 1)]
    return Cyclic(np.array(columns, np.intp), np.array(periods), np.array(rms), ends, rounds)
