"""States that a filter was in, to go back to one: covariances are kept as triangles, which halves a checkpoint."""

from collections import deque
from functools import lru_cache

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray


class Snapshots:
    """The newest states.

    Args:
        most: kept.
    """

    def __init__(self, most: int) -> None:
        self._kept: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=most)

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def append(self, state: FloatArray, covariance: FloatArray) -> None:
        """Keep a state, (p,), and its covariance, (p, p)."""
        self._kept.append((state, covariance.ravel()[_upper(len(state))]))

    def back(self, batches: int) -> tuple[FloatArray, FloatArray]:
        """State and covariance so many before the newest; the oldest one kept where that is not."""
        state, triangle = self._kept[max(0, len(self._kept) - 1 - batches)]
        p = len(state)
        upper = np.zeros((p, p))
        upper.flat[_upper(p)] = triangle
        return state, upper + np.triu(upper, 1).T


@lru_cache
def _upper(size: int) -> IndexArray:
    """Places of the upper triangle in a square matrix that is laid out by rows."""
    return np.flatnonzero(np.triu(np.ones((size, size), np.bool_)))
