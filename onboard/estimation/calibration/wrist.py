"""A tool weighed by a wrist force-torque sensor in static poses: mass, centre of mass, zeros, scales, mounting.

In pose k the sensor, whose axes are M R_k' of the robot's base, feels the weight of all beyond it::

    d_k = M R_k' T g                                   gravity in sensor axes, m/s^2
    force_k  = (1 + S + X) m d_k + X' (p x d_k) / L + b_k     N: S scales of the axes, X, X' cross-talk, b zeros
    moment_k = (1 + S + X) (p x d_k) + X' L m d_k + b_k       N m: the same of the moments; p = m c

L is a moment over a force. M is the mounting of the sensor on the frame whose pose is given, T the tilt of the base.
Zeros are constants with a random walk from pose to pose (sensors warm up, cables creep). In the cosine transform
(DCT-II) over the poses such a walk is white: coefficient j > 0 has the variance ``sigma^2 + q^2 / (4 sin^2(pi j /
2n))``, and coefficient 0 is all that a constant zero changes, so it is left out (derived here). Noise and walk of each
axis, and the size of cross-talk, are estimated by expectation maximisation, anew for each spread of the scales: what is
wrong with these would pass for noise. The answer is a mixture over that spread, of all axes alike, or, as likely
beforehand, of all but one, whose scale is unknown. So the axes themselves tell how well they agree and which does not:
three measure the mass. Only two moments measure each lever, so one that is off is identified where two levers are long;
else both are as likely, and the mixture is of both. An error that all axes share cannot be seen.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.linalg import lapack
from scipy.special import stdtr, stdtrit

from onboard.estimation.arrays import FloatArray, hat, scatter
from onboard.estimation.calibration.wrist_model import (
    CROSS,
    UNKNOWNS,
    Linearisation,
    Priors,
    elements,
    linearised,
    moved,
    predicted,
    values_of,
)
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import READING

FEWEST = 4  # poses: fewer leave nothing over that could show noise
_WIDE = 10.0  # prior sigma of mass and first moment over what the largest reading makes
SPREADS = np.geomspace(0.5, 16.0, 16)  # of the scales, over what is stated: what all share their agreement hides
_SPREAD_FACTOR = np.log(3.0)  # 1 sigma of the spread's logarithm: data sheets give limits, by range, and not sigmas
_ALL = -0.5 * (np.log(SPREADS) / _SPREAD_FACTOR) ** 2  # logarithm of the prior, of all axes
_ALONE = -float(np.log(6.0))  # likewise that one is unknown besides: as likely as none
_WALKS = np.concatenate([[0.0, 0.01], np.geomspace(0.05, 20.0, 25)])  # of a zero from pose to pose, over the noise
_POOLED = 3.0  # degrees of freedom that the other axes lend to the variance of one
_ROUNDS = 25
_CLOSE = 1e-3  # change of the standard deviations' logarithms in a round: they have converged
_FINEST = 1e-6  # noise over the largest reading, at the least: 20 bits, finer than transducers resolve
_OF_ITS_KIND = np.kron(np.eye(2), 0.5 * (1.0 - np.eye(3)))  # half of what the two others of an axis' kind say
_LOCAL = 9  # poses about one, whose median is the zero there


class Noise(NamedTuple):
    """Of each of the six axes."""

    sigma: FloatArray  # (6,) of a pose, N and N m
    walk: FloatArray  # (6,) of the zero from one pose to the next
    cross: float  # cross-talk, relative


class PoseFit(NamedTuple):
    """One fit.

    Attributes:
        state: the most likely one.
        covariance: (45, 45) of mass, first moment, mounting and tilt (small turns), scales, cross-talk.
        noise: estimated.
        residual: (n, 6) readings less the model's, zeros and all, in the readings' units.
        left: (n - 1, 6) its :func:`coefficients`.
        evidence: logarithm of the marginal likelihood; differences between fits of the same readings count.
    """

    state: Linearisation
    covariance: FloatArray
    noise: Noise
    residual: FloatArray
    left: FloatArray
    evidence: float


class _Readings(NamedTuple):
    """Poses and wrenches as of :func:`fit`, and what each round takes of them."""

    R: FloatArray  # (n, 3, 3)
    wrench: FloatArray  # (n, 6)
    largest: tuple[float, float]  # force and moment
    elements: FloatArray  # (n, 9) of R'
    turned: FloatArray  # (n - 1, 9) their coefficients
    read: FloatArray  # (n - 1, 6) of the wrenches
    floor: FloatArray  # (6,) the least noise of each axis

    @classmethod
    def of(cls, R: FloatArray, wrench: FloatArray) -> "_Readings":
        turned = elements(R)
        return cls(R, wrench, _largest(wrench), turned, coefficients(turned), coefficients(wrench), _floor(wrench))


class _At(NamedTuple):
    """A state, and the model there."""

    state: Linearisation
    made: FloatArray  # (6, 9) readings by the elements of R'
    J: FloatArray  # (45, 6, 9)
    values: FloatArray  # (45,)

    @classmethod
    def of(cls, state: Linearisation, prior: Priors) -> "_At":
        return cls(state, *linearised(state, prior), values_of(state))


class _Found(NamedTuple):
    """The most likely state with a noise, and what a :class:`PoseFit` is made of."""

    at: _At
    covariance: FloatArray  # (45, 45)
    noise: Noise
    left: FloatArray  # (n - 1, 6)
    spread: FloatArray  # (n - 1, 6) variances of these
    sigmas: FloatArray  # (45,) of the unknowns beforehand
    volume: float  # logarithm of the covariance's root determinant


class Weighing(NamedTuple):
    """A mixture of fits, by the spreads of the scales."""

    best: PoseFit
    weights: FloatArray  # (k,)
    fits: tuple[PoseFit, ...]
    freedom: float  # degrees of it, of the noise
    spreads: FloatArray  # (k, 6) of the axes' scales, over what is stated

    @property
    def spread(self) -> FloatArray:
        """Of the axes' scales over what is stated, (6,), the mean."""
        return np.asarray(self.weights @ self.spreads, np.float64)

    def wider(self, times: float) -> tuple[float, FloatArray]:
        """Chance that all scales spread by more than so many times what is stated, and (6,) that one alone does."""
        beyond = self.spreads > times
        alone = beyond & (beyond.sum(axis=1) == 1)[:, None]
        return float(self.weights @ beyond.all(axis=1)), np.asarray(self.weights @ alone, np.float64)


