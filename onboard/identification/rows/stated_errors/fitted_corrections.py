"""Fits the considered errors of the instruments: how large each can still be, and which lie beyond their stated sigmas.

Where the rows tell errors from the body, less of them is left than was stated: each is as large as it is fitted, give
or take the sigma of the fit. The estimate of the body is that without errors, so what an interval has of them is their
second moment ``M = P + c c'``: c and P are the mean and covariance of all that are determined, beside the parameters,
under their stated sigmas with the tails of :mod:`onboard.identification.rows.stated_errors.stated`. The noise of the
rows is scaled by the scores of all blocks of time at this fit, where the errors no longer make them scatter (derived
here). Delays stay as stated: their columns are of derivatives, whose noise is not that of the rows.

A changed calibration shows as well: fitted alone, beside the parameters and the other errors within their sigmas, an
error lies beyond what was stated of it. The noise is then as large as all rows show it beside these errors, as what a
file states of equations is for the fastest motion; but for a bias, which takes up all that is slow in what the model
leaves, and whose scatter shows nothing of it. Rows are summed into blocks of time as in
:mod:`onboard.estimation.recursive.consistency`; the scatter of the fit without each block is part of the sigma that it
is compared with (derived here).

What an error does to a row is made of the same noisy signals as the row: of a free body, where every left-hand side is
zero, a fit would scale a noisy signal down rather than explain it. The noise of these columns, and what it shares with
the rows, is subtracted as that of the regressor is, and doubt in its power is part of the sigma.

An error whose effect the parameters reproduce is not determined, and its fit would follow the noise of the regressor:
the share of its effect that they do not reproduce must exceed what they leave over of the readings, and the noise of
the regressor. (The scale of a free body's rotor: it multiplies all inertias.)

The effect of an error is linear in the parameters, which settle within the first rows, so the rows' factors are kept,
and the columns are computed at the last estimate. Of a long flight only the first are kept: later rows have theirs at
the estimate of their time.
"""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import stdtrit

from onboard.estimation.arrays import ROUNDING, FloatArray, eigen
from onboard.estimation.maximum_likelihood import OPEN
from onboard.estimation.policy import HALF, INTERVAL, ODDS_OF_PART, times_text
from onboard.estimation.recursive.consistency import MOST_NOISE, NOISE_SIGMA, BlockScores, NoiseScale, noise_scale
from onboard.identification.misread import AXES, axes_text
from onboard.identification.rows.stated_errors.considered import OF_AXES, Considered, error_of_axes, misread_noise
from onboard.identification.rows.stated_errors.stated import FREEDOM

_ROUNDS = 4  # of the noise's scale, which settles to a few per cent
_MOST_KEPT = 1_000_000  # numbers, 8 MB: some two seconds of a body that is thrown, or five throws


class _Rows(NamedTuple):
    """Rows of some ticks, m in all."""

    times_s: FloatArray  # (m,)
    Y: FloatArray  # (m, p)
    y: FloatArray  # (m,)
    sigma: FloatArray  # (m,)
    D: FloatArray  # (m, k (p + 1))
    noise: FloatArray | None  # (m, s, p + 1)


class Fitted(NamedTuple):
    """The considered errors, k of them, after the rows."""

    in_sigmas: dict[str, float]  # each that is determined, over its stated sigma and its fit's together
    root: FloatArray  # (k, k) symmetric root of their second moments, in the units of their stated sigmas
    noise: NoiseScale | None = None  # of the rows, beside them; None where none are fitted
    misread: str = ""  # how the accelerometer's axes are likelier to be read than as stated; empty: no other way


