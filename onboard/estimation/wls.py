"""Ordinary and weighted least squares of a batch, with each sensor's noise estimated from its residual.

Rows of one joint (or one cell) share an unknown standard deviation. It is estimated from the residual of the ordinary
solution, and the weighted solution divides by it (Limparis 2.133-2.140). The rows go through the recursive kernel, so a
batch of any length needs the memory of one chunk.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import RowError
from onboard.estimation.rls import SquareRootRls


class Group(NamedTuple):
    """Rows of one sensor."""

    Y: FloatArray  # (m, p)
    y: FloatArray  # (m,)


class LeastSquares(NamedTuple):
    """Solution of a batch."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p) rows taken as independent
    sigma: FloatArray  # (groups,) of a row, as used
    residual: FloatArray  # (groups,) root mean square of the residual

    @property
    def relative_percent(self) -> FloatArray:
        """Relative standard deviations in per cent, (p,) (Limparis 2.140)."""
        return np.asarray(100.0 * np.sqrt(np.diag(self.covariance)) / np.abs(self.mean), np.float64)


def least_squares(groups: Iterable[Group], weighted: bool, chunk: int = 1000) -> LeastSquares:
    """Solves ``y = Y beta`` for all groups together.

    Args:
        groups: by sensor.
        weighted: each group with the rms residual of its ordinary solution; else all with the common one.
        chunk: rows added at once.

    Raises:
        RowError: wrong shapes, or no more rows than parameters.
        SingularError: the rows do not determine all parameters.
    """
    parts = [Group(np.asarray(Y, np.float64), np.asarray(y, np.float64)) for Y, y in groups]
    rows, p = sum(part.y.size for part in parts), parts[0].Y.shape[1]
    if rows <= p:
        raise RowError(f"{rows} rows for {p} parameters; give more rows")
    mean, _ = _solve(parts, np.ones(len(parts)), chunk)
    residual = _residual(parts, mean)
    counts = np.array([part.y.size for part in parts])
    common = np.sqrt((residual**2 * counts).sum() / (rows - p))
    sigma = residual * np.sqrt(rows / (rows - p)) if weighted else np.full(len(parts), common)
    mean, covariance = _solve(parts, sigma, chunk)
    return LeastSquares(mean, covariance, sigma, _residual(parts, mean))


def _solve(parts: list[Group], sigma: FloatArray, chunk: int) -> tuple[FloatArray, FloatArray]:
    rls = SquareRootRls(parts[0].Y.shape[1])
    for part, spread in zip(parts, sigma, strict=True):
        for first in range(0, part.y.size, chunk):
            some = slice(first, first + chunk)
            rls.update(part.Y[some], part.y[some], np.full(part.y[some].size, spread))
    solution = rls.solve()
    return solution.mean, solution.covariance


def _residual(parts: list[Group], mean: FloatArray) -> FloatArray:
    return np.array([np.sqrt(np.mean((part.Y @ mean - part.y) ** 2)) for part in parts])
