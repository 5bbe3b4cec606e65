"""Information of rows whose regressor has noise.

Rows ``r = J z`` are seen as ``J + dJ`` and ``r + dr``, with noise of the motion that is in both. Taken off the normal
equations, what it adds leaves the estimating equation ``A z = b`` without bias (Fuller, Measurement Error Models, 1987,
section 2.2):

    A = sum (J'WJ - E[dJ'W dJ]),    b = sum (J'Wr - E[dJ'W dr]).

But b scatters by what was taken off, too: its covariance S is that of ``J'Wr`` with the noise, and of ``dJ'W dr`` from
row to row; and how much noise there is is known to :data:`.NOISE_SIGMA` alone, so that this part of
``d = sum E[dJ'W dr]`` is in doubt. The information is that of an estimating equation (Godambe, 1960), ``A S^-1 A``, the
right-hand side ``A S^-1 b``. With A for information errors are found that only make more or less of the noise: scales
and delays of encoders.
"""

import numpy as np

from onboard.estimation.arrays import ROUNDING, SINGULAR, FloatArray, eigen
from onboard.estimation.recursive.consistency import NOISE_SIGMA


def told(A: FloatArray, scatter: FloatArray, d: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information ``A S^-1 A``, (s, s), and what b is multiplied by, ``A S^-1``; none in directions that are noise.

    Args:
        A: without the noise, (s, s).
        scatter: covariance of the right-hand side by rows, (s, s).
        d: taken off the right-hand side about an estimate, (s,).
        size: of which rounding is a share, (s,): roots of the diagonal of A, or of what it is a difference of.
    """
    size = np.where(size > 0.0, size, 1.0)  # of some errors nothing is told, of others next to nothing
    values, V = eigen(A / np.outer(size, size))
    V, values = V[:, values > 0.0] / size[:, None], values[values > 0.0]
    squares, U = eigen(V.T @ (scatter + NOISE_SIGMA**2 * np.outer(d, d)) @ V)
    U = U / np.sqrt(np.maximum(squares, squares.max(initial=ROUNDING) / SINGULAR))
    root = (V * size[:, None] ** 2 * values) @ U
    return np.asarray(root @ root.T, np.float64), np.asarray(root @ (V @ U).T, np.float64)
