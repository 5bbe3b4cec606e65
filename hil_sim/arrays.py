"""Names of the array types that signatures use, shapes in docstrings and at line ends; and what NumPy is slow at."""

import copy
import math
import mmap
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.linalg import _umath_linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

solved_unchecked: Final[Callable[[FloatArray, FloatArray], FloatArray]] = _umath_linalg.solve1  # singular: invalid
_LEAST: Final = 1 << 20  # bytes given back at a time


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products, (n, 3), of (n, 3) each; a third of the time that NumPy's take."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    out = np.empty_like(a)
    out[:, 0], out[:, 1], out[:, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """What ``np.linalg.solve`` returns for one right side, (n,), to the bit, in a third of its time for small ones.

    Raises:
        FloatingPointError: the matrix, (n, n), is singular.
    """
    with np.errstate(invalid="raise"):
        return solved_unchecked(matrix, right)


class Track:
    """Rows of a signal, filled from the first on; memory is taken as they are filled, and that of old ones given back.

    Args:
        shape: of the whole, rows first.

    Attributes:
        values: All rows; those not filled yet, or forgotten, are zeros.
    """

    def __init__(self, *shape: int) -> None:
        size = math.prod(shape)
        self._memory = mmap.mmap(-1, 8 * max(size, 1), flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self.values: FloatArray = np.frombuffer(self._memory, np.float64, size).reshape(shape)
        self._row_bytes = 8 * math.prod(shape[1:])
        self._forgotten = 0  # bytes

    def forget(self, before: int) -> None:
        """Give back the memory of the rows before ``before``, whole pages of it."""
        end = before * self._row_bytes // mmap.PAGESIZE * mmap.PAGESIZE
        if end - self._forgotten >= _LEAST:
            self._memory.madvise(mmap.MADV_DONTNEED, self._forgotten, end - self._forgotten)
            self._forgotten = end


class Deviates:
    """Standard normal deviates (rows, columns), drawn in blocks as they are needed: the numbers of one draw of all.

    Args:
        rng: Is left as after that draw.
        rows: Of the whole.
        columns: Of the whole.
    """

    def __init__(self, rng: np.random.Generator, rows: int, columns: int) -> None:
        self._rng, self._columns = copy.deepcopy(rng), columns
        block = max(1, _LEAST // (8 * columns))
        for first in range(0, rows, block):
            rng.standard_normal((min(block, rows - first), columns))

    def take(self, rows: int) -> FloatArray:
        """The next rows, (rows, columns)."""
        return self._rng.standard_normal((rows, self._columns))
