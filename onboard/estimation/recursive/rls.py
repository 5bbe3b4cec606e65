"""Recursive least squares in square-root information form (Bierman 1977; Golub and Van Loan), by LAPACK ``dtpqrt``.

The state is the triangular factor of all rows so far, ``[R R_c z]`` over ``[0 R_cc z_c]`` over ``[0 0 e]``: new rows
are appended below it and ``dtpqrt`` re-triangularises it in place. The same kernel serves the recursive update and the
batch solution of hours of rows in constant memory. Information is never formed or subtracted, so the covariance stays
positive definite over any number of updates.

Every row carries, beside its parameter columns:

- columns of *considered* parameters c: errors of known sigma, common to many rows and not estimated (scale of a load
  cell, a time offset). The solution includes the sensitivity of the estimate to them (Schmidt's consider covariance).
- the right-hand side, which leaves the residual sum in the last diagonal element.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from onboard.estimation.arrays import FloatArray, eigen
from onboard.estimation.errors import RowError, SingularError

_BLOCK = 16  # block size of dtpqrt
_RANK_TOLERANCE = 1e-11  # of a column of R against the column's norm


class Solution(NamedTuple):
    """Estimate from the rows so far, under their stated sigmas."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p) if rows are independent; else onboard.estimation.recursive.consistency has it
    sensitivity: FloatArray  # (p, k) change of the mean per unit of each considered parameter
    residual_sum: float  # of (residual / sigma)^2, prior rows included: chi-squared, rows - p + prior rows
    rows: float  # number of rows


class Observability(NamedTuple):
    """Information of the data relative to the prior."""

    shrinkage: FloatArray  # (p,) posterior sigma over prior sigma of each parameter; 1 without information
    gain: FloatArray  # (p,) information of the data along each direction, in units of the prior's; ascending
    directions: FloatArray  # (p, p) columns, in units of the parameters, one prior sigma long


class RlsState(NamedTuple):
    """Complete state of the estimator, for a checkpoint."""

    triangle: FloatArray
    prior_rows: FloatArray
    rows: float


def merged(triangle: FloatArray, rows: FloatArray) -> FloatArray:
    """Triangular factor of a triangle and further rows, (s, s); both arguments are overwritten.

    Args:
        triangle: upper triangular, (s, s), in Fortran's order.
        rows: (m, s), in Fortran's order.
    """
    size = triangle.shape[0]
    made, _, _, info = lapack.dtpqrt(0, min(_BLOCK, size), triangle, rows, overwrite_a=1, overwrite_b=1)
    if info != 0:
        raise AssertionError(f"dtpqrt refused argument {-info}")
    return np.asarray(made, np.float64)


