"""Equations of all errors of an arm by the sums over its rows, whose noise is whitened and taken out of the regressor.

The state z has the errors of the prior, ``beta = beta_0 + G L z``, and errors c of instruments, each over its stated
sigma. A row of instrument r reads ``y = (1 + s_r) Y beta + C c``, s_r the error of its scale, and is linear about an
estimate; columns C are those that the recursion considers. Of an error without a column nothing is found.

Errors of encoders are no larger than stated here: noise of the motion is in their columns as in the regressor, and
would be taken for large ones.

Each instrument's noise is what the estimate leaves over of its rows, no less than their weights say. What is left is
alike for seconds where the model is not the arm's: all information is divided by how much more the scores of blocks
scatter than it says (*colour*, as in :mod:`onboard.identification.rows.stated_errors.stated`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import FARTHEST_SIZE, MISFIT_PART, MISFIT_REFUSED
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.evidence.bank import Bank, Weighed
from onboard.identification.evidence.mixture import Known
from onboard.identification.rows.checks.suspected import ErrorState
from onboard.identification.rows.row_blocks import RowBlocks

ROUNDS, SETTLED = 6, 0.1  # of Gauss and Newton; sigmas of the change in one


class _Part(NamedTuple):
    """Rows of one instrument, with the payload or without; sums of ``[Y, C, y, 1]``."""

    instrument: int
    times_s: FloatArray  # when each block begins, (b,)
    blocks: FloatArray  # (b, p + k + 2, p + k + 2) without the noise of the regressor
    sums: FloatArray  # (p + k + 2, p + k + 2) of all blocks
    noise: FloatArray  # (p + k + 2, p + k + 2) that noise
    own: float  # sum of squares of the readings' own sigmas


class AllRows:
    """The rows of one recursion so far.

    Args:
        seen: the rows.
        half: ``G L``, (p, n), of the prior as wide as it is taken.
        errors: the state, n of the prior and e of instruments.
        scales: place of each instrument's error of scale among those of instruments, (instruments,).
        correlation: how many neighbouring rows say the same thing.
        since_s: blocks that begin earlier are left out.

    Attributes:
        share: of the rows, that are taken in.
    """

    def __init__(
        self,
        seen: RowBlocks,
        half: FloatArray,
        errors: ErrorState,
        scales: Sequence[int],
        correlation: float,
        since_s: float = -np.inf,
    ) -> None:
        self._half, self._centre, self._sigma, self._correlation = half, errors.centre, errors.sigma, correlation
        self._scales, (self._p, self._n), self._k = scales, half.shape, seen.considered
        self._parts = list[_Part]()
        rows = np.zeros(2)
        for part in seen.parts:
            blocks, noise = seen.with_errors(*part)
            times_s = seen.times_s(*part)
            late = times_s >= since_s
            count = blocks[:, -1, -1]
            rows += count.sum(), count[late].sum()
            if late.any():
                blocks, own = blocks[late], seen.own(*part) * float(count[late].sum() / count.sum())
                self._parts.append(
                    _Part(part[1], times_s[late], blocks, blocks.sum(axis=0), noise[late].sum(axis=0), own)
                )
        self.share = float(rows[1] / max(rows[0], 1.0))
        self._errors = np.zeros((self._p + self._k + 2, len(errors.sigma)))  # columns of all, but for scales
        for e, (at, sigma) in enumerate(zip(errors.columns, errors.sigma.tolist(), strict=True)):
            if e not in scales:
                self._errors[self._p + at, e] = sigma

    def known(self, x: FloatArray, noise: FloatArray) -> Known:
        """Mean and covariance of the state with all as stated, linear about an estimate of it, (s,).

        Args:
            x: the estimate.
            noise: variance of each instrument over that of its weights, (instruments,).
        """
        size = len(x)
        A, b, doubt = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        for part in self._parts:
            J, target = self._linear(part, x)
            weighted = J.T / noise[part.instrument]
            A += weighted @ part.sums @ J
            b += weighted @ part.sums @ target
            doubt += weighted @ part.noise @ self._left(part, x)
        values, V = np.linalg.eigh(A)
        V = V[:, values > 0.0]  # the others are of regressors that are noise
        A, b = V * values[values > 0.0] @ V.T, V @ (V.T @ b)
        P = np.linalg.inv(np.eye(size) + A)
        moved = NOISE_SIGMA * P @ doubt
        return P @ b, P + np.outer(moved, moved)

    def noise(self, x: FloatArray) -> FloatArray:
        """Variance of each instrument over that of its weights, by what an estimate leaves over, (instruments,)."""
        left, rows, _ = self._sums(x)
        return np.asarray(np.maximum(1.0, self._correlation * left / np.maximum(rows, 1.0)), np.float64)

    def misfit(self, x: FloatArray, other: FloatArray) -> float:
        """The largest variance of an instrument over that which its noise and that of the motion explain.

        Args:
            x: an estimate.
            other: another; of the motion's noise at both the smaller counts, since at one that the rows do not tell it
                may be any.
        """
        left, _, stated = self._sums(x)
        stated = np.minimum(stated, self._sums(other)[2])
        return self._correlation * float((left / np.maximum(stated, 1.0)).max())

    def _sums(self, x: FloatArray) -> FloatArray:
        """What an estimate leaves over of each instrument, its rows, and what noise explains, (3, instruments)."""
        sums = np.zeros((3, len(self._scales)))
        for part in self._parts:
            whole, v = part.sums + part.noise, self._left(part, x)
            of_motion = self._correlation * max(float(v @ part.noise @ v), 0.0)
            sums[:, part.instrument] += np.array([v @ whole @ v, whole[-1, -1], part.own + of_motion])
        return sums

    def colour(self, x: FloatArray, noise: FloatArray) -> float:
        """How much more the scores of blocks scatter at an estimate than their information says, as a variance."""
        scores, A = self._scores(x, noise)
        P = np.linalg.inv(np.eye(len(x)) + A)
        expected = float(np.vdot(P, A))
        return max(1.0, float(np.vdot(scores @ P, scores)) / expected) if expected > 0.0 else 1.0

    def scatter(self, x: FloatArray, P: FloatArray, noise: FloatArray) -> FloatArray:
        """What the scatter of blocks adds to the covariance P of an estimate, (s, s), in directions where it does.

        Of the sandwich ``P sum_b s_b s_b' P`` (Huber, 1967) what is more than ``P A P``, with the information A.
        """
        scores, A = self._scores(x, noise)
        root = np.linalg.cholesky(P)
        values, V = np.linalg.eigh(root.T @ (scores.T @ scores - A) @ root)
        half = root @ V * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(half @ half.T, np.float64)

    def _scores(self, x: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of each block at an estimate, (b, s), and the information of all, (s, s)."""
        times_s = np.unique(np.concatenate([part.times_s for part in self._parts]))
        scores, A = np.zeros((len(times_s), len(x))), np.zeros((len(x), len(x)))
        for part in self._parts:
            J = self._linear(part, x)[0]
            scores[np.searchsorted(times_s, part.times_s)] -= (
                part.blocks @ self._left(part, x) @ J / noise[part.instrument]
            )
            A += J.T @ part.sums @ J / noise[part.instrument]
        return scores, A

    def _beta(self, x: FloatArray) -> FloatArray:
        return np.asarray(self._centre + self._half @ x[: self._n], np.float64)

    def _scale(self, part: _Part, x: FloatArray) -> float:
        at = self._scales[part.instrument]
        return float(self._sigma[at] * x[self._n + at])

    def _linear(self, part: _Part, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What multiplies the state, (p + k + 2, s), and what it is held against, (p + k + 2,), of ``[Y, C, y, 1]``."""
        scale, beta, at = self._scale(part, x), self._beta(x), self._scales[part.instrument]
        of_bodies = np.zeros((len(self._errors), self._n))
        of_bodies[: self._p] = (1.0 + scale) * self._half
        J, target = np.hstack([of_bodies, self._errors]), np.zeros(len(self._errors))
        J[: self._p, self._n + at] = self._sigma[at] * beta
        target[: self._p], target[-2] = scale * beta - (1.0 + scale) * self._centre, 1.0
        return J, target

    def _left(self, part: _Part, x: FloatArray) -> FloatArray:
        """What an estimate leaves over, of ``[Y, C, y, 1]``: predicted less read, (p + k + 2,)."""
        v = self._errors @ x[self._n :]
        v[: self._p], v[-2] = (1.0 + self._scale(part, x)) * self._beta(x), -1.0
        return np.asarray(v, np.float64)


def explained(rows: AllRows, bank: Bank, x: FloatArray) -> tuple[Weighed, FloatArray | None]:
    """All hypotheses by the rows, and whether the likeliest, of something wrong, explains these.

    First all is as stated; then the likeliest of those hypotheses is followed whose size a linear model explains.

    Args:
        rows: of an arm.
        bank: suspects in its state.
        x: an estimate to begin with, (s,).

    Returns:
        The hypotheses, and what the scatter of blocks adds to the covariance, (s, s); None where what is stated is
        likelier, or more is left over than is doubted of noise.
    """
    stated, noise = _settled(rows, x, rows.noise(x))
    x = stated
    weighed, colour = _weighed(rows, bank, x, noise)
    likely = max((one for one in weighed.every if one.size < FARTHEST_SIZE), key=lambda one: one.weight)
    if likely.suspect is not None:
        x, noise = _settled(rows, x, noise, bank, likely.numbers[:1])
        weighed, colour = _weighed(rows, bank, x, noise)
    if not weighed.contradicts or colour > MISFIT_REFUSED or rows.misfit(x, stated) > MISFIT_PART:
        return weighed, None
    return weighed, rows.scatter(*weighed.known(weighed.likeliest), colour * noise)


def _settled(
    rows: AllRows, x: FloatArray, noise: FloatArray, bank: Bank | None = None, which: tuple[int, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Estimate and noise where Gauss and Newton end, with all as stated or under the suspect of a bank of this number.

    They end at once where the suspect becomes larger than a linear model explains.
    """
    for _ in range(ROUNDS):
        before, louder, (x, P) = x, noise, rows.known(x, noise)
        if bank is not None:
            weighed = bank.weigh((x, P))
            one = next(one for one in weighed.every if one.numbers == which)
            if one.size >= FARTHEST_SIZE:
                return before, noise
            x, P = weighed.known(one)
        noise = np.minimum(noise, rows.noise(x))
        moved = float((np.abs(x - before) / np.sqrt(np.diag(P))).max())
        if moved < SETTLED and np.allclose(noise, louder, rtol=SETTLED):
            break
    return x, noise


def _weighed(rows: AllRows, bank: Bank, x: FloatArray, noise: FloatArray) -> tuple[Weighed, float]:
    """All hypotheses about an estimate, information divided by its colour, and that."""
    colour = rows.colour(x, noise)
    return bank.weigh(rows.known(x, colour * noise)), colour
