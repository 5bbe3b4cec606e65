"""States that a filter was in, to go back to one.

They are most of a checkpoint: covariances are kept as triangles, and of older states only some.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray

TIERS = ((8, 1), (28, 4), (80, 16))  # of the so many newest batches one in so many is kept


class _Kept(NamedTuple):
    number: int  # of the batch
    state: FloatArray  # (p,)
    triangle: FloatArray  # (p (p + 1) / 2,)


class Snapshots:
    """The newest states.

    Args:
        tiers: batches that can be gone back to, to itself or one shortly before it, and of how many one is kept.
    """

    def __init__(self, tiers: Sequence[tuple[int, int]] = TIERS) -> None:
        self._tiers, self._newest = tuple(tiers), -1
        self._kept: list[_Kept] = []

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def append(self, state: FloatArray, covariance: FloatArray) -> None:
        """Keep a state, (p,), and its covariance, (p, p)."""
        self._newest += 1
        self._kept.append(_Kept(self._newest, state, covariance.ravel()[_upper(len(state))]))
        oldest = [one for one in self._kept if self._newest - one.number >= self._tiers[-1][0] - 1][-1:]
        self._kept = oldest + [one for one in self._kept if self._stays(self._newest - one.number, one.number)]

    def _stays(self, age: int, number: int) -> bool:
        return age < self._tiers[-1][0] - 1 and any(age < most and number % every == 0 for most, every in self._tiers)

    def back(self, batches: int) -> tuple[FloatArray, FloatArray]:
        """State and covariance so many before the newest, or of the next older one; the oldest where there is none."""
        wanted = self._newest - batches
        _, state, triangle = next((one for one in reversed(self._kept) if one.number <= wanted), self._kept[0])
        p = len(state)
        upper = np.zeros((p, p))
        upper.flat[_upper(p)] = triangle
        return state, upper + np.triu(upper, 1).T


@lru_cache
def _upper(size: int) -> IndexArray:
    """Places of the upper triangle in a square matrix that is laid out by rows."""
    return np.flatnonzero(np.triu(np.ones((size, size), np.bool_)))