class SquareRootRls:
    """Square-root recursive least squares of ``y = Y chi + C c + noise``.

    Args:
        parameters: p.
        considered: k, parameters not estimated, whose sigma enters the covariance.

    Raises:
        RowError: dimension out of range.
    """

    def __init__(self, parameters: int, considered: int = 0) -> None:
        if parameters < 1 or considered < 0:
            raise RowError(f"{parameters} parameters and {considered} considered; at least 1 and 0")
        self.parameters = parameters
        self.considered = considered
        self.rows = 0.0
        self._size = parameters + considered + 1
        self._triangle = np.zeros((self._size, self._size), order="F")
        self._prior_rows = np.zeros((0, self._size))
        self._sound: FloatArray | None = None
        self._prior_normal: tuple[FloatArray, FloatArray] | None = None

    def prior(self, mean: ArrayLike, sigma: ArrayLike, sensitivity: ArrayLike | None = None) -> None:
        """Adds the prior.

        Args:
            mean: (p,).
            sigma: (p,) standard deviations, ``inf`` where nothing is known, or a (p, p) positive definite covariance.
            sensitivity: (p, k) change of ``mean`` per unit of each considered parameter, if it was estimated from rows
                with the same ones; their part is not included in ``sigma``.

        Raises:
            RowError: wrong shapes, mean not finite, sigma not positive, covariance not positive definite.
        """
        p = self.parameters
        center = np.asarray(mean, np.float64)
        spread = np.asarray(sigma, np.float64)
        if center.shape != (p,) or not np.isfinite(center).all():
            raise RowError(f"the prior mean must be {p} finite numbers")
        if spread.shape == (p,):
            if not (spread > 0.0).all():
                raise RowError("prior sigmas must be positive; use inf where nothing is known")
            root = np.diag(1.0 / spread)[np.isfinite(spread)]
        elif spread.shape == (p, p):
            scale = np.sqrt(np.abs(np.diag(spread)))
            if not np.isfinite(spread).all() or not (scale > 0.0).all():
                raise RowError("the prior covariance must be finite with a positive diagonal")
            factor, info = lapack.dpotrf(spread / np.outer(scale, scale), lower=1, clean=1)
            if info != 0:
                raise RowError("the prior covariance is not positive definite; give every parameter some variance")
            inverse, _ = lapack.dtrtri(factor, lower=1)
            root = inverse / scale
        else:
            raise RowError(f"the prior sigma must have shape ({p},) or ({p}, {p}), not {spread.shape}")
        rows = np.zeros((root.shape[0], self._size))
        rows[:, :p] = root
        if sensitivity is not None:
            rows[:, p:-1] = root @ np.asarray(sensitivity, np.float64)
        rows[:, -1] = root @ center
        self._prior_rows, self._prior_normal = np.vstack([self._prior_rows, rows]), None
        self._absorb(np.asfortranarray(rows))

    def update(
        self,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray | None = None,
    ) -> None:
        """Adds a batch of rows.

        Args:
            Y: (m, p).
            y: (m,).
            sigma: (m,) standard deviation of each row.
            C: (m, k) columns of the considered parameters, ``d y / d c``; required when there are any.

        Raises:
            RowError: wrong shape, number not finite, sigma not positive. The estimator is unchanged then.
        """
        rows = self._weighted(Y, y, sigma, C)
        if rows is None:
            return
        self._absorb(rows)
        self.rows += y.shape[0]

    def consider(self, right: FloatArray) -> None:
        """Replace what prior and rows so far have of the considered parameters.

        Args:
            right: (p, k) sum of ``Y' C / sigma^2`` over them.
        """
        found, _ = lapack.dtrtrs(self._check_rank(), right, trans=1)
        self._triangle[: self.parameters, self.parameters : -1] = found

    def with_prior(self, mean: FloatArray, covariance: FloatArray) -> "SquareRootRls":
        """Another one of the same rows with another prior, (p,) and (p, p), in place of this one's.

        Raises:
            RowError: see :meth:`prior`.
        """
        p, made = self.parameters, SquareRootRls(self.parameters, self.considered)
        made.prior(mean, covariance)
        R = self._check_rank()
        (before, right), (known, other) = self.prior_equations(), made.prior_equations()
        half, _ = lapack.dtrtrs(R, before, trans=1)
        share, _ = lapack.dtrtrs(R, half.T, trans=1)  # of the prior in all information, where that is the identity
        values, V = eigen(0.5 * (share + share.T))
        rows = np.sqrt(np.clip(1.0 - values, 0.0, 1.0))[:, None] * (V.T @ R)
        square = np.zeros((self._size, self._size))
        square[:p, :p] = rows.T @ rows + known
        square[:p, p:] = R.T @ self._triangle[:p, p:]
        square[:p, -1] += other - right
        scale = 1.0 / np.sqrt(np.diag(square)[:p])
        root = np.linalg.cholesky(square[:p, :p] * np.outer(scale, scale)).T / scale
        solved, _ = lapack.dtrtrs(np.asfortranarray(root), square[:p, p:], trans=1)
        made._triangle[:p, :p], made._triangle[:p, p:] = root, solved
        of_priors = (
            made._prior_rows[:, -1] @ made._prior_rows[:, -1] - self._prior_rows[:, -1] @ self._prior_rows[:, -1]
        )
        left = self._triangle[:, -1] @ self._triangle[:, -1] + of_priors - solved[:, -1] @ solved[:, -1]
        made._triangle[-1, -1], made.rows = np.sqrt(max(left, 0.0)), self.rows
        return made

    def tried(self, Y: FloatArray, y: FloatArray, sigma: FloatArray) -> "SquareRootRls":
        """Another one with these rows taken in, (m, p), (m,), (m,); considered parameters do not move them."""
        other = SquareRootRls(self.parameters, self.considered)
        other.restore(self.state())
        other.update(Y, y, sigma, np.zeros((len(y), self.considered)))
        return other

    def _weighted(self, Y: FloatArray, y: FloatArray, sigma: FloatArray, C: FloatArray | None) -> FloatArray | None:
        """Checked rows ``[Y C y] / sigma``, in Fortran's order; None for no rows."""
        m, p = y.shape[0], self.parameters
        if Y.shape != (m, p) or sigma.shape != (m,) or (C is None) != (self.considered == 0):
            raise RowError(f"rows of shape {Y.shape}, {y.shape}, {sigma.shape}; give (m, {p}), (m,), (m,) and C if any")
        if m == 0:
            return None
        if not sigma.min() > 0.0:
            raise RowError("the sigma of every row must be positive")
        rows = np.empty((m, self._size), order="F")
        rows[:, :p] = Y
        if C is not None:
            rows[:, p:-1] = C
        rows[:, -1] = y
        rows /= sigma[:, None]
        flat = rows.ravel(order="K")
        if not math.isfinite(np.vdot(flat, flat)):  # any NaN or infinity propagates into the sum of squares
            raise RowError("rows must be finite; gate them before they come here")
        return rows

    def _absorb(self, rows: FloatArray) -> None:
        self._triangle, self._sound = merged(self._triangle, rows), None

    def _check_rank(self) -> FloatArray:
        """R, (p, p), in Fortran order, after a rank check; cached until rows are added."""
        if self._sound is not None:
            return self._sound
        R = np.asfortranarray(self._triangle[: self.parameters, : self.parameters])
        diagonal = R.diagonal()
        weak = ~(diagonal * diagonal > _RANK_TOLERANCE**2 * np.einsum("ij,ij->j", R, R))
        if weak.any():
            columns = ", ".join(str(i) for i in np.flatnonzero(weak))
            raise SingularError(
                f"the rows so far do not determine parameter {columns} apart from those before it; "
                "give a prior, reduce to base parameters, or move more"
            )
        self._sound = R
        return R

    def solve(self) -> Solution:
        """The estimate and its formal covariance.

        Raises:
            SingularError: a parameter determined by neither rows nor prior; the message names it.
        """
        p = self.parameters
        R = self._check_rank()
        solved, _ = lapack.dtrtrs(R, self._triangle[:p, p:])
        half, _ = lapack.dpotri(R)  # upper triangle; the lower one stays zero, as it is in R
        covariance = half + half.T
        covariance.flat[:: p + 1] *= 0.5
        tail = self._triangle[p:, -1]
        return Solution(solved[:, -1].copy(), covariance, solved[:, :-1].copy(), float(tail @ tail), self.rows)

    def innovation(self, Y: FloatArray, y: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Innovations of rows not yet taken in, and their standard deviations ``sqrt(sigma^2 + Y P Y')``.

        Args:
            Y: (m, p).
            y: (m,).
            sigma: (m,).

        Returns:
            ``(innovation, innovation_sigma)``, (m,) each.

        Raises:
            SingularError: as :meth:`solve`.
        """
        p = self.parameters
        R = self._check_rank()
        root, _ = lapack.dtrtrs(R, Y.T, trans=1)  # (p, m): R^-T Y'
        predicted = self._triangle[:p, -1] @ root
        return y - predicted, np.sqrt(sigma**2 + np.einsum("pm,pm->m", root, root))

    @property
    def information_root(self) -> FloatArray:
        """A copy of R, upper triangular, (p, p): ``R' R`` is the information of prior and rows."""
        return self._triangle[: self.parameters, : self.parameters].copy()

    @property
    def prior_root(self) -> FloatArray:
        """Rows of the prior alone, (r, p): ``root' root`` is its information."""
        return self._prior_rows[:, : self.parameters]

    def prior_equations(self) -> tuple[FloatArray, FloatArray]:
        """The normal equations of the prior alone: information (p, p) and right-hand side (p,)."""
        if self._prior_normal is None:
            rows = self.prior_root
            self._prior_normal = rows.T @ rows, rows.T @ self._prior_rows[:, -1]
        information, right = self._prior_normal
        return information.copy(), right.copy()

    def observability(self) -> Observability:
        """Information added to the prior by the rows, per parameter and per direction.

        Raises:
            SingularError: the prior is not of full rank.
        """
        p = self.parameters
        factor, info = lapack.dpotrf(self.prior_equations()[0], lower=1, clean=1)  # L L' = prior information
        if info != 0:
            raise SingularError("observability is relative to the prior; give every parameter a finite prior sigma")
        root = np.linalg.inv(factor).T  # prior covariance = root root'
        _, singular, vt = np.linalg.svd(self._triangle[:p, :p] @ root)
        directions = root @ vt.T
        prior_variance = np.einsum("ij,ij->i", root, root)
        posterior_variance = np.einsum("ij,ij->i", directions / singular, directions / singular)
        order = np.argsort(singular)
        return Observability(
            np.sqrt(posterior_variance / prior_variance),
            np.maximum(singular[order] ** 2 - 1.0, 0.0),
            directions[:, order],
        )

    def state(self) -> RlsState:
        """A copy of the whole state, to be given to :meth:`restore`."""
        return RlsState(self._triangle.copy(order="F"), self._prior_rows.copy(), self.rows)

    def restore(self, state: RlsState) -> None:
        """Restores a checkpoint.

        Raises:
            RowError: state of other dimensions, or not finite.
        """
        size = (self._size, self._size)
        if state.triangle.shape != size or state.prior_rows.shape[1:] != (self._size,):
            raise RowError(f"the checkpoint has shape {state.triangle.shape}, this estimator {size}")
        if not (np.isfinite(state.triangle).all() and np.isfinite(state.prior_rows).all()):
            raise RowError("the checkpoint is not finite; start from the prior")
        self._triangle, self._sound = state.triangle.copy(order="F"), None
        self._prior_rows, self._prior_normal = state.prior_rows.copy(), None
        self.rows = state.rows