class FittedCorrections:
    """Sums of rows with the columns of the considered errors.

    Args:
        parameters: p.
        considered: k errors; those without a sigma are not fitted.
        block_s: first length of a block.
        joints: of the model, in the order of their signals.
        start: (p, k) change of the prior's mean per unit of each error, where an earlier flight made it.
    """

    def __init__(
        self,
        parameters: int,
        considered: Sequence[Considered],
        block_s: float,
        joints: Sequence[str] = (),
        start: FloatArray | None = None,
    ) -> None:
        self._p, self._causes = parameters, tuple(considered)
        self._misread = misread_noise(considered, joints)  # (k, s, s)
        start = np.zeros((parameters, len(self._causes))) if start is None else start
        self._start = np.hstack([np.eye(parameters), start])  # of parameters and errors, what the prior's mean is of
        self._settled = BlockScores(parameters + len(self._causes), block_s)
        self._waiting = list[_Rows]()
        self._kept = 0  # numbers so far in factors

    def add(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        D: FloatArray,
        noise: FloatArray | None,
        mean: FloatArray,
    ) -> None:
        """Takes in rows as :meth:`BlockScores.add` does.

        Args:
            times_s: (m,).
            Y: (m, p).
            y: (m,).
            sigma: (m,).
            D: (m, k (p + 1)) factors of ``d y / d c = D [chi 1]``.
            noise: (m, s, p) or (m, s, p + 1).
            mean: the parameters now, (p,): those that rows have that are not kept.
        """
        self._waiting.append(_Rows(times_s, Y, y, sigma, D, noise))
        self._kept += D.size
        if self._kept > _MOST_KEPT:
            self._settled, self._waiting = self._at(mean), []

    def _at(self, mean: FloatArray) -> BlockScores:
        """All rows with columns of the errors, those that are kept with the errors' effects at ``mean``, (p,)."""
        blocks, p, k = copy.deepcopy(self._settled), self._p, len(self._causes)
        for times_s, Y, y, sigma, D, noise in self._waiting:
            wider = None
            if noise is not None:
                wider = np.zeros((*noise.shape[:2], p + k + 1))
                wider[..., :p] = noise[..., :p]
                wider[..., -1] = noise[..., p] if noise.shape[2] > p else 0.0
                effect = noise[..., :p] @ mean - wider[..., -1]  # (m, s)
                wider[..., p:-1] = np.einsum("kst,mt->msk", self._misread, effect)
            C = D.reshape(len(y), k, p + 1) @ [*mean, 1.0]
            blocks.add(times_s, np.column_stack([Y, C]), y, sigma, wider)
        return blocks

    def fitted(self, information: FloatArray, right: FloatArray, left_over: float, mean: FloatArray) -> Fitted:
        """The errors, fitted.

        Args:
            information: of the parameters' prior, (p, p).
            right: its right-hand side, (p,).
            left_over: share of the readings, in norm, that the estimate leaves over.
            mean: the estimate, (p,).
        """
        blocks = self._at(mean)
        H, g = blocks.normal, blocks.moment  # (b, s, s), (b, s)
        stated = np.array([cause.sigma for cause in self._causes])
        fitted = np.flatnonzero(stated > 0.0)
        if len(H) < 2 or not fitted.size:
            return Fitted({}, np.diag(stated))
        p, sums = self._p, np.asarray(H.sum(axis=0), np.float64)
        sigma, at = np.where(stated > 0.0, stated, np.finfo(np.float32).tiny), p + fitted
        before, side = self._start.T @ information @ self._start, self._start.T @ right
        prior = before + np.diag(np.concatenate([np.zeros(p), sigma**-2]))
        seen = self._noise(H, g, prior, side)
        H, g = H / seen, g / seen
        whole, total = prior + H.sum(axis=0), side + g.sum(axis=0)
        left_out = np.concatenate([whole[None], whole - H])  # all blocks, then all but one
        covariance = np.linalg.inv(left_out)
        found = np.einsum("bij,bj->bi", covariance, np.concatenate([total[None], total - g]))[:, at]
        variance = covariance[:, at, at]
        own = np.maximum(1.0 / variance - (1.0 - OPEN**-2) * stated[fitted] ** -2, np.finfo(np.float32).tiny)
        alone = found / variance / own  # (1 + b, k): its own prior opened, by its marginal
        scatter = (len(H) - 1) / len(H) * ((alone[1:] - alone[0]) ** 2).sum(axis=0)
        taken_off = (covariance[0] @ (blocks.noise @ (covariance[0] @ total) - blocks.noise_moment))[at] / seen
        doubt = NOISE_SIGMA * taken_off / variance[0] / own[0]
        slow = np.array([self._causes[k].effect.endswith("bias") for k in fitted])
        least = np.where(slow, max(1.0, 1.0 / seen), 1.0) / own[0]
        in_sigmas = alone[0] / np.sqrt(stated[fitted] ** 2 + np.maximum(scatter, least) + doubt**2)
        noise = float(mean @ blocks.noise[:p, :p] @ mean)
        worth = left_over**2, noise
        told = np.array([self._is_told(sums + before, sums[p + k, p + k], int(k), *worth) for k in fitted], np.bool_)
        named = {self._causes[k].name: float(value) for k, value in zip(fitted[told], in_sigmas[told], strict=True)}
        steady = fitted[told & np.array([not self._causes[k].effect.endswith("delay") for k in fitted])]
        moments = self._second_moments(blocks, prior, side, steady, stated)
        return Fitted(named, *moments, self._misread_axes(blocks, before[:p, :p], side[:p]))

    def _second_moments(
        self, blocks: BlockScores, prior: FloatArray, right: FloatArray, of: NDArray[np.intp], stated: FloatArray
    ) -> tuple[FloatArray, NoiseScale]:
        """Root of the errors' second moments, (k, k), of some as fitted, and of the others as stated.

        Args:
            blocks: all rows.
            prior: information on parameters and errors before the rows, (p + k, p + k).
            right: its right-hand side, (p + k,).
            of: which errors are fitted.
            stated: their sigmas, (k,).
        """
        p, used = self._p, np.concatenate([np.arange(self._p), self._p + of])
        prior, right, own = prior[np.ix_(used, used)], right[used], stated[of]
        Q = _told(blocks.normal.sum(axis=0)[np.ix_(used, used)], blocks.noise[np.ix_(used, used)], prior[:p, :p], own)
        H, g = Q.T @ blocks.normal[:, used[:, None], used] @ Q, blocks.moment[:, used] @ Q
        noise, wider = NoiseScale(1.0, 1.0), np.ones(len(of))  # of the stated variances
        for _ in range(_ROUNDS):
            tails = np.diag(np.concatenate([np.zeros(p), own**-2 * (1.0 / wider - 1.0)]))
            P = np.linalg.inv(prior + tails + H.sum(axis=0) / noise.variance)
            x = P @ (right + g.sum(axis=0) / noise.variance)
            found, c = noise_scale(H, g - H @ x, P / noise.variance), x[p:] / own
            noise = NoiseScale(*np.maximum(1.0, found).tolist())
            wider = np.maximum(1.0, (FREEDOM + c * c + np.diag(P)[p:] / own**2) / (FREEDOM + 1.0))
        M = P[p:, p:] / np.outer(own, own) + np.outer(c, c)
        values, V = eigen(M * (stdtrit(noise.freedom, 0.5 + 0.5 * INTERVAL) / HALF) ** 2)
        root = np.diag(stated)
        root[np.ix_(of, of)] = own[:, None] * (V * np.sqrt(np.maximum(values, 0.0)) @ V.T)
        return root, noise

    @staticmethod
    def _noise(H: FloatArray, g: FloatArray, prior: FloatArray, right: FloatArray) -> float:
        """Variance of the rows' noise over the stated one, beside all errors.

        Args:
            H: information of each block on parameters and errors, (b, s, s).
            g: its right-hand side, (b, s).
            prior: information beforehand, (s, s).
            right: its right-hand side, (s,).
        """
        noise = 1.0
        for _ in range(_ROUNDS):
            P = np.linalg.inv(prior + H.sum(axis=0) / noise)
            x = P @ (right + g.sum(axis=0) / noise)
            noise = max(ROUNDING, noise_scale(H, g - H @ x, P / noise).variance)
        return noise

    def _misread_axes(self, blocks: BlockScores, information: FloatArray, right: FloatArray) -> str:
        """As what the accelerometer's axes are likelier to be read than as stated; empty: as stated.

        An order of the axes, or another sign of one, is a sum of the nine errors of a triad, in which rows are linear.
        (Other signs of all nothing tells.) Ways compete by the squares that they leave, the other errors being none,
        with the noise that the best of them needs.

        Args:
            blocks: all rows.
            information: of the prior on the parameters, (p, p).
            right: its right-hand side, (p,).
        """
        p, triad = self._p, [one for one in self._causes if one.effect in OF_AXES[2:] and one.axis is not None]
        if len(triad) < 9:
            return ""
        at, errors = [p + self._causes.index(one) for one in triad], np.stack([error_of_axes(one) for one in triad])
        ways = np.stack([by for by in AXES if np.count_nonzero(by < 0.0) < 2])
        c = np.linalg.solve(errors.reshape(9, 9).T, (np.eye(3) - ways.swapaxes(1, 2)).reshape(-1, 9).T)  # (9, ways)
        N, n = blocks.normal.sum(axis=0), blocks.moment.sum(axis=0)
        P, b = np.linalg.inv(information + N[:p, :p]), (right + n[:p])[:, None] - N[:p, at] @ c
        chi = P @ b  # (p, ways)
        squares = (c * (N[np.ix_(at, at)] @ c - 2.0 * n[at, None])).sum(axis=0) - (b * chi).sum(axis=0)
        best = int(squares.argmin())
        H = blocks.normal[:, :p]
        scores = blocks.moment[:, :p] - H[..., :p] @ chi[:, best] - H[..., at] @ c[:, best]
        behind = 0.5 * (squares - squares[best]) / max(ROUNDING, noise_scale(H[..., :p], scores, P).variance)
        if behind[0] <= (least := np.log(len(ways) / ODDS_OF_PART)):
            return ""
        near, otherwise = np.flatnonzero(behind <= least), (ways != np.eye(3)).any(axis=2).sum(axis=1)
        fewest = near[otherwise[near] == otherwise[near].min()]
        said = ", or ".join(axes_text(by) for by in ways[fewest[behind[fewest].argsort()]])
        return f"it is {times_text(behind[0])} times likelier that the accelerometer's {said}: correct the mapping"

    def _is_told(self, sums: FloatArray, power: float, k: int, left_over: float, noise: float) -> bool:
        """Whether rows tell an error.

        Args:
            sums: information of rows and prior on parameters and errors, (p + k, p + k).
            power: of the error's column.
            k: which error.
            left_over: power that the estimate leaves over, of that of the readings.
            noise: whitened power of the regressor's noise in what the rows should read.
        """
        p, column = self._p, self._p + k
        b = sums[:p, column]
        own = float(sums[column, column] - b @ np.linalg.solve(sums[:p, :p], b))
        return own > max(left_over * power, 0.0 if self._causes[k].effect.endswith("delay") else noise)


