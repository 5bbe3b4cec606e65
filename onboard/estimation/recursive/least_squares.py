"""Recursive least squares: a square-root recursion, and its rows by blocks of time, of which intervals are made."""

import numpy as np

from onboard.estimation.arrays import FloatArray, eigen
from onboard.estimation.recursive.consistency import BlockScores, corrected_mean, innovation
from onboard.estimation.recursive.rls import SquareRootRls


class RecursiveLeastSquares:
    """Least squares, its rows kept for block-jackknife intervals.

    Args:
        parameters: p.
        considered: k, as for :class:`SquareRootRls`.
        block_s: first length of the jackknife blocks.

    Attributes:
        rls: the recursion.
        blocks: the same rows per block of time.

    Raises:
        RowError: see :class:`SquareRootRls` and :class:`BlockScores`.
    """

    def __init__(self, parameters: int, considered: int, block_s: float) -> None:
        self.rls = SquareRootRls(parameters, considered)
        self.blocks = BlockScores(parameters, block_s)

    def add(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray | None = None,
        noise: FloatArray | None = None,
    ) -> None:
        """Adds rows.

        Args:
            times_s: (m,) time of each row.
            Y: (m, p).
            y: (m,).
            sigma: (m,).
            C: (m, k) columns of the considered parameters, if any.
            noise: (m, s, p), see :meth:`BlockScores.add`.

        Raises:
            RowError: see :meth:`SquareRootRls.update` and :meth:`BlockScores.add`.
        """
        if y.shape[0] == 0:
            return
        self.rls.update(Y, y, sigma, C)
        self.blocks.add(times_s, Y, y, sigma, noise)

    def expect_noise(self) -> None:
        """Of rows that were made without noise: takes in what that of the regressor adds on average.

        No residual scatters then: intervals are formal ones.
        """
        values, vectors = eigen(self.blocks.noise)
        told = values > values[-1] * np.finfo(np.float64).eps
        rows = (vectors * np.sqrt(np.maximum(values, 0.0))).T[told]  # rows' rows: the noise
        shared = (vectors.T @ self.blocks.noise_moment)[told] / np.sqrt(values[told])
        none = np.zeros((len(rows), self.rls.considered)) if self.rls.considered else None
        self.rls.update(rows, shared, np.ones(len(rows)), none)
        self.blocks.expect_noise()

    def innovation(self, Y: FloatArray, y: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`SquareRootRls.innovation`, against :meth:`least_squares`."""
        return innovation(self.rls, self.blocks, Y, y, sigma)

    def least_squares(self) -> FloatArray:
        """Least squares estimate corrected for known regressor noise, (p,): the mean that intervals are about."""
        return corrected_mean(self.rls, self.blocks)
