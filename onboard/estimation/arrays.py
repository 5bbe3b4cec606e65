"""Type aliases of arrays; shapes are given in docstrings and at line ends."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
ComplexArray = NDArray[np.complex128]


def finite(parts: Sequence[FloatArray]) -> BoolArray:
    """Where all columns of ``parts``, (n, columns) each, are finite, (n,)."""
    return np.asarray(np.isfinite(np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)).all(axis=1))