def _told(sums: FloatArray, noise: FloatArray, prior: FloatArray, stated: FloatArray) -> FloatArray:
    """Projector, (p + k, p + k), off what of the errors together the rows do not tell: it stays as stated.

    Each error may be told, and a sum of them not: a scale of each axis, where nothing tells that of all. The rows'
    information on it is then as much as the noise that is taken off it, and may be below zero.

    Args:
        sums: information of the rows on parameters and errors, without noise, (p + k, p + k).
        noise: what was taken off.
        prior: information on the parameters beforehand, (p, p).
        stated: sigmas of the errors, (k,).
    """
    p, k = len(prior), len(stated)
    unit = np.diag(np.concatenate([np.ones(p), stated]))
    own, absorbed = np.zeros((2, k, k)), np.zeros((p, k))
    for at, information in enumerate((sums + noise, sums)):
        A = unit @ information @ unit
        A[:p, :p] += prior
        absorbed = np.linalg.solve(A[:p, :p], A[:p, p:])
        own[at] = A[p:, p:] - A[p:, :p] @ absorbed
    kept, V = eigh(own[1], own[0] + OPEN**-2 * np.eye(k))
    V, dual = V[:, untold := kept < 1.0 - MOST_NOISE], np.linalg.inv(V)[untold]
    off = np.zeros_like(sums)
    off[:, p:] = np.vstack([-absorbed @ V, V]) @ dual
    return np.asarray(np.eye(p + k) - unit @ off @ np.linalg.inv(unit), np.float64)
