"""Equations of all errors of what is stated, by the sums over rows; noise is taken out of the regressor.

The state x has the errors of the prior, ``beta = beta_0 + G L z``, and errors c of instruments, each over its stated
sigma. A row reads ``y = exp(g) Y_b beta_b + Y_i beta_i + C c``: g is the sum of the errors of gain that the file states
of its instrument, and multiplies the base parameters of bodies, not those of instruments. (A column of readings would
be of their noise, and shrink the gain.) What a joint's friction changes by between recordings multiplies it in rows
with the payload. Rows are linear about an estimate; columns C are those that the recursion considers. Of an error
without a column, nothing is found.

Each instrument's noise is what the estimate leaves over of its rows, no less than their weights say. What is left is
alike for seconds where the model is not the arm's: all information is divided by how much more the scores of blocks
scatter than it says (*colour*).
"""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray, eigen
from onboard.identification.evidence.mixture import Known
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.regressor_noise import told

_MOST = 0.25 * float(np.log(np.finfo(np.float64).max))  # logarithm of a gain whose square has a square


class _Part(NamedTuple):
    """Rows of one instrument, with the payload or without; sums of ``[Y, C, y, 1]``."""

    held: bool
    instrument: int
    times_s: FloatArray  # when each block begins, (b,)
    blocks: FloatArray  # (b, p + k + 2, p + k + 2) without the noise of the regressor
    sums: FloatArray  # (p + k + 2, p + k + 2) of all blocks
    noise: FloatArray  # (p + k + 2, p + k + 2) that noise
    own: float  # sum of squares of the readings' own sigmas


class RowErrors(NamedTuple):
    """Those of which there are equations.

    Args:
        half: ``G L``, (p, n), of the prior.
        centre: base parameters as drawn, (p,).
        sigma: of each error of an instrument, (e,).
        columns: its place among the errors that the recursion considers; -1 of one that has no column there, (e,).
        gains: which of them multiply what each instrument should read, (e, instruments).
        multiplied: which base parameters each of these multiplies, (e, p), or all of them, (p,).
        held: which gains are of rows with the payload alone.
    """

    half: FloatArray
    centre: FloatArray
    sigma: FloatArray
    columns: Sequence[int]
    gains: BoolArray
    multiplied: BoolArray
    held: Sequence[int] = ()

    @property
    def common(self) -> IndexArray:
        """Those that multiply all rows."""
        return np.setdiff1d(np.flatnonzero(self.gains.all(axis=1)), self.held)


class Information(NamedTuple):
    """What rows tell of errors of zero mean, in stated sigmas, about an estimate."""

    A: FloatArray  # (s, s)
    r: FloatArray  # right-hand side, (s,)
    scores: FloatArray  # of each block, (b, s)

    def colour(self, width: FloatArray | float = 1.0) -> float:
        """How much more the scores of blocks scatter than the information says, as a variance.

        Args:
            width: of each error, (s,), in stated sigmas.
        """
        w = np.broadcast_to(width, self.r.shape)
        wide = self.A * np.outer(w, w)
        C = np.linalg.inv(np.eye(len(wide)) + wide)
        known = float(np.vdot(C, wide))
        return max(1.0, float(np.vdot(self.scores * w @ C, self.scores * w)) / known) if known > 0.0 else 1.0

    def known(self, colour: float = 1.0) -> Known:
        """Mean and covariance of the state with all as stated, its information divided by a colour."""
        values, V = eigen(self.A)  # an inverse is rounded to what is known best
        P = V / (1.0 + np.maximum(values, 0.0) / colour) @ V.T
        return P @ self.r / colour, P

    def scatter(self, P: FloatArray) -> FloatArray:
        """What the scatter of blocks adds to the covariance P of the estimate, (s, s), in directions where it does.

        Of the sandwich ``P sum_b s_b s_b' P`` (Huber, 1967) what is more than ``P A P``.
        """
        own, U = eigen(P)  # of what is known exactly, zero but for rounding
        root = U * np.sqrt(np.maximum(own, 0.0))
        values, V = eigen(root.T @ (self.scores.T @ self.scores - self.A) @ root)
        half = root @ V * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(half @ half.T, np.float64)


