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

Errors of instruments are estimated beside the parameters here
(:mod:`onboard.identification.rows.stated_errors.equations`), so that what an encoder does to the rows is not given to a
gain. Of a base that stands, where nothing is contradicted, that is the answer: two motors that read one payload tell by
how much their gains differ, and rows with the payload whether they have changed since those without. Else the
recursion's is, which considers errors of the sizes found here, and changes of friction of the sizes that the rows tell.
Delays are as stated: what they do to rows is made of derivatives, whose noise is not that of the rows.

The rows of a free base read nothing, and leave the scale of all parameters open: there the stated sigmas hold.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import ITERATIONS, ROUNDS
from onboard.estimation.policy import HALF, MOSTLY, ODDS
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.evidence.mixture import Mixture
from onboard.identification.quantities import Causes
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.all_rows import as_stated, that_agree
from onboard.identification.rows.stated_errors.considered import HELD, OF_GAIN, Considered
from onboard.identification.rows.stated_errors.equations import ErrorEquations, RowErrors
from onboard.regressor.base_parameters import BaseParameters


class Stated(NamedTuple):
    """What a sigma is of."""

    key: str  # of vehicle.toml
    kind: str  # common to all keys that are stated alike


FREEDOM = 4.0
"""Degrees of freedom of the errors: what Lange, Little and Taylor find to serve where the data cannot tell it."""
_GAIN = "scale_sigma"  # what is common to all that state an instrument's
_SETTLED = 0.02  # relative change of a width in a step


class ByErrors(NamedTuple):
    """Base parameters with errors of gains and angles estimated beside them, all as stated."""

    known: Mixture
    causes: Causes  # the keys of all that is stated
    along: FloatArray  # (p, s) covariance of the base parameters with each error, in stated sigmas
    shares: FloatArray  # (b, p, p) of what is known of the base parameters, by blocks of rows
    doubted: int | None  # number of the cell that contradicts all others


class Taken(NamedTuple):
    """What is taken for granted of what is stated."""

    rls: SquareRootRls  # of the rows so far
    considered: FloatArray  # (k,) sigmas of the considered errors
    prior_root: FloatArray  # (P, P) L of the covariance ``L L'`` of the standard parameters
    centre: FloatArray  # (p,) base parameters as drawn
    covariance: FloatArray  # (p, p) of these
    said: tuple[str, ...] = ()  # which are contradicted
    answer: "ByErrors | None" = None  # where nothing is contradicted, and rows are linear in these

    @classmethod
    def of(
        cls,
        rls: SquareRootRls,
        considered: Sequence[Considered],
        base: BaseParameters,
        prior_root: FloatArray,
        chi: FloatArray,
    ) -> "Taken":
        """All of it, by a recursion that may not have its rows yet; ``chi``: standard parameters as drawn, (P,)."""
        sigma = np.array([cause.sigma for cause in considered])
        return cls(rls, sigma, prior_root, base.value(chi), base.covariance(prior_root))

    def by(self, rls: SquareRootRls) -> "Taken":
        """The same of the rows that a recursion has now."""
        return self if self.rls is rls else self._replace(rls=rls.with_prior(self.centre, self.covariance))


