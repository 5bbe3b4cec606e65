"""Block-jackknife covariance and intervals of a least squares, corrected for regressor noise and common causes.

The formal covariance ``(Y' W Y)^-1`` holds for independent row errors of the stated sigma and an exact regressor. Here
the smoothing kernel correlates neighbouring rows, vibration and friction are coloured, a data-sheet sigma may be wrong,
and the regressor is made of measured signals. Four corrections:

1. *Regressor noise*: noise in Y makes ``Y' W Y`` too large by a known amount N, and the estimate too small
   (attenuation). N comes with the rows (``noise`` of :meth:`BlockScores.add`) and is subtracted:
   ``chi = (Lambda - N)^-1 (Y' W y - n)``, n for noise that the left-hand sides share. The uncertainty of N is
   added to the interval. A direction whose information is nearly all noise falls back to the prior.
2. *Rows*: a delete-one-block jackknife. Rows are summed into blocks of time longer than the kernel;
   only ``H_b = Y' W Y - N`` and ``g_b = Y' W y`` of a block are kept, so the score of every block at the *final*
   estimate, ``s_b = g_b - H_b chi``, is exact without going back to the rows. Leaving block b out moves the estimate by
   ``-(Lambda - N - H_b)^-1 s_b``, and the spread of these moves is the covariance, for any correlation within a block.
   (Block form of the HC3 of MacKinnon and White, J. Econometrics 29 (1985) 305: too wide when a few blocks carry the
   information, where the plain block sandwich is too narrow.) When the store is full, neighbours are merged and the
   block length doubles: memory is constant, and blocks become longer than slow errors. Blocks in which the motion and
   its errors repeat are one (:mod:`onboard.estimation.recursive.consistency`).
3. *Few blocks*: Student's t, with Satterthwaite's degrees of freedom from each block's share of the information on the
quantity. 4. *Common causes*: considered parameters (scale or lever of a load cell) shift all rows together and do not
average out; their part is added in quadrature through the sensitivities of the RLS (Schmidt's consider covariance).

The formal covariance remains a lower bound, because a short run may show too little scatter by chance.

Blocks of time whose errors repeat, because the motion does: they are one block of the jackknife.

What a model leaves (friction, gears, a flexible joint) is a function of the motion. A motion that is repeated, as a
period of a Fourier series is, leaves the same again: the repetitions are no independent witnesses of that error, and
the scatter of blocks, each of which has its like among those kept, shows neither its size nor its leverage.

The scores of two blocks, in units of the formal covariance, have a cosine. Of blocks that have nothing in common its
sign is random and its mean square v that of all pairs; the sum over the n pairs of one lag is then normal with the
variance n v. The shortest lag where it is larger than chance makes of so many is the period; blocks of one phase are
added up. Where errors are noise, nothing repeats, and repetitions do count.
"""

import copy
import math
from functools import lru_cache
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from onboard.estimation.arrays import TINY, BoolArray, FloatArray, IndexArray, eigen
from onboard.estimation.errors import RowError
from onboard.estimation.policy import DOUBT, HALF, INTERVAL, MOST_SHARE, of_each, sigmas, wider
from onboard.estimation.recursive.blocks import TimeBlocks
from onboard.estimation.recursive.rls import Solution, SquareRootRls

_FEWEST = 3  # blocks in a period: neighbours are alike for other reasons, and two phases have no scatter
MOST_NOISE = MOST_SHARE  # of a direction's information; above it the direction falls back to the prior
NOISE_SIGMA = 0.2  # relative, of the stated power of the regressor's noise


@lru_cache(maxsize=8)
def _pairs(count: int) -> tuple[IndexArray, IndexArray]:
    """Of so many each two, by their numbers."""
    return np.triu_indices(count, 1)