class ErrorEquations:
    """The rows of one recursion so far.

    Args:
        seen: the rows.
        errors: that they may tell.
        correlation: how many neighbouring rows say the same thing.
        since_s: blocks of rows without the payload, and with it, that begin earlier are left out.

    Attributes:
        share: of the rows, that are taken in.
        least_share: the same of rows with the payload or of those without, whichever is the smaller.
    """

    def __init__(
        self, seen: RowBlocks, errors: RowErrors, correlation: float, since_s: tuple[float, float] = (-np.inf, -np.inf)
    ) -> None:
        self._doubted: int | None = None
        self._correlation, self._gains, self._common = correlation, errors.gains, errors.common
        self._multiplied = np.broadcast_to(errors.multiplied, (len(errors.sigma), len(errors.centre)))
        self._of_all = ~np.isin(np.arange(len(errors.sigma)), errors.held)
        p = len(errors.centre)
        self._p, self._drawn = p, np.append(errors.centre, np.zeros(len(errors.sigma)))
        self._L = block_diag(errors.half, np.diag(errors.sigma))  # (p + e, n + e)
        self._columns = np.zeros((p + seen.considered + 2, len(errors.sigma)))
        has = np.flatnonzero((np.array(errors.columns, np.intp) >= 0) & ~errors.gains.any(axis=1))
        self._columns[p + np.array(errors.columns, np.intp)[has], has] = 1.0
        self._parts, rows = list[_Part](), np.zeros((2, 2))
        for part in seen.parts:
            blocks, noise = seen.with_errors(*part)
            times_s = seen.times_s(*part)
            late = times_s >= since_s[part[0]]
            count = blocks[:, -1, -1]
            rows[int(part[0])] += count.sum(), count[late].sum()
            if late.any():
                blocks, own = blocks[late], seen.own(*part) * float(count[late].sum() / count.sum())
                self._parts.append(
                    _Part(*part, times_s[late], blocks, blocks.sum(axis=0), noise[late].sum(axis=0), own)
                )
        shares = [taken / whole for whole, taken in (rows.sum(axis=0), *rows) if whole]
        self.share, self.least_share = (float(min(some, default=0.0)) for some in (shares[:1], shares))

    def at(self, x: FloatArray) -> FloatArray:
        """Base parameters and errors of instruments in their units, X (p + e,), by the state, (s,)."""
        return np.asarray(self._drawn + self._L @ x, np.float64)

    def information(self, X: FloatArray, noise: FloatArray, scaled: FloatArray | None = None) -> Information:
        """What all rows tell of the state.

        Args:
            X: base parameters and errors, (p + e,), about which they are linear.
            noise: variance of each instrument over that of its weights, (instruments,).
            scaled: base parameters that an error of all gains multiplies, (p,); those of X where not given.
        """
        (H, N), d = np.zeros((2, len(X), len(X))), np.zeros(len(X))
        times_s = self._times_s()
        scores = np.zeros((len(times_s), len(X)))
        for part in self._parts:
            J, v = self._linear(part, X, scaled)
            weighted = J.T / noise[part.instrument]
            H += weighted @ part.sums @ J
            N += weighted @ part.noise @ J
            d += weighted @ (part.noise @ v)
            scores[np.searchsorted(times_s, part.times_s)] -= (part.blocks @ v) @ weighted.T
        A, added = (self._L.T @ part @ self._L for part in (H, N))
        A, gain = told(A, A + added, self._L.T @ d, np.abs(self._L.T) @ np.sqrt(np.diag(H + N).clip(0.0)))
        each = scores @ self._L @ gain.T
        return Information(A, each.sum(axis=0) + gain @ (self._L.T @ (H @ (X - self._drawn))), each)

    def shares(self, X: FloatArray, along: FloatArray) -> FloatArray:
        """What the rows of each time tell of functions of the state, (b, m, m), of which only ratios are used.

        Args:
            X: base parameters and errors, (p + e,), about which the rows are linear.
            along: covariance of the state with the functions, (s, m).
        """
        noise, moved = self.noise(X), self._L @ along
        times_s = self._times_s()
        told = np.zeros((len(times_s), along.shape[1], along.shape[1]))
        for part in self._parts:
            V = self._linear(part, X)[0] @ moved
            told[np.searchsorted(times_s, part.times_s)] += V.T @ part.blocks @ V / noise[part.instrument]
        return told

    def noise(self, X: FloatArray) -> FloatArray:
        """Variance of each instrument over that of its weights, by what an estimate leaves over, (instruments,)."""
        left, rows, _ = self._sums(X)
        made = np.maximum(1.0, self._correlation * left / np.maximum(rows, 1.0))
        if self._doubted is not None:
            made[self._doubted] *= max(rows[self._doubted] / self._correlation, 1.0)
        return np.asarray(made, np.float64)

    def misfit(self, X: FloatArray, other: FloatArray) -> float:
        """The largest variance of an instrument over that which its noise and that of the motion explain.

        Args:
            X: an estimate.
            other: another; of the motion's noise at both the smaller counts, since at one that the rows do not tell it
                may be any.
        """
        return float(self.misfits(X, other).max())

    def misfits(self, X: FloatArray, other: FloatArray | None = None) -> FloatArray:
        """That of each instrument, (instruments,); about one estimate where no other is given."""
        left, _, stated = self._sums(X)
        if other is not None:
            stated = np.minimum(stated, self._sums(other)[2])
        return np.asarray(self._correlation * (left / np.maximum(stated, 1.0)), np.float64)

    def doubting(self, instrument: int) -> "ErrorEquations":
        """The same, but all rows of an instrument count as one: what they leave over is not noise, and may be alike."""
        made = copy.copy(self)
        made._doubted = instrument
        return made

    def _times_s(self) -> FloatArray:
        return np.unique(np.concatenate([part.times_s for part in self._parts]))

    def _sums(self, X: FloatArray) -> FloatArray:
        """What an estimate leaves over of each instrument, its rows, and what noise explains, (3, instruments)."""
        sums = np.zeros((3, self._gains.shape[1]))
        for part in self._parts:
            whole, (_, v) = part.sums + part.noise, self._linear(part, X)
            of_motion = self._correlation * max(float(v @ part.noise @ v), 0.0)
            left = max(float(v @ whole @ v), 0.0)
            sums[:, part.instrument] += np.array([left, whole[-1, -1], part.own + of_motion])
        return sums

    def _linear(self, part: _Part, X: FloatArray, scaled: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """What multiplies ``[beta, c]``, (p + k + 2, p + e), and what X leaves over, of ``[Y, C, y, 1]``."""
        p, mine = self._p, np.flatnonzero(self._gains[:, part.instrument] & (self._of_all | part.held))
        logs = X[p + mine] @ self._multiplied[mine]
        if not np.abs(logs).max(initial=0.0) < _MOST:
            raise np.linalg.LinAlgError("the estimate has gone where no gain is")
        factor = np.exp(logs)
        J = np.zeros((len(self._columns), len(X)))
        J[:, p:] = self._columns
        np.fill_diagonal(J[:p, :p], factor)
        J[:p, p + mine] = (self._multiplied[mine] * (factor * X[:p])).T
        v = self._columns @ X[p:]
        v[:p] += factor * X[:p]
        v[-2] = -1.0
        if scaled is not None:
            J[:p, p + self._common] = (self._multiplied[self._common] * (factor * scaled)).T
        return J, v