def fit(R: FloatArray, wrench: FloatArray, prior: Priors, rounds: int = _ROUNDS) -> PoseFit:
    """The most likely state with the stated spread of the scales.

    Args:
        R: (n, 3, 3) of each pose: axes of the frame whose pose is given, in base axes.
        wrench: (n, 6) force and moment on the sensor, in its axes.
        prior: what is known.
        rounds: at most; few tell fits apart that differ by more than some nats.

    Raises:
        CalibrationError: too few poses, or readings that are not finite.
    """
    if len(R) < FEWEST or R.shape[1:] != (3, 3) or wrench.shape != (len(R), 6) or not np.isfinite(wrench).all():
        raise CalibrationError(f"{len(R)} poses: give {FEWEST} or more, each with an orientation and six readings")
    return _rounds(_Readings.of(R, wrench), prior, rounds, None)


def _rounds(own: _Readings, prior: Priors, rounds: int, begin: PoseFit | None) -> PoseFit:
    """From a fit with another spread; ``None``: from the closed form."""
    if begin is None:
        R, wrench = own.R, own.wrench
        state = begun(R, wrench, prior)
        sigma = scatter(np.diff(wrench - predicted(R, state, prior), axis=0)) / np.sqrt(2.0)
        noise = Noise(np.maximum(sigma, own.floor), np.zeros(6), prior.scale)
    else:
        state, noise = begin.state, begin.noise
    found = _fit(own, prior, _At.of(state, prior), noise)
    for _ in range(rounds):
        J = found.at.J.transpose(1, 0, 2)  # (6, 45, 9)
        hanging = J.transpose(0, 2, 1) @ found.covariance @ J  # (6, 9, 9)
        hanging = ((own.turned @ hanging) * own.turned).sum(axis=-1).T
        noise = _noise(found, hanging, prior, own.floor)
        change = float(np.abs(np.log(noise.sigma / found.noise.sigma)).max())
        found = _fit(own, prior, found.at, noise)
        if change < _CLOSE:
            break
    return _finished(own, found)