def phases(numbers: FloatArray, scores: FloatArray) -> IndexArray:
    """Group of each block, (b,): one a block, or one a phase of each recording.

    Recordings are as far apart as all blocks together are long, or farther.

    Args:
        numbers: of the blocks in time, whole, (b,).
        scores: of the blocks at the estimate, in units in which the formal covariance is the identity, (b, p).
    """
    alone, length = np.arange(len(numbers)), np.linalg.norm(scores, axis=1)
    if len(numbers) < 2 * _FEWEST or not length.all():
        return alone
    order = np.argsort(numbers)
    begins = np.append(True, np.diff(numbers[order]) > len(numbers))
    recording = np.empty_like(alone)
    recording[order] = np.cumsum(begins) - 1
    since = numbers - numbers[order][begins][recording]
    one, other = _pairs(len(numbers))
    if recording.any():
        one, other = np.array([one, other])[:, recording[one] == recording[other]]
    cosine = np.einsum("ip,ip->i", scores[one], scores[other]) / (length[one] * length[other])
    lag = np.rint(np.abs(since[one] - since[other])).astype(np.intp)
    pairs = np.bincount(lag, minlength=_FEWEST + 1)
    looks, pairs = int(np.count_nonzero(pairs[_FEWEST:])), np.maximum(pairs, 1)
    total = np.bincount(lag, cosine, len(pairs))
    away = total / np.sqrt(pairs * np.mean(cosine**2))
    away[:_FEWEST] = 0.0
    beyond = away > sigmas(of_each(DOUBT, looks))
    if not beyond.any():
        return alone
    period = int(beyond.argmax())
    period += int(away[period : period + 2].argmax())
    around = np.arange(period - 1, min(period + 2, len(pairs)))
    period_blocks = float(np.average(around, weights=np.maximum((total / pairs)[around], 0.0)))
    phase = np.rint(since % period_blocks * period / period_blocks).astype(np.intp) % period
    return np.asarray(np.unique(recording * period + phase, return_inverse=True)[1], np.intp)


def added_up(group: IndexArray, parts: FloatArray) -> FloatArray:
    """Sums of the blocks of each group, (g, ...), of (b, ...)."""
    made = np.zeros((int(group.max(initial=-1)) + 1, *parts.shape[1:]))
    np.add.at(made, group, parts)
    return made


class Interval(NamedTuple):
    """Linear combinations of the estimate with their two-sided intervals; each field (r,)."""

    mean: FloatArray
    sigma: FloatArray  # standard deviation, considered parameters included
    degrees_of_freedom: FloatArray  # of the row part of sigma
    low: FloatArray
    high: FloatArray
    far: FloatArray  # half of the 99.9 % interval over that of the other


