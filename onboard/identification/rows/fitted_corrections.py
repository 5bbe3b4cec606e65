"""Fits the considered errors of the instruments and compares them with their stated sigmas.

Considered parameters are not estimated, since the rows seldom tell them from the body. Where the rows do tell them, a
changed calibration shows: fitted alone, beside the parameters and the other errors within their sigmas, an error lies
beyond what was stated of it. Rows are summed into blocks of time as in :mod:`onboard.estimation.consistency`; the
scatter of the fit without each block is part of the sigma that it is compared with (derived here).

An error whose effect the parameters reproduce is not told, and its fit would follow the noise of the regressor: the
share of its effect that they do not reproduce must exceed what they leave over of the readings, and the noise of the
regressor. (The scale of a free body's rotor: it multiplies all inertias.)
"""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.consistency import BlockScores
from onboard.identification.rows.considered import Considered

_OPEN = 1e3  # prior sigmas: the error that is fitted
_TOLD = 1.5  # share of an error's effect that no parameter reproduces, over the share of the readings left over


class FittedCorrections:
    """Sums of rows with the columns of the considered errors.

    Args:
        parameters: p.
        considered: k errors; those without a sigma are not fitted.
        block_s: first length of a block.
    """

    def __init__(self, parameters: int, considered: Sequence[Considered], block_s: float) -> None:
        self._p, self._causes = parameters, tuple(considered)
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

    def in_sigmas(self, information: FloatArray, right: FloatArray, left_over: float) -> dict[str, float]:
        """Each error that is told, by its name, over its stated sigma and that of its fit together.

        Args:
            information: of the parameters' prior, (p, p).
            right: its right-hand side, (p,).
            left_over: share of the readings, in norm, that the estimate leaves over.
        """
        H, g = self._blocks.normal, self._blocks.moment  # (b, s, s), (b, s)
        stated = np.array([cause.sigma for cause in self._causes])
        fitted = np.flatnonzero(stated > 0.0)
        if len(H) < 2 or not fitted.size:
            return {}
        p, sums = self._p, np.asarray(H.sum(axis=0), np.float64)
        sigma, at = np.where(stated > 0.0, stated, np.finfo(np.float32).tiny), p + fitted
        prior, side = np.diag(np.concatenate([np.zeros(p), sigma**-2])), np.zeros(len(sums))
        prior[:p, :p], side[:p] = information, right
        whole, total = prior + sums, side + g.sum(axis=0)
        left_out = np.concatenate([whole[None], whole - H])  # all blocks, then all but one
        covariance = np.linalg.inv(left_out)
        mean = np.einsum("bij,bj->bi", covariance, np.concatenate([total[None], total - g]))[:, at]
        variance = covariance[:, at, at]
        own = np.maximum(1.0 / variance - (1.0 - _OPEN**-2) * stated[fitted] ** -2, np.finfo(np.float32).tiny)
        alone = mean / variance / own  # (1 + b, k): its own prior opened, by its marginal
        scatter = (len(H) - 1) / len(H) * ((alone[1:] - alone[0]) ** 2).sum(axis=0)
        in_sigmas = alone[0] / np.sqrt(stated[fitted] ** 2 + np.maximum(scatter, 1.0 / own[0]))
        return {
            self._causes[k].name: float(value)
            for k, value in zip(fitted, in_sigmas, strict=True)
            if self._is_told(sums, information, int(k), left_over)
        }

    def _is_told(self, sums: FloatArray, information: FloatArray, k: int, left_over: float) -> bool:
        p, column = self._p, self._p + k
        b, power = sums[:p, column], float(sums[column, column])
        own = power - float(b @ np.linalg.solve(sums[:p, :p] + information, b))
        noise = 0.0 if self._causes[k].effect.endswith("delay") else self._noise
        return own > _TOLD**2 * max(left_over**2 * power, noise)
