"""Type aliases of arrays; shapes are given in docstrings and at line ends."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
ComplexArray = NDArray[np.complex128]