class Instead(Protocol):
    """Another estimate of the same parameters."""

    @property
    def known(self) -> tuple[FloatArray, FloatArray]:
        """Mean, (p,), and covariance, (p, p)."""

    def half_widths(self, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half of the 95 % and of the 99.9 % intervals of linear functions, (r,) each, of (r, p)."""


class NoiseScale(NamedTuple):
    """How much larger the rows' noise is than stated."""

    variance: float  # over the stated one
    freedom: float  # degrees of freedom


class BlockScores(TimeBlocks):
    """Normal equations per block of time, in constant memory.

    Args:
        parameters: p.
        block_s: first length of a block; five kernel widths or more.
        capacity: blocks kept before neighbours are merged.

    Raises:
        RowError: a length that is not positive, or a capacity below four.
    """

    def __init__(self, parameters: int, block_s: float, capacity: int = 64) -> None:
        super().__init__(block_s, capacity, (parameters, parameters), (parameters,), (parameters, parameters + 1))

    @property
    def normal(self) -> FloatArray:
        """``Y' W Y`` of each block less its regressor noise, (b, p, p)."""
        return self.sums[0][: self.count]

    @property
    def moment(self) -> FloatArray:
        """``Y' W y`` of each block, less noise that both sides share, (b, p)."""
        return self.sums[1][: self.count]

    @property
    def noise_by_block(self) -> FloatArray:
        """Contribution of regressor noise to ``Y' W Y`` of each block, (b, p, p)."""
        return self.sums[2][: self.count, :, :-1]

    @property
    def noise(self) -> FloatArray:
        """Total contribution of regressor noise to ``Y' W Y``, (p, p)."""
        return np.asarray(self.noise_by_block.sum(axis=0), np.float64)

    @property
    def noise_moment(self) -> FloatArray:
        """Contribution of regressor noise to ``Y' W y``, (p,), where the left-hand sides share it."""
        return np.asarray(self.sums[2][: self.count, :, -1].sum(axis=0), np.float64)

    def add(
        self, times_s: FloatArray, Y: FloatArray, y: FloatArray, sigma: FloatArray, noise: FloatArray | None = None
    ) -> None:
        """Adds the rows given to the estimator, with the same sigmas.

        Args:
            times_s: (m,) time of each row, on any continuous axis.
            Y: (m, p).
            y: (m,).
            sigma: (m,).
            noise: (m, s, p) change of each row per standard deviation of s independent errors of its motion; or
                (m, s, p + 1), with that of its left-hand side last.

        Raises:
            RowError: wrong shape, or a number that is not finite.
        """
        m, p = y.shape[0], self.sums[1].shape[1]
        if Y.shape != (m, p) or sigma.shape != (m,) or times_s.shape != (m,):
            raise RowError(f"rows of shape {times_s.shape}, {Y.shape}, {y.shape}; give (m,), (m, {p}), (m,)")
        if noise is not None and (noise.ndim != 3 or noise.shape[0] != m or noise.shape[2] - p not in (0, 1)):
            raise RowError(f"row noise of shape {noise.shape}; give ({m}, s, {p})")
        if m == 0:
            return
        scaled = np.empty((m, p + 1))
        scaled[:, :p], scaled[:, p] = Y, y
        scaled /= sigma[:, None]
        flat = scaled.ravel()
        if not math.isfinite(np.vdot(flat, flat) + times_s.sum()):  # any NaN or infinity propagates into the sum
            raise RowError("rows must be finite; gate them before they come here")
        whitened = None if noise is None else noise / sigma[:, None, None]
        for slot, mine in self.split(times_s):
            normal, moment, added = (part[slot] for part in self.sums)
            rows = scaled[mine]
            square = rows[:, :p].T @ rows
            normal += square[:, :p]
            moment += square[:, p]
            if whitened is not None:
                own = whitened[mine].reshape(-1, whitened.shape[2])
                N = own[:, :p].T @ own
                added[:, : N.shape[1]] += N
                normal -= N[:, :p]
                if N.shape[1] > p:
                    moment -= N[:, p]

    def expect_noise(self) -> None:
        """Of rows that were made without noise: takes in what that of the regressor adds on average."""
        normal, moment, added = self.sums
        normal += added[..., :-1]
        moment += added[..., -1]


class JackknifeEstimate:
    """Estimate with block-jackknife intervals: regressor noise, correlated rows, few blocks, prior, common causes.

    Args:
        rls: the estimator, after its rows.
        blocks: the same rows by blocks.
        considered_sigma: standard deviations of the considered parameters, (k,); or a root of their covariance, (k, k).
        noise_sigma: relative standard deviation of the stated power of the regressor's noise.
        scale: of the rows' noise, by the scatter of all blocks and directions, which is known better than that of one:
            no variance is below it, and its degrees of freedom count.

    Attributes:
        mean: the estimate, (p,), corrected for regressor noise.

    Raises:
        SingularError: as :meth:`SquareRootRls.solve`.
        RowError: wrong number of considered sigmas.
    """

    _scale: NoiseScale | None = None
    _instead: Instead | None = None

    def __init__(
        self,
        rls: SquareRootRls,
        blocks: BlockScores,
        considered_sigma: ArrayLike = (),
        noise_sigma: float = NOISE_SIGMA,
        scale: NoiseScale | None = None,
    ) -> None:
        sigma = self._checked(rls, considered_sigma)
        self._scale = scale
        # Everything below is in x = V' R chi: the plain information is the identity, that of the noise diag(noise).
        corrected = _corrected(rls, blocks)
        self.mean, plain, T, R, noise, x, keep, signal, shared = corrected
        self._root = corrected.root
        causes = R @ plain.sensitivity  # (p, k)
        causes = (causes * sigma if sigma.ndim == 1 else causes @ sigma).T
        causes = np.vstack([causes, noise_sigma * (noise * x - shared)])
        self._common = T @ np.where(signal, causes / keep, 0.0).T  # (p, k + 1)
        self._prior_half = T / keep @ (rls.prior_root @ T).T  # (p, r)
        mask = np.outer(signal, signal)
        H = T.T @ blocks.normal @ T * mask  # (b, p, p)
        scores = (blocks.moment @ T) * signal - H @ x  # (b, p)
        group = phases(blocks.starts_s / blocks.block_s, scores / np.sqrt(keep))
        H, scores = added_up(group, H), added_up(group, scores)
        # Without the only block that carries a direction the matrix is singular: a tiny ridge makes the move
        # very large instead of undefined.
        rest = np.diag(np.where(signal, keep, 1.0)) - H + np.eye(x.size) * 1e-12
        self._moves = np.linalg.solve(rest, scores[..., None])[..., 0] @ T.T  # (b, p)
        self._shares = self._root @ H @ self._root.T  # (b, p, p) of the formal covariance, by block

    @staticmethod
    def _checked(rls: SquareRootRls, considered_sigma: ArrayLike) -> FloatArray:
        sigma = np.atleast_1d(np.asarray(considered_sigma, np.float64))
        k = rls.considered
        if (
            sigma.shape not in ((k,), (k, k))
            or not np.isfinite(sigma).all()
            or (sigma.ndim == 1 and (sigma < 0.0).any())
        ):
            raise RowError(f"{k} considered parameters need as many sigmas, none negative, or a root ({k}, {k})")
        return sigma

    def instead(self, other: Instead, shares: FloatArray | None = None) -> Self:
        """With mean, covariance and intervals of another estimate; bounds are of this one.

        Args:
            other: the estimate.
            shares: of what it knows, by blocks of rows, (b, p, p); those of this one where not given.
        """
        made = copy.copy(self)
        made.mean, made._instead = other.known[0], other
        if shares is not None:
            made._shares = shares
        return made

    def _rows_weight(self) -> float:
        b = self._moves.shape[0]
        return (b - 1) / b if b else 0.0

    @property
    def _least(self) -> float:
        return 1.0 if self._scale is None else self._scale.variance

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the estimate with all corrections but Student's, (p, p); at least the formal one."""
        rows = self._moves.T @ self._moves * self._rows_weight() + self._prior_half @ self._prior_half.T
        if self._instead is not None:
            return self._instead.known[1]
        common = self._common @ self._common.T
        # The floor, direction by direction: eigenvalues of `rows` relative to the formal covariance, none below that of
        # the noise.
        inverse = np.linalg.inv(self._root)
        values, vectors = eigen(inverse @ rows @ inverse.T)
        half = self._root @ vectors * np.sqrt(np.maximum(values, self._least))
        return np.asarray(half @ half.T + common, np.float64)

    def causes(self, weights: ArrayLike) -> FloatArray:
        """Change of ``weights @ chi`` by one sigma of each considered parameter, or column of the root, (r, k)."""
        return np.asarray(np.atleast_2d(np.asarray(weights, np.float64)) @ self._common[:, :-1], np.float64)

    def parts(self, weights: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sigma of ``weights @ chi`` by scatter of the rows, the prior, and doubt in the regressor's noise, (r,) each.

        What considered parameters add is :meth:`causes`.
        """
        w = np.atleast_2d(np.asarray(weights, np.float64))
        prior = np.linalg.norm(w @ self._prior_half, axis=1)
        rows = ((self._moves @ w.T) ** 2).sum(axis=0) * self._rows_weight()
        rows = np.maximum(rows, self.formal_variance(w) - prior**2)
        return np.sqrt(rows), prior, np.abs(w @ self._common[:, -1])

    def formal_variance(self, weights: ArrayLike) -> FloatArray:
        """Variance of ``weights @ chi`` under the stated sigmas of rows, regressor and prior alone, (r,)."""
        return np.asarray(((np.atleast_2d(np.asarray(weights, np.float64)) @ self._root) ** 2).sum(axis=1), np.float64)

    def combination(self, weights: ArrayLike) -> Interval:
        """Linear combinations ``weights @ chi`` with their intervals.

        Args:
            weights: (r, p).

        Raises:
            RowError: a wrong shape.
        """
        w = np.atleast_2d(np.asarray(weights, np.float64))
        if w.shape[1] != self.mean.shape[0]:
            raise RowError(f"weights of shape {w.shape} for {self.mean.shape[0]} parameters")
        mean = w @ self.mean
        jackknife = ((self._moves @ w.T) ** 2).sum(axis=0) * self._rows_weight()
        prior = ((w @ self._prior_half) ** 2).sum(axis=1)
        common = ((w @ self._common) ** 2).sum(axis=1)
        share = np.maximum((w @ self._shares * w).sum(axis=2), 0.0)  # (b, r)
        total, squares = share.sum(axis=0), (share**2).sum(axis=0)
        freedom = np.maximum(np.divide(total**2, squares, out=np.ones_like(total), where=squares > 0.0) - 1.0, 1.0)
        if self._scale is not None:
            freedom = np.full_like(total, self._scale.freedom)
        variance = np.maximum(jackknife + prior, self._least * self.formal_variance(w))
        far = np.full_like(total, wider())
        if self._instead is not None:
            near, beyond = self._instead.half_widths(w)
            variance, common = (near / HALF) ** 2, np.zeros_like(common)
            far = np.divide(beyond, near, out=far, where=near > 0.0)
        t = stdtrit(freedom, 0.5 + 0.5 * INTERVAL)
        half = np.sqrt(t**2 * variance + HALF**2 * common)
        return Interval(mean, np.sqrt(variance + common), freedom, mean - half, mean + half, far)


def noise_scale(normal: FloatArray, scores: FloatArray, covariance: FloatArray) -> NoiseScale:
    """How much larger the rows' noise is than stated, as a variance, by the scores of all blocks and directions.

    A block's score has the covariance ``H_b - H_b C H_b`` where the noise is as stated, so with
    ``num = sum s_b' C s_b`` and ``Q_b = C (H_b - H_b C H_b)`` the scale is ``num / sum tr Q_b``; its degrees of freedom
    are ``(sum tr Q_b)^2 / sum tr Q_b^2`` (Satterthwaite, 1946).

    Args:
        normal: H_b of each block, (b, p, p).
        scores: s_b of each at the estimate, (b, p).
        covariance: C of the estimate at the stated noise, prior included, (p, p).

    Returns:
        As stated, with no degrees of freedom, where there is no information.
    """
    CH = covariance @ normal  # (b, p, p)
    Q = CH - CH @ CH
    expected = float(np.trace(Q, axis1=1, axis2=2).sum())
    squares = float(np.einsum("bij,bji->", Q, Q))
    if not expected > 0.0 or not squares > 0.0:
        return NoiseScale(1.0, 0.0)
    found = float(np.einsum("bi,ij,bj->", scores, covariance, scores))
    return NoiseScale(found / expected, expected**2 / squares)


class _Corrected(NamedTuple):
    """An estimate corrected for regressor noise, and what its intervals are made of."""

    mean: FloatArray  # (p,)
    plain: Solution
    T: FloatArray  # (p, p): chi = T x
    R: FloatArray  # (p, p): x = R chi
    noise: FloatArray  # (p,)
    x: FloatArray  # (p,)
    keep: FloatArray  # (p,) information without the noise; the prior's alone where nothing else remains
    signal: BoolArray  # (p,) where something else does
    shared: FloatArray  # (p,) noise that both sides share

    @property
    def root(self) -> FloatArray:
        """Root of the formal covariance, (p, p)."""
        return self.T * np.where(self.signal, 1.0 / self.keep, 1.0 / np.sqrt(self.keep))


def _corrected(rls: SquareRootRls, blocks: BlockScores) -> _Corrected:
    plain, R = rls.solve(), rls.information_root
    T = np.linalg.inv(R)
    noise, V = eigen(T.T @ blocks.noise @ T)
    T, R = T @ V, V.T @ R
    of_prior, prior_right = ((rls.prior_root @ T) ** 2).sum(axis=0), rls.prior_equations()[1]
    signal = noise < MOST_NOISE
    noise = np.where(signal, np.maximum(noise, 0.0), 0.0)
    keep = np.where(signal, 1.0 - noise, np.maximum(of_prior, TINY))
    shared = T.T @ blocks.noise_moment
    x = np.where(signal, R @ plain.mean - shared, T.T @ prior_right) / keep
    return _Corrected(T @ x, plain, T, R, noise, x, keep, signal, shared)


def corrected_mean(rls: SquareRootRls, blocks: BlockScores) -> FloatArray:
    """The mean of :class:`JackknifeEstimate`, (p,), without its intervals."""
    return _corrected(rls, blocks).mean


def innovation(
    rls: SquareRootRls, blocks: BlockScores, Y: FloatArray, y: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As :meth:`SquareRootRls.innovation`, against the mean of :class:`JackknifeEstimate`.

    Rows at rest, of noise alone, seem to say that what multiplies it is zero: motion would contradict them.
    """
    corrected = _corrected(rls, blocks)
    spread = Y @ corrected.root
    return y - Y @ corrected.mean, np.sqrt(sigma**2 + (spread * spread).sum(axis=1))