def weigh(R: FloatArray, wrench: FloatArray, prior: Priors, first: PoseFit) -> Weighing:
    """The mixture over the spread of the scales, about a first fit.

    Args:
        R: as of :func:`fit`.
        wrench: likewise.
        prior: its ``scale`` is the median of the spread.
        first: by :func:`fit`.
    """
    wide = np.vstack([np.zeros(6), np.eye(6)]) > 0.0  # of which the scale is unknown: none, or one
    own = _Readings.of(R, wrench)
    every = list[tuple[PoseFit, FloatArray, float]]()
    for odd, odds in zip(wide, [0.0, *[_ALONE] * 6], strict=True):
        one = None if odd.any() else first
        for spread, likely in zip(SPREADS, _ALL, strict=True):
            each = np.where(odd, SPREADS[-1], spread)
            its = prior._replace(spreads=tuple(each.tolist()))
            if one is first and spread <= 1.0:
                made = _finished(own, _fit(own, its, _At.of(first.state, prior), first.noise))
            else:
                one = made = _rounds(own, its, _ROUNDS, one)
            every.append((made, each, float(likely + odds)))
    fits = tuple(made for made, *_ in every)
    spreads = np.array([spread for _, spread, _ in every])
    logs = np.array([one.evidence for one in fits]) + [likely for *_, likely in every]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = fits[int(weights.argmax())]
    freedom = max(1.0, 6.0 * (len(R) - 1) - 9.0)  # mass, first moment, mounting and tilt
    return Weighing(best, weights, fits, freedom, spreads)


def interval(
    means: Sequence[float], sigmas: Sequence[float], weighing: Weighing, level: float
) -> tuple[float, float, float, float]:
    """Mean, sigma and both ends of the central interval of a mixture of Student's t.

    Args:
        means: of each fit.
        sigmas: likewise.
        weighing: their weights and degrees of freedom.
        level: of the interval, 0.95 say.
    """
    mean, sigma = np.array(means), np.maximum(np.array(sigmas), 1e-300)
    w = weighing.weights
    middle = float(w @ mean)
    whole = float(np.sqrt(w @ (sigma**2 + (mean - middle) ** 2)))

    def end(chance: float) -> float:
        ends = mean + stdtrit(weighing.freedom, chance) * sigma  # of each, and between them that of the mixture
        low, high = float(ends.min()), float(ends.max())
        while low < (at := 0.5 * (low + high)) < high:  # bisection
            below = float(w @ stdtr(weighing.freedom, (at - mean) / sigma))
            low, high = (at, high) if below < chance else (low, at)
        return at

    return middle, whole, end(0.5 * (1.0 - level)), end(0.5 * (1.0 + level))


