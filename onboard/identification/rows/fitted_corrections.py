"""Fits the considered errors of the instruments: how large each can still be, and which lie beyond their stated sigmas.

Where the rows tell errors from the body, less of them is left than was stated: each is as large as it is fitted, give
or take the sigma of the fit. The estimate of the body is that without errors, so what an interval has of them is their
second moment ``M = P + c c' + S``: c and P are the mean and covariance of all that are told, beside the parameters,
under their stated sigmas, and S is the scatter of c without each block of time (derived here).

A changed calibration shows as well: fitted alone, beside the parameters and the other errors within their sigmas, an
error lies beyond what was stated of it. Rows are summed into blocks of time as in
:mod:`onboard.estimation.consistency`; the scatter of the fit without each block is part of the sigma that it is
compared with (derived here).

An error whose effect the parameters reproduce is not told, and its fit would follow the noise of the regressor: the
share of its effect that they do not reproduce must exceed what they leave over of the readings, and the noise of the
regressor. (The scale of a free body's rotor: it multiplies all inertias.)
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from onboard.estimation.arrays import FloatArray
from onboard.estimation.consistency import BlockScores
from onboard.identification.rows.considered import Considered

_OPEN = 1e3  # prior sigmas: the error that is fitted
_TOLD = 1.5  # share of an error's effect that no parameter reproduces, over the share of the readings left over


class Fitted(NamedTuple):
    """The considered errors, k of them, after the rows."""

    in_sigmas: dict[str, float]  # each that is told, by its name, over its stated sigma and that of its fit together
    root: FloatArray  # (k, k) symmetric root of their second moments, in the units of their stated sigmas


class FittedCorrections:
    """Sums of rows with the columns of the considered errors.

    Args:
        parameters: p.
        considered: k errors; those without a sigma are not fitted.
        block_s: first length of a block.
        start: (p, k) change of the prior's mean per unit of each error, where an earlier flight made it.
    """

    def __init__(
        self, parameters: int, considered: Sequence[Considered], block_s: float, start: FloatArray | None = None
    ) -> None:
        self._p, self._causes = parameters, tuple(considered)
        start = np.zeros((parameters, len(self._causes))) if start is None else start
        self._start = np.hstack([np.eye(parameters), start])  # of parameters and errors, what the prior's mean is of
        self._noise = 0.0  # whitened power of the regressor's noise in what the rows should read
        self._blocks = BlockScores(parameters + len(self._causes), block_s)

    def add(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray,
        noise: FloatArray | None,
        mean: FloatArray,
    ) -> None:
        """Takes in rows as :meth:`BlockScores.add` does; ``C`` (m, k): ``d y / d c``, at the parameters ``mean``."""
        wider = None
        if noise is not None:
            effect = noise[..., : self._p] @ mean / sigma[:, None]  # (m, s)
            self._noise += float(np.vdot(effect, effect))
            wider = np.zeros((*noise.shape[:2], self._p + C.shape[1] + 1))
            wider[..., : self._p] = noise[..., : self._p]
            wider[..., -1] = noise[..., self._p] if noise.shape[2] > self._p else 0.0
        self._blocks.add(times_s, np.column_stack([Y, C]), y, sigma, wider)

    def fitted(self, information: FloatArray, right: FloatArray, left_over: float) -> Fitted:
        """The errors, fitted.

        Args:
            information: of the parameters' prior, (p, p).
            right: its right-hand side, (p,).
            left_over: share of the readings, in norm, that the estimate leaves over.
        """
        H, g = self._blocks.normal, self._blocks.moment  # (b, s, s), (b, s)
        stated = np.array([cause.sigma for cause in self._causes])
        fitted = np.flatnonzero(stated > 0.0)
        if len(H) < 2 or not fitted.size:
            return Fitted({}, np.diag(stated))
        p, sums = self._p, np.asarray(H.sum(axis=0), np.float64)
        sigma, at = np.where(stated > 0.0, stated, np.finfo(np.float32).tiny), p + fitted
        before, side = self._start.T @ information @ self._start, self._start.T @ right
        prior = before + np.diag(np.concatenate([np.zeros(p), sigma**-2]))
        whole, total = prior + sums, side + g.sum(axis=0)
        left_out = np.concatenate([whole[None], whole - H])  # all blocks, then all but one
        covariance = np.linalg.inv(left_out)
        mean = np.einsum("bij,bj->bi", covariance, np.concatenate([total[None], total - g]))[:, at]
        variance = covariance[:, at, at]
        own = np.maximum(1.0 / variance - (1.0 - _OPEN**-2) * stated[fitted] ** -2, np.finfo(np.float32).tiny)
        alone = mean / variance / own  # (1 + b, k): its own prior opened, by its marginal
        scatter = (len(H) - 1) / len(H) * ((alone[1:] - alone[0]) ** 2).sum(axis=0)
        in_sigmas = alone[0] / np.sqrt(stated[fitted] ** 2 + np.maximum(scatter, 1.0 / own[0]))
        told = np.array([self._is_told(sums + before, sums[p + k, p + k], int(k), left_over) for k in fitted], np.bool_)
        named = {self._causes[k].name: float(value) for k, value in zip(fitted[told], in_sigmas[told], strict=True)}
        return Fitted(named, self._second_moments(whole, total, fitted[told], stated))

    def _second_moments(
        self, whole: FloatArray, total: FloatArray, told: NDArray[np.intp], stated: FloatArray
    ) -> FloatArray:
        """Root of the errors' second moments, (k, k): the errors ``told`` by the rows, the others as stated."""
        used = np.concatenate([np.arange(self._p), self._p + told])
        left_out = np.concatenate([whole[None], whole - self._blocks.normal])[:, used[:, None], used]
        sums = np.concatenate([total[None], total - self._blocks.moment])[:, used]
        P, own = np.linalg.inv(left_out), stated[told]
        c = np.einsum("bij,bj->bi", P, sums)[:, self._p :] / own
        moves, b = c[1:] - c[0], len(c) - 1
        M = P[0, self._p :, self._p :] / np.outer(own, own) + np.outer(c[0], c[0]) + (b - 1) / b * moves.T @ moves
        M *= (stdtrit(b - 1, 0.975) / ndtri(0.975)) ** 2
        values, V = np.linalg.eigh(M)
        root = np.diag(stated)
        root[np.ix_(told, told)] = stated[told][:, None] * (V * np.sqrt(np.maximum(values, 0.0)) @ V.T)
        return root

    def _is_told(self, sums: FloatArray, power: float, k: int, left_over: float) -> bool:
        p, column = self._p, self._p + k
        b = sums[:p, column]
        own = float(sums[column, column] - b @ np.linalg.solve(sums[:p, :p], b))
        noise = 0.0 if self._causes[k].effect.endswith("delay") else self._noise
        return own > _TOLD**2 * max(left_over**2 * power, noise)
