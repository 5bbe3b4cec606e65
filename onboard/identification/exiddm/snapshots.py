"""States that a filter was in, to go back to one.

They are most of a checkpoint: covariances are kept as triangles, and of the older states every fourth.
"""

from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray

_EVERY = 8  # of the newest batches, from which nearly all changes are gone back; of those before one in _OF
_OF = 4


class _Kept(NamedTuple):
    number: int  # of the batch
    state: FloatArray  # (p,)
    triangle: FloatArray  # (p (p + 1) / 2,)


class Snapshots:
    """The newest states.

    Args:
        most: of the newest that can be gone back to, itself or one shortly before it.
    """

    def __init__(self, most: int) -> None:
        self._most, self._newest = most, -1
        self._kept: deque[_Kept] = deque()

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def append(self, state: FloatArray, covariance: FloatArray) -> None:
        """Keep a state, (p,), and its covariance, (p, p)."""
        self._newest += 1
        self._kept.append(_Kept(self._newest, state, covariance.ravel()[_upper(len(state))]))
        if len(self._kept) > _EVERY and self._kept[-1 - _EVERY].number % _OF:
            del self._kept[-1 - _EVERY]
        if len(self._kept) > 1 and self._newest - self._kept[1].number >= self._most - 1:
            self._kept.popleft()

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
