"""Recursive instrumental variables: a consistent estimate when the regressor is made of noisy signals.

Noise in Y biases ``Y' W Y``, and more rows do not reduce that bias. Instruments Z are rows that are correlated with the
true ones and independent of their noise; then

    Z' W y = Z' W Y chi + Z' W e,    chi = (Z' W Y + L)^-1 (Z' W y + L chi_0)

is consistent (L, chi_0: the prior). Here Z is computed from the motion predicted by the estimate so far (Gilbert et
al.; Janot, Vandanjon and Gautier, IEEE Trans. Control Systems Technology 22 (2014) 132).

Only sums per block of time are kept, so the recursion is exact under every :class:`Memory`, and the interval is a
delete-one-block jackknife as for least squares. Rows also go into a least squares, whose innovations feed the gates and
whose estimate is the baseline.

Known limits: sums of products have half the digits of a triangular factor; about ten parameters in units of their prior
do not need more. Along a direction without information the estimate is the prior's; with instruments uncorrelated with
the rows the estimate is meaningless and its interval very wide.
"""

import copy
import math

import numpy as np
from numpy.typing import ArrayLike

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import RowError, SingularError
from onboard.estimation.recursive.blocks import TimeBlocks
from onboard.estimation.recursive.consistency import JackknifeEstimate, half_of
from onboard.estimation.recursive.memory import FOR_EVER, Memory, RecursiveLeastSquares
from onboard.estimation.recursive.rls import SquareRootRls

_FEW_BLOCKS = 12  # below so many, the formal covariance is a lower bound


class InstrumentBlocks(TimeBlocks):
    """``Z' W Y``, ``Z' W [C y]`` and ``Z' W Z`` per block of time.

    Args:
        parameters: p.
        considered: k.
        block_s: first length of a block.
        capacity: blocks kept before neighbours are merged.
    """

    def __init__(self, parameters: int, considered: int, block_s: float, capacity: int = 64) -> None:
        super().__init__(block_s, capacity, (parameters, 2 * parameters + considered + 1))

    @property
    def cross(self) -> FloatArray:
        """``Z' W Y`` of each block, (b, p, p)."""
        p = self.sums[0].shape[1]
        return self.sums[0][: self.count, :, p : 2 * p]

    @property
    def moment(self) -> FloatArray:
        """``Z' W [C y]`` of each block, (b, p, k + 1)."""
        return self.sums[0][: self.count, :, 2 * self.sums[0].shape[1] :]

    @property
    def square(self) -> FloatArray:
        """``Z' W Z`` of each block, (b, p, p)."""
        return self.sums[0][: self.count, :, : self.sums[0].shape[1]]

    def add(self, times_s: FloatArray, rows: FloatArray) -> None:
        """Adds rows.

        Args:
            times_s: (m,).
            rows: ``[Z Y C y]``, each divided by its sigma, (m, 2 p + k + 1).

        Raises:
            RowError: a number that is not finite.
        """
        flat = rows.ravel()
        if not math.isfinite(np.vdot(flat, flat) + times_s.sum()):
            raise RowError("rows and instruments must be finite; gate them before they come here")
        p = self.sums[0].shape[1]
        for slot, mine in self.split(times_s):
            own = rows[mine]
            self.sums[0][slot] += own[:, :p].T @ own