def outliers(R: FloatArray, wrench: FloatArray, prior: Priors) -> NDArray[np.bool_]:
    """Poses with a reading that no noise makes, (n,): by the closed form of the three quarters that agree best.

    Residuals are compared with the median of some neighbours, so that a zero that drifts makes no outlier.
    """
    n = len(R)
    kept, z, level = np.arange(n), np.zeros_like(wrench), np.zeros_like(wrench)
    for _ in range(10):  # concentration steps (Rousseeuw and Van Driessen 1999)
        residual = wrench - predicted(R, begun(R[kept], (wrench - level)[kept], prior), prior)
        level = _medians(residual)
        left = residual - level
        z = left / np.maximum(scatter(left), _floor(wrench))
        kept = np.sort(np.argsort(np.abs(z).max(axis=1))[: max(FEWEST, (3 * n) // 4)])
    freedom = max(1.0, n - 4.0)
    return np.asarray((2.0 * stdtr(freedom, -np.abs(z)) < READING).any(axis=1))


def zeros(one: PoseFit, J: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Zeros of the axes at each pose, (n, 6), and their sigma at the last one, (6,).

    The third is the sigma of what a zero has moved between the first and the last pose, (6,).
    """
    n = len(one.residual)
    own = coefficients(J)
    weights, variance, inflated = _walks(one.left, one.noise, ((own @ one.covariance) * own).sum(axis=-1))
    zero_share = 1.0 - 1.0 / inflated  # of a coefficient that is the zero's
    share = np.concatenate([np.ones((len(_WALKS), 1)), zero_share], axis=1)
    smooth = dct(one.residual, axis=0, norm="ortho")
    each = idct(share[..., None] * smooth, axis=1, norm="ortho")  # (walks, n, 6)
    value = np.einsum("ka,kna->na", weights, each)
    last, first = (idct(np.eye(n), axis=0, norm="ortho")[k] for k in (-1, 0))
    hangs = -np.einsum("j,kj,ka,jap->ap", last, share, weights, dct(J, axis=0, norm="ortho"))
    spread = (each[:, -1] - value[-1]) ** 2 + variance * (share @ last**2)[:, None]
    sigma = np.sqrt((weights * spread).sum(axis=0) + np.einsum("ap,pq,aq->a", hangs, one.covariance, hangs))
    moved = each[:, -1] - each[:, 0]
    gone = (moved - (value[-1] - value[0])) ** 2 + variance * (share @ (last - first) ** 2)[:, None]
    return value, sigma, np.asarray(np.sqrt((weights * gone).sum(axis=0)), np.float64)


def begun(R: FloatArray, wrench: FloatArray, prior: Priors) -> Linearisation:
    """A closed form: mounting and mass by orthogonal Procrustes (Kabsch 1976), then the first moment."""
    h = np.einsum("nba,b->na", R, prior.gravity_m_s2)
    about, force = h - h.mean(axis=0), wrench[:, :3] - wrench[:, :3].mean(axis=0)
    H = force.T @ about
    H += 1e-3 * np.linalg.norm(H) * np.eye(3)  # where directions are few, the mounting nearest to none
    U, S, Vt = np.linalg.svd(H)
    way = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    M = (U * way) @ Vt
    mass = float((S * way).sum() / max((about**2).sum(), 1e-300))
    d = h @ M.T
    d -= d.mean(axis=0)
    A = -hat(d).reshape(-1, 3)  # p x d = -d x p
    moment = (wrench[:, 3:] - wrench[:, 3:].mean(axis=0)).ravel()
    p = np.linalg.lstsq(A, moment)[0]
    return Linearisation(mass, p, M, np.zeros(2), np.zeros(6), np.zeros(30))


def coefficients(values: FloatArray) -> FloatArray:
    """Of the cosine transform over the poses (n, ...), without the constant, (n - 1, ...)."""
    return np.asarray(dct(values, axis=0, norm="ortho")[1:], np.float64)


def _medians(values: FloatArray) -> FloatArray:
    """Of the neighbours of each row, or of all rows where there are few."""
    if len(values) < 3 * _LOCAL:
        return np.broadcast_to(np.median(values, axis=0), values.shape)
    half = _LOCAL // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    around = np.lib.stride_tricks.sliding_window_view(padded, _LOCAL, axis=0)
    return np.asarray(np.median(np.delete(around, half, axis=-1), axis=-1), np.float64)


def _floor(wrench: FloatArray) -> FloatArray:
    """The least noise of each axis, (6,)."""
    return _FINEST * np.repeat(_largest(wrench), 3)


def _largest(wrench: FloatArray) -> tuple[float, float]:
    """Force and moment."""
    force, moment = np.abs(wrench).reshape(-1, 2, 3).max(axis=(0, 2)).tolist()
    return max(force, 1e-9), max(moment, 1e-9)


def prior_sigmas(wrench: FloatArray, prior: Priors, cross: float) -> FloatArray:
    """Prior sigma of the unknowns, (45,)."""
    return _sigmas(_largest(wrench), prior, cross)


def _sigmas(largest: tuple[float, float], prior: Priors, cross: float) -> FloatArray:
    force, moment = largest
    g = float(np.linalg.norm(prior.gravity_m_s2))
    scales = [prior.scale * spread for spread in prior.spreads]
    wide = [_WIDE * force / g, *[_WIDE * max(moment, 0.1 * force) / g] * 3]
    return np.array([*wide, *[prior.mounting_rad] * 3, *[prior.tilt_rad] * 2, *scales, *[cross] * 30])


@cache
def _eigenvalues(n: int) -> FloatArray:
    """Of the walk's information, without the constant, (n - 1,)."""
    return np.asarray(4.0 * np.sin(0.5 * np.pi * np.arange(1, n) / n) ** 2, np.float64)


def variances(noise: Noise, n: int) -> FloatArray:
    """Of the coefficients of the cosine transform, without the constant, (n - 1, 6)."""
    return np.asarray(noise.sigma**2 + noise.walk**2 / _eigenvalues(n)[:, None], np.float64)


def _fit(own: _Readings, prior: Priors, at: _At, noise: Noise) -> _Found:
    """Gauss-Newton to the most likely state with a given noise."""
    spread, sigmas = variances(noise, len(own.R)), _sigmas(own.largest, prior, noise.cross)
    information = sigmas**-2.0
    turned = own.turned
    # The normal equations' sums over the poses, before the loop: readings are linear in R'.
    S = (turned.T[None] / spread.T[:, None]) @ turned  # (6, 9, 9)
    b = (turned.T @ (own.read / spread)).T  # (6, 9)
    weighted = np.empty((UNKNOWNS, 6, 9))
    for _ in range(_ROUNDS):
        A = at.J.reshape(UNKNOWNS, 54)
        np.matmul(at.J.transpose(1, 0, 2), S, out=weighted.transpose(1, 0, 2))
        H = weighted.reshape(UNKNOWNS, 54) @ A.T
        gradient = A @ (b - (S @ at.made[..., None])[..., 0]).ravel()
        H.flat[:: UNKNOWNS + 1] += information
        unit = 1.0 / np.sqrt(H.diagonal())  # of very different units
        H *= unit
        H *= unit[:, None]
        L, singular = lapack.dpotrf(H, lower=1)
        if singular:
            raise np.linalg.LinAlgError("the poses and what is known before leave an unknown open")
        whitened, _ = lapack.dtrtrs(L, unit * (gradient - at.values * information), lower=1)
        at = _At.of(moved(at.state, unit * lapack.dtrtrs(L, whitened, lower=1, trans=1)[0]), prior)
        if np.abs(whitened).max() < _CLOSE:
            break
    root, _ = lapack.dtrtrs(L, np.diag(unit), lower=1)
    volume = float(np.log(unit / np.diag(L)).sum())
    return _Found(at, root.T @ root, noise, own.read - turned @ at.made.T, spread, sigmas, volume)


def _finished(own: _Readings, found: _Found) -> PoseFit:
    """With what no further round asks for."""
    at, left, spread, sigmas = found.at, found.left, found.spread, found.sigmas
    residual = own.wrench - own.elements @ at.made.T
    squares = float((left**2 / spread).sum() + ((at.values / sigmas) ** 2).sum())
    evidence = -0.5 * (squares + float(np.log(spread).sum())) - float(np.log(sigmas).sum()) + found.volume
    return PoseFit(at.state, found.covariance, found.noise, residual, left, evidence)


def _noise(found: _Found, hanging: FloatArray, prior: Priors, floor: FloatArray) -> Noise:
    """One step of expectation maximisation: noise and walk of each axis, and cross-talk; as of :func:`_walks`."""
    weights, variance, _ = _walks(found.left, found.noise, hanging)
    sigma = np.sqrt((weights * variance).sum(axis=0))
    walk = np.sqrt((weights * variance * _WALKS[:, None] ** 2).sum(axis=0))
    sigma = np.maximum(sigma, floor)
    crossed = float((found.at.state.cross**2).sum() + np.trace(found.covariance[CROSS, CROSS]))
    cross = np.sqrt((prior.scale**2 + crossed) / (1.0 + 30.0))
    return Noise(sigma, walk, float(cross))


def _walks(left: FloatArray, noise: Noise, hanging: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Probability of each walk, variance with it, (walks, 6), and what it multiplies variances by, (walks, n - 1).

    A walk that does not show may still be there, so all of them are kept. ``left``: :func:`coefficients` of the
    residuals, (n - 1, 6); ``hanging``: their variance by that of the unknowns, likewise.
    """
    n = len(left) + 1
    squares = left**2 + hanging
    pooled = np.exp(np.repeat(np.log(noise.sigma).reshape(2, 3).mean(axis=1), 3)) ** 2
    inflated, lost, volume = _inflated(n)
    count = n - 1 + _POOLED
    variance = (np.einsum("ja,kj->ka", squares, lost) + _POOLED * pooled) / count
    likelihood = -0.5 * (count * np.log(variance) + volume)
    likelihood = likelihood + likelihood @ _OF_ITS_KIND
    weights = np.exp(likelihood - likelihood.max(axis=0))
    return weights / weights.sum(axis=0), variance, inflated


@cache
def _inflated(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What walks multiply the variances of n poses by, (walks, n - 1), its inverse, and its volume, (walks, 1)."""
    inflated = 1.0 + (_WALKS[:, None] ** 2) / _eigenvalues(n)
    return inflated, 1.0 / inflated, np.log(inflated).sum(axis=1)[:, None]