class StatedSigmas:
    """The sigmas of one vehicle file.

    Args:
        columns: of the standard parameters, P.
        considered: errors of instruments, each with a column in the rows unless it is a gain.
        instruments: that make the rows.
        base: the base parameters.
        stated: what is taken for granted if nothing contradicts it.
        cells: numbers of the instruments that others check.
        estimates: errors beside the parameters, where nothing does.
    """

    def __init__(
        self,
        columns: Sequence[Stated],
        considered: Sequence[Considered],
        instruments: Sequence[str],
        base: BaseParameters,
        stated: Taken,
        cells: Sequence[int] = (),
        *,
        estimates: bool = False,
    ) -> None:
        self._estimates, self._cells = estimates, cells
        self._causes = [k for k, one in enumerate(considered) if one.sigma > 0.0]
        causes = [considered[k] for k in self._causes]
        half = base.grouping @ stated.prior_root
        self._active = np.flatnonzero(half.any(axis=0))
        held = [k for k, one in enumerate(causes) if one.effect in HELD]
        is_gain = np.array([one.effect in (*OF_GAIN, *HELD) for one in causes], np.bool_)
        of_friction = np.array([one.effect == "held_friction" for one in causes], np.bool_)
        own = np.array([one.axis for one in causes])[:, None] == np.arange(len(base.names))
        of_all = of_friction | np.array([one.is_common for one in causes], np.bool_)
        reads = np.array([one.row == name for one in causes for name in instruments], np.bool_)
        self._base, self._gains = base, np.setdiff1d(np.flatnonzero(is_gain), held)
        self._errors = RowErrors(
            half[:, self._active],
            stated.centre,
            np.array([one.sigma for one in causes]),
            np.where(is_gain, -1, self._causes).astype(int).tolist(),
            is_gain[:, None] & (reads.reshape(len(causes), len(instruments)) | of_all[:, None]),
            np.where(of_friction[:, None], own, base.of_bodies),
            held,
        )
        kinds_of = [Stated(one.key or one.name, _GAIN if one.effect == "scale" else one.effect) for one in causes]
        of_all[held] = False
        every = [*(columns[k] for k in self._active.tolist()), *kinds_of]
        self.stated = tuple(dict.fromkeys(every))
        self._key: IndexArray = np.array([self.stated.index(one) for one in every], np.intp)
        self._of_friction = np.array([one.kind == "held_friction" for one in self.stated], np.bool_)
        kinds = list(dict.fromkeys(one.kind for one in self.stated))
        self._kind: IndexArray = np.array([kinds.index(one.kind) for one in self.stated], np.intp)
        self._many = np.bincount(self._key).astype(np.float64)  # errors of each key
        of_causes = self._key[len(self._active) :]
        self._common = np.isin(np.arange(len(self.stated)), of_causes[of_all])
        as_stated = [one.effect.endswith("delay") for one in causes]
        self._free = ~self._common & ~np.isin(np.arange(len(self.stated)), of_causes[as_stated])

    def taken(
        self, stated: Taken, blocks: RowBlocks, mean: FloatArray, correlation: float, since_s: tuple[float, float]
    ) -> Taken:
        """What is taken for granted after the rows.

        Args:
            stated: what is, if nothing contradicts it.
            blocks: the rows.
            mean: the estimate by what is stated, (p,).
            correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
            since_s: when errors began to do to rows without the payload, and with it, what they do at the estimate.
                Where that is not so for most rows, gains are all that is looked at of instruments.
        """
        rows = ErrorEquations(blocks, self._errors, correlation, since_s)
        of_both = rows.least_share >= MOSTLY
        if rows.share < MOSTLY:
            rows = ErrorEquations(blocks, self._errors._replace(columns=[-1] * len(self._causes)), correlation)
        X, active = np.append(mean, np.zeros(len(self._causes))), len(self._active)
        n = len(self.stated)
        as_it_is = _Widths(np.ones(n), np.zeros(len(self._key)), np.zeros(n), np.ones(n))
        many = as_it_is
        for _ in range(ROUNDS):
            A, r = self._information(rows, X, many.width)
            many = self._settled(A, r, many.width, self._free)
            X = rows.at(many.errors)
        nothing, of_many = (self._evidence(A, r, each) for each in (as_it_is, many))
        one, of_one = as_it_is, nothing
        if self._common.any():
            by_factor = self._of_one_factor(rows, X, many.width)
            one = self._settled(*by_factor, as_it_is.width, self._common)
            of_one += self._evidence(*by_factor, one) - self._evidence(*by_factor, as_it_is)
        least = -np.log(ODDS)
        if max(of_many, of_one) - nothing < least:
            estimates = self._estimates and of_both
            return stated._replace(answer=self._answer(rows, many.errors)) if estimates else stated
        width = one.width if of_one - of_many > least else many.width
        said = self._contradicted(A, r, many) if width is many.width else ()
        factors = np.where(self._of_friction, np.sqrt(many.square), width)[self._key]
        considered, root = stated.considered.copy(), stated.prior_root.copy()
        root[:, self._active] *= factors[:active]
        considered[self._causes] *= factors[active:]
        if of_many - of_one < least and self._common.any():
            of_gains = self._errors.sigma[self._gains] * one.errors[active + self._gains]
            common = np.isin(self._gains, self._errors.common)
            factor = float(of_gains[common].sum() + of_gains[~common].mean())
            at = np.array(self._causes)[self._gains[common]]
            considered[at] = np.maximum(considered[at], abs(factor) / HALF)
            said += (f"all gains may be off by a common factor, by {abs(factor):.0%}",)
        covariance = self._base.covariance(root)
        rls = stated.rls.with_prior(stated.centre, covariance)
        return Taken(rls, considered, root, stated.centre, covariance, said)

    def _answer(self, rows: ErrorEquations, x: FloatArray) -> ByErrors:
        """Base parameters with all as stated; begins with the errors x."""
        rows, doubted = that_agree(rows, x, self._cells)
        (x, P), half = as_stated(rows, x), self._errors.half
        X, n = rows.at(x), half.shape[1]
        along, keys = half @ P[:n], [self.stated[k].key for k in self._key.tolist()]
        known = Mixture(np.ones(1), (self._errors.centre + half @ x[:n])[None], (along[:, :n] @ half.T)[None])
        return ByErrors(known, Causes(keys, np.ones(len(keys))), along, rows.shares(X, along.T), doubted)

    def _of_one_factor(self, rows: ErrorEquations, X: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same equations with a common factor of what is drawn, and about what: its error is then of any size.

        About an estimate that is far from the drawing, a factor would leave the bodies nothing.
        """
        X, p, common = X.copy(), len(self._errors.centre), self._errors.common
        X[:p] *= np.exp(X[p + common] @ self._errors.multiplied[common])
        X[p + common] = 0.0
        return self._information(rows, X, width, self._errors.centre)

    def _information(
        self, rows: ErrorEquations, X: FloatArray, width: FloatArray, scaled: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Information on the errors, in stated sigmas, and its right-hand side for errors about zero."""
        told = rows.information(X, rows.noise(X), scaled)
        colour = told.colour(width[self._key])
        return told.A / colour, told.r / colour

    def _settled(self, A: FloatArray, r: FloatArray, width: FloatArray, free: BoolArray) -> "_Widths":
        """Width of each key, of those that are free to change, and the errors with them, in stated sigmas."""
        every, one = np.bincount(self._kind, self._many), np.eye(len(A))
        square = np.ones(len(every))  # of each kind's scale
        for _ in range(ITERATIONS):
            w = width[self._key]
            C = np.linalg.inv(one + A * (w[:, None] * w))
            z = w * (C @ (w * r))
            E = np.bincount(self._key, z * z + w * w * np.maximum(np.diag(C), 0.0))
            weight = (FREEDOM + self._many) / (FREEDOM + E / square[self._kind])
            square = np.maximum(1.0, (FREEDOM + np.bincount(self._kind, weight * E)) / (FREEDOM + every))
            made = np.where(free, np.maximum(1.0, np.sqrt(square[self._kind] / weight)), width)
            change, width = float(np.abs(np.log(made[free] / width[free])).max()), made
            if change < _SETTLED:
                break
        paid = _students(E / square[self._kind], self._many) - _normal(E / width**2, self._many, weight)
        return _Widths(width, z, np.where(free, paid, 0.0), E.astype(np.float64))

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
    square: FloatArray  # (keys,) expected sum of squares of the errors


def _students(square: FloatArray, many: FloatArray) -> FloatArray:
    """Log density of ``many`` errors with a sum of squares, each of scale one."""
    whole = 0.5 * (FREEDOM + many)
    head = gammaln(whole) - gammaln(0.5 * FREEDOM) - 0.5 * many * np.log(np.pi * FREEDOM)
    return np.asarray(head - whole * np.log1p(square / FREEDOM), np.float64)


def _normal(square: FloatArray, many: FloatArray, weight: FloatArray) -> FloatArray:
    """The same of normal ones whose variance is one over ``weight``; ``square``: over that variance."""
    return np.asarray(-0.5 * many * np.log(2.0 * np.pi / weight) - 0.5 * square, np.float64)