class RecursiveInstrumental(RecursiveLeastSquares):
    """Instrumental variables under any :class:`Memory`; arguments as of :class:`RecursiveLeastSquares`."""

    def __init__(self, parameters: int, considered: int, block_s: float, memory: Memory = FOR_EVER) -> None:
        super().__init__(parameters, considered, block_s, memory)
        self.instruments = InstrumentBlocks(parameters, considered, block_s, self.blocks.sums[0].shape[0])
        self._settled = copy.deepcopy(self.instruments)

    def add_instruments(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        Z: FloatArray,
        C: FloatArray | None = None,
        settled: bool = True,
    ) -> None:
        """Adds rows, already given to the least squares by :meth:`add`, with their instruments.

        Args:
            times_s: (m,).
            Y: (m, p).
            y: (m,).
            sigma: (m,).
            Z: (m, p).
            C: (m, k) columns of the considered parameters, if any.
            settled: whether they are final; else :meth:`unsettle` removes them again.

        Raises:
            RowError: wrong shape, or a number that is not finite.
        """
        m, p = y.shape[0], self.rls.parameters
        if Z.shape != (m, p) or Y.shape != (m, p) or (C is None) != (self.rls.considered == 0):
            raise RowError(f"instruments of shape {Z.shape} for rows of {Y.shape}; give (m, {p}) of each, and C if any")
        if m == 0:
            return
        rows = np.empty((m, 2 * p + self.rls.considered + 1))
        rows[:, :p], rows[:, p : 2 * p], rows[:, -1] = Z, Y, y
        if C is not None:
            rows[:, 2 * p : -1] = C
        rows /= sigma[:, None]
        for store in self._stores if settled else (self.instruments,):
            store.add(times_s, rows)

    def unsettle(self, for_good: bool = False) -> None:
        """Removes the rows whose instruments were not final, before they are added with better ones.

        Args:
            for_good: all rows added later are final.
        """
        self.instruments = self._settled if for_good else copy.deepcopy(self._settled)

    def _fade(self, factor: float) -> None:
        super()._fade(factor)
        for store in self._stores:
            store.fade(factor)

    def _keep_from(self, newest_s: float, blocks: int) -> None:
        super()._keep_from(newest_s, blocks)
        for store in self._stores:
            store.keep_from(newest_s, blocks)

    @property
    def _stores(self) -> tuple[InstrumentBlocks, ...]:
        return (self.instruments,) if self.instruments is self._settled else (self.instruments, self._settled)

    @property
    def mean(self) -> FloatArray:
        """The estimate so far, (p,).

        Raises:
            SingularError: rows and prior do not determine it.
        """
        p, sums = self.rls.parameters, self.instruments.sums[0].sum(axis=0)  # empty slots are zero
        information, right = self.rls.prior_equations()
        return _solved(sums[:, p : 2 * p] + information, sums[:, -1] + right)

    def block_jackknife(self, considered_sigma: ArrayLike = ()) -> "InstrumentalEstimate":
        """The estimate with its block-jackknife covariance."""
        found = InstrumentalEstimate(self.rls, self.instruments, considered_sigma)
        found.floored |= self._without_noise
        return found


class InstrumentalEstimate(JackknifeEstimate):
    """An estimate by instruments, with the intervals of :class:`JackknifeEstimate`.

    Errors of successive angular-acceleration rows are negatively correlated, so the true covariance may be below the
    formal one: that is a lower bound only while there are few blocks.

    Args:
        rls: least squares, source of the prior.
        blocks: the rows and their instruments.
        considered_sigma: (k,), or a root (k, k).

    Raises:
        SingularError: rows and prior do not determine the estimate.
        RowError: wrong number of considered sigmas.
    """

    def __init__(self, rls: SquareRootRls, blocks: InstrumentBlocks, considered_sigma: ArrayLike = ()) -> None:
        sigma = self._checked(rls, considered_sigma)
        H, g, G = blocks.cross, blocks.moment, blocks.square
        information, right = rls.prior_equations()
        A, b = H.sum(axis=0) + information, g.sum(axis=0)
        inverse = np.asarray(_solved(A, np.eye(len(A))), np.float64)
        self.floored = blocks.count < _FEW_BLOCKS
        self.mean = inverse @ (b[:, -1] + right)
        self._root = inverse @ half_of(G.sum(axis=0) + information)
        causes = inverse @ b[:, :-1]
        causes = causes * sigma if sigma.ndim == 1 else causes @ sigma
        self._common = np.column_stack([causes, np.zeros(len(causes))])  # the noise of the regressor biases nothing
        self._prior_half = inverse @ half_of(information)
        scores = g[..., -1] - H @ self.mean  # (b, p)
        rest = A - H + np.eye(len(A)) * (1e-12 * np.abs(np.diag(A)))
        self._moves = np.linalg.solve(rest, scores[..., None])[..., 0]
        self._shares = inverse @ G @ inverse.T


def _solved(A: FloatArray, b: FloatArray) -> FloatArray:
    """``A^-1 b``, solved with A scaled to unit diagonal."""
    scale = np.sqrt(np.abs(np.diag(A)))
    if not (scale > 0.0).all():
        raise SingularError("neither rows nor prior determine every parameter; give a prior, or move more")
    try:
        solved = np.linalg.solve(A / np.outer(scale, scale), (b.T / scale).T)
    except np.linalg.LinAlgError as error:
        raise SingularError("the instruments do not determine the parameters; give a prior, or move more") from error
    return np.asarray((solved.T / scale).T, np.float64)
