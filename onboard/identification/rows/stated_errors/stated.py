"""How wide what the vehicle file states must be taken so that the rows do not contradict it.

The file states sigmas: of each link in the drawing, of the friction and offset in each torque, of each torque constant.
Some are wishful, and data that contradict one are then given to something else. So each stated sigma is one guess of
many of its kind: the errors z of one key, in stated sigmas, are Student's,

    z_k | w_k ~ N(0, s^2 / w_k),    w_k ~ Gamma(nu / 2, nu / 2),

with a scale ``s >= 1`` for all keys of a kind: who is wrong about one torque constant was so about the others, of which
the rows tell less. Scales and weights are those of the largest likelihood, the errors integrated out, by expectation
and maximisation (Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989; MacKay, Neural Computation 4, 1992):

    E_k = E[z_k' z_k],    w_k = (nu + n_k) / (nu + E_k / s^2),
    s^2 = max(1, (nu + sum w_k E_k) / (nu + sum n_k)),

``s^2`` with nu errors of the stated size beforehand: of a kind of which the rows tell one key alone, the others are not
as wrong as that one. A key of which the rows tell nothing has ``E_k = n_k`` and stays as stated. So does every key,
until by the odds of the policy it is likelier that some are wider: where one statement is wrong, the others are as
doubtful.

An arm that is heavier than drawn and gains that are all too large by one factor are the same to most motions. So that
factor alone, beside all else as stated, competes with all that may be wider: unless one of the two is likelier by the
same odds, the answer covers both, its interval reaching as far as that factor would move it. It is a factor of the
bodies as drawn, so that its equations are linear however large it is. Free widths are paid
for: the evidence of each hypothesis has Student's density of its errors in place of the normal one of fitted width.

Errors of gains are estimated beside the parameters here, ``y = exp(e) Y chi`` about the last estimate (a column of
readings would be of their noise, and shrink the gain); the estimate itself considers them. Noise first: each
instrument's is as large as what it leaves over, and all information is divided by how much more the scores of blocks
scatter than it says, since what friction and gears leave is alike for seconds.

The rows of a free base read nothing, and leave the scale of all parameters open: there the stated sigmas hold. So they
do where scales of cells are estimated by them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import ITERATIONS, ROUNDS
from onboard.estimation.policy import HALF, ODDS
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.regressor.base_parameters import BaseParameters


class Stated(NamedTuple):
    """What a sigma is of."""

    key: str  # of vehicle.toml
    kind: str  # common to all keys that are stated alike


FREEDOM = 4.0
"""Degrees of freedom of the errors: what Lange, Little and Taylor find to serve where the data cannot tell it."""
_SETTLED = 0.02  # relative change of a width in a step


class Taken(NamedTuple):
    """What is taken for granted of what is stated."""

    rls: SquareRootRls  # of the rows so far
    considered: FloatArray  # (k,) sigmas of the considered errors
    prior_root: FloatArray  # (P, P) L of the covariance ``L L'`` of the standard parameters
    covariance: FloatArray  # (p, p) of the base parameters
    said: tuple[str, ...] = ()  # which are contradicted

    @classmethod
    def of(
        cls, rls: SquareRootRls, considered: Sequence[Considered], base: BaseParameters, prior_root: FloatArray
    ) -> "Taken":
        """All of it, by a recursion that may not have its rows yet."""
        return cls(rls, np.array([cause.sigma for cause in considered]), prior_root, base.covariance(prior_root))


class _Part(NamedTuple):
    """Rows of one instrument, with the payload or without."""

    instrument: int
    whole: FloatArray  # (p + 2, p + 2) normal equations with the noise of their regressor
    rows: float  # their number
    equations: FloatArray  # (b, p, p + 1) of each block without that noise: information, and its right-hand side
    information: FloatArray  # (p, p) sum of these
    times_s: FloatArray  # when each block begins, (b,)


def _part(blocks: RowBlocks, held: bool, number: int) -> _Part:
    own, noise = blocks.apart(held, number)
    every, p = own.sum(axis=0), own.shape[1] - 2
    whole = every + noise.sum(axis=0)
    return _Part(number, whole, float(whole[-1, -1]), own[:, :p, : p + 1], every[:p, :p], blocks.times_s(held, number))


class StatedSigmas:
    """The sigmas of one vehicle file.

    Args:
        columns: of the standard parameters, P.
        considered: errors; those of an instrument's gain are looked at.
        instruments: that make the rows.
        base: the base parameters.
        chi: standard parameters as drawn, (P,).
        physical: which base parameters are of bodies, not of an instrument, (p,).
        stated: what is taken for granted if nothing contradicts it.
    """

    def __init__(
        self,
        columns: Sequence[Stated],
        considered: Sequence[Considered],
        instruments: Sequence[str],
        base: BaseParameters,
        chi: FloatArray,
        physical: BoolArray,
        stated: Taken,
    ) -> None:
        self._gains = [k for k, cause in enumerate(considered) if cause.effect == "scale"]
        gains = [Stated(considered[k].key, "scale_sigma") for k in self._gains]
        self._rows = [None if considered[k].is_common else instruments.index(considered[k].row) for k in self._gains]
        half, sigma, centre = base.grouping @ stated.prior_root, stated.considered[self._gains], base.value(chi)
        p, P, k = *half.shape, len(gains)
        self._base = base
        every = [*columns, *gains]
        self._active = np.flatnonzero(np.concatenate([half.any(axis=0), sigma > 0.0]))
        self._L = np.zeros((p + k, P + k))
        self._L[:p, :P], self._L[p:, P:] = half, np.diag(sigma)
        self._L = self._L[:, self._active]
        self._centre = np.concatenate([centre, np.zeros(k)])
        self._bodies, self._shape = np.flatnonzero(physical), (P, k)
        self.stated = tuple(dict.fromkeys(every[column] for column in self._active))
        self._key: IndexArray = np.array([self.stated.index(every[column]) for column in self._active], np.intp)
        kinds = list(dict.fromkeys(one.kind for one in self.stated))
        self._kind: IndexArray = np.array([kinds.index(one.kind) for one in self.stated], np.intp)
        self._many = np.bincount(self._key).astype(np.float64)  # errors of each key
        common = {gains[number] for number, row in enumerate(self._rows) if row is None}
        self._common = np.array([one in common for one in self.stated], np.bool_)

    def taken(self, stated: Taken, blocks: RowBlocks, mean: FloatArray, correlation: float) -> Taken:
        """What is taken for granted after the rows.

        Args:
            stated: what is, if nothing contradicts it.
            blocks: the rows.
            mean: the estimate by what is stated, (p,).
            correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
        """
        X = np.concatenate([mean, np.zeros(len(self._rows))])
        n = len(self.stated)
        as_it_is = _Widths(np.ones(n), np.zeros(len(self._active)), np.zeros(n))
        parts, many, free = [_part(blocks, *part) for part in blocks.parts], as_it_is, ~self._common
        for _ in range(ROUNDS):
            A, r = self._information(*self._equations(parts, X, correlation, X), X, many.width)
            many = self._settled(A, r, many.width, free)
            X = self._centre + self._L @ many.errors
        nothing, of_many = (self._evidence(A, r, each) for each in (as_it_is, many))
        one, of_one = as_it_is, nothing
        if self._common.any():
            by_factor = self._information(*self._of_one_factor(parts, X, correlation), many.width)
            one = self._settled(*by_factor, as_it_is.width, self._common)
            of_one += self._evidence(*by_factor, one) - self._evidence(*by_factor, as_it_is)
        least = -np.log(ODDS)
        if max(of_many, of_one) - nothing < least:
            return stated
        width = one.width if of_one - of_many > least else many.width
        said = self._contradicted(A, r, many) if width is many.width else ()
        P, k = self._shape
        factors = np.ones(P + k)
        factors[self._active] = width[self._key]
        considered, root = stated.considered.copy(), stated.prior_root * factors[:P]
        considered[self._gains] *= factors[P:]
        if of_many - of_one < least and self._common.any():
            of_gains, common = (self._L @ one.errors)[-k:], self._rows.index(None)
            factor = float(of_gains[common] + np.delete(of_gains, common).mean())
            considered[self._gains[common]] = max(considered[self._gains[common]], abs(factor) / HALF)
            said += (f"all gains may be off by a common factor, by {abs(factor):.0%}",)
        covariance = self._base.covariance(root)
        rls = stated.rls.with_prior(self._centre[: len(covariance)], covariance)
        return Taken(rls, considered, root, covariance, said)

    def _of_one_factor(
        self, parts: Sequence["_Part"], X: FloatArray, correlation: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The same equations with a common factor of what is drawn, and about what: its error is then of any size.

        About an estimate that is far from the drawing, a factor would leave the bodies nothing.
        """
        X, common = X.copy(), len(X) - len(self._rows) + self._rows.index(None)
        X[self._bodies] *= np.exp(X[common])
        X[common] = 0.0
        return *self._equations(parts, X, correlation, self._centre), X

    def _equations(
        self, blocks: Sequence["_Part"], X: FloatArray, correlation: float, scaled: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Information on parameters and gains about ``X``, (p + k, p + k), and each block's scores, (b, p + k).

        ``scaled``: parameters that the common factor of all gains multiplies.
        """
        p, parts = len(X) - len(self._rows), list[tuple[_Part, FloatArray, FloatArray]]()
        left, count = dict[int, float](), dict[int, float]()
        for part in blocks:
            J = np.zeros((p, len(X)))
            np.fill_diagonal(J, 1.0)
            gains = [p + k for k, row in enumerate(self._rows) if row is None or row == part.instrument]
            if gains:
                factor = np.exp(X[gains].sum())
                J[self._bodies, self._bodies] = factor
                J[self._bodies[:, None], gains] = factor * X[self._bodies, None]
                common = [p + k for k, row in enumerate(self._rows) if row is None]
                J[self._bodies[:, None], common] = factor * scaled[self._bodies, None]
            v = np.concatenate([J[:, :p] @ X[:p], [-1.0, 0.0]])
            left[part.instrument] = left.get(part.instrument, 0.0) + max(float(v @ part.whole @ v), 0.0)
            count[part.instrument] = count.get(part.instrument, 0.0) + part.rows
            parts.append((part, J, v[:-1]))
        loud = {k: max(1.0, correlation * left[k] / max(count[k], 1.0)) for k in left}  # of the noise, variance
        times_s = np.unique(np.concatenate([part.times_s for part in blocks]))
        H, scores = np.zeros((len(X), len(X))), np.zeros((len(times_s), len(X)))
        for part, J, v in parts:
            H += J.T @ part.information @ J / loud[part.instrument]
            scores[np.searchsorted(times_s, part.times_s)] -= (part.equations @ v) @ J / loud[part.instrument]
        return H, scores

    def _information(
        self, H: FloatArray, scores: FloatArray, X: FloatArray, width: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Information on the errors, in stated sigmas, and its right-hand side for errors about zero."""
        values, V = np.linalg.eigh(self._L.T @ H @ self._L)
        V, values = V[:, values > 0.0], values[values > 0.0]  # the others are of regressors that are noise
        A = V * values @ V.T
        w = width[self._key]
        wide = A * np.outer(w, w)
        C = np.linalg.inv(np.eye(len(A)) + wide)
        each = scores @ self._L @ V @ V.T
        known = float(np.vdot(C, wide))
        colour = max(1.0, float(np.vdot(each * w @ C, each * w)) / known) if known > 0.0 else 1.0
        offset = self._L.T @ (H @ (X - self._centre))
        return A / colour, (each.sum(axis=0) + V @ (V.T @ offset)) / colour

    def _settled(self, A: FloatArray, r: FloatArray, width: FloatArray, free: BoolArray) -> "_Widths":
        """Width of each key, of those that are free to change, and the errors with them, in stated sigmas."""
        every, one = np.bincount(self._kind, self._many), np.eye(len(A))
        square = np.ones(len(every))  # of each kind's scale
        for _ in range(ITERATIONS):
            w = width[self._key]
            C = np.linalg.inv(one + A * (w[:, None] * w))
            z = w * (C @ (w * r))
            E = np.bincount(self._key, z * z + w * w * np.diag(C))
            weight = (FREEDOM + self._many) / (FREEDOM + E / square[self._kind])
            square = np.maximum(1.0, (FREEDOM + np.bincount(self._kind, weight * E)) / (FREEDOM + every))
            made = np.where(free, np.maximum(1.0, np.sqrt(square[self._kind] / weight)), width)
            change, width = float(np.abs(np.log(made[free] / width[free])).max()), made
            if change < _SETTLED:
                break
        paid = _students(E / square[self._kind], self._many) - _normal(E / width**2, self._many, weight)
        return _Widths(width, z, np.where(free, paid, 0.0))

    def _contradicted(self, A: FloatArray, r: FloatArray, wide: "_Widths") -> tuple[str, ...]:
        """Words for each kind of which it is likelier that it is so wide than that it is as stated."""
        said, width = list[str](), wide.width
        widest = self._evidence(A, r, wide)
        for kind in np.unique(self._kind[width > 1.0]):
            without = wide._replace(width=np.where(self._kind == kind, 1.0, width))
            if widest - self._evidence(A, r, without) < -np.log(ODDS):
                continue
            mine = np.flatnonzero((self._kind == kind) & (width > 1.0))
            worst = mine[np.argmax(width[mine])]
            more = others(width[mine[mine != worst]])
            said.append(f"the rows contradict {self.stated[worst].key}: taken {width[worst]:.3g} times as wide{more}")
        return tuple(said)

    def _evidence(self, A: FloatArray, r: FloatArray, wide: "_Widths") -> float:
        w = wide.width[self._key]
        M = np.eye(len(A)) + A * np.outer(w, w)
        b = w * r
        return float(b @ np.linalg.solve(M, b) - np.linalg.slogdet(M)[1]) / 2.0 + float(
            wide.paid[wide.width > 1.0].sum()
        )


def others(width: FloatArray) -> str:
    """What is said of others of a kind, (n,) times as wide as stated; empty where two digits show none wider."""
    wider = width[np.round(width, 1) > 1.0]
    return f", and {len(wider)} like it {wider.min():.2g} times or more" if len(wider) else ""


class _Widths(NamedTuple):
    """How wide keys are taken."""

    width: FloatArray  # (keys,) of each, in stated sigmas
    errors: FloatArray  # with these, in stated sigmas
    paid: FloatArray  # (keys,) log of Student's density of the errors over the normal one of these widths


def _students(square: FloatArray, many: FloatArray) -> FloatArray:
    """Log density of ``many`` errors with a sum of squares, each of scale one."""
    whole = 0.5 * (FREEDOM + many)
    head = gammaln(whole) - gammaln(0.5 * FREEDOM) - 0.5 * many * np.log(np.pi * FREEDOM)
    return np.asarray(head - whole * np.log1p(square / FREEDOM), np.float64)


def _normal(square: FloatArray, many: FloatArray, weight: FloatArray) -> FloatArray:
    """The same of normal ones whose variance is one over ``weight``; ``square``: over that variance."""
    return np.asarray(-0.5 * many * np.log(2.0 * np.pi / weight) - 0.5 * square, np.float64)
