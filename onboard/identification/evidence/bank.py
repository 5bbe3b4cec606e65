"""Hypotheses that one thing is not as stated, weighed against each other and against "all as stated".

Each adds to the prior of some constants, of mean zero and covariance C, a term ``D D'``: an error of a scale, or of a
body in the drawing, that is far larger than stated. With the filter's mean x and covariance P at these constants, the
likelihood of a shift ``D t`` of the prior's mean is Gaussian in t, with gradient and information at zero

    g = U' x,   H = D' U - U' P U,   U = C^-1 D

so that for t of unit normal prior the evidence over that without it is, exactly for a linear model (Laplace, the term
with the determinant is Occam's)

    log B = g' M^-1 g / 2 - log |M| / 2,   M = 1 + H

and mean and covariance with it are ``x + P U M^-1 g`` and ``P + P U M^-1 U' P``. Nothing is solved anew, no tick is
kept; mean and covariance are computed of the few hypotheses that are asked for, evidence in
``onboard/native/src/evidence.c``. What a filter makes of a prior that has
such terms is taken back to "as stated" by the same rule with ``-(1 + D' U + U' P U)`` in place of M.
"""

import ctypes
import math
from collections.abc import Callable, Collection, Sequence
from itertools import accumulate, pairwise
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.estimation.arrays import FloatArray, IndexArray, eigen
from onboard.estimation.policy import FARTHEST_SIZE, LEAST_WEIGHT, LIKELIER
from onboard.identification.evidence.mixture import Known, Mixture
from onboard.native import library, structures

Judged = tuple[tuple[str, ...], tuple[str, ...]]  # reasons to refuse an answer, and to doubt it


class Suspect(NamedTuple):
    """One thing that may not be as stated, in one way."""

    name: str
    at: IndexArray  # (k,) places of the constants in the state
    along: FloatArray  # (k, r) what its errors do to these, one sigma each
    odds: float  # of it, against all being as stated, before the flight
    alike: bool = False  # data cannot distinguish it from the other suspects marked so


class Hypothesis(NamedTuple):
    """A suspect, and what follows if it is wrong."""

    suspect: Suspect | None  # None: all as stated
    numbers: tuple[int, ...]  # of it in the bank, two where two things are wrong
    weight: float  # probability, given that one of all hypotheses is true
    nats: float  # log of the evidence over that of "as stated", odds not counted
    size: float  # of its errors, in the sigmas of the suspect
    of: "Root | _Alone | Changed"  # its effect follows from these
    steps: tuple[int, ...] = ()  # numbers of these; empty: it is no step


class Root(NamedTuple):
    """Root of what a suspect adds to the covariance."""

    slopes: FloatArray  # (k, r) U at its constants
    whiten: FloatArray  # (r, r) of which the product with its transpose is M^-1
    g: FloatArray  # (r,) its gradient, so whitened

    def root(self, one: Hypothesis, covariance: FloatArray, part: slice) -> Known:
        """Of a part of the state: its gradient, (r,), and root, (n, r)."""
        assert one.suspect is not None
        return self.g, covariance[part, one.suspect.at] @ (self.slopes @ self.whiten)


class Changed(NamedTuple):
    """Steps in flight of one sigma each: the change of the state by each, and their evidence in the innovations."""

    D: FloatArray  # (p, m) true state less the filter's
    d: FloatArray  # (m,) gradient of the evidence by their sizes
    J: FloatArray  # (m, m) information of these
    step: FloatArray  # (p, c) what those of each time step; but for the payload, which is no suspect's

    @staticmethod
    def none(size: int) -> "Changed":
        """No steps, of a state of this size."""
        return Changed(np.zeros((size, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros((size, 0)))

    def evidence(self, suspects: Sequence[Suspect], farthest: float = np.inf) -> tuple[FloatArray, FloatArray]:
        """Of each two over that of none, and the logarithm of its weight, (n, n); on the diagonal of each alone.

        Args:
            suspects: n, of which the steps are, with one column each or several. Of two of which one has several it is
                none: they are not looked for.
            farthest: size from which on one of several has none, in its sigmas.
        """
        n, width = len(suspects), np.array([one.along.shape[1] for one in suspects], np.int64)
        most = int(width.max(initial=0))
        odds, work = np.log([one.odds for one in suspects]), np.empty(2 * most * (most + 1) + 1)
        d = library.given(self.d, int(width.sum()))
        J = library.given(self.J, len(d), len(d))
        pointers = (library.address(part) for part in (width, d, J, odds))
        out = np.empty((2, n, n))
        library.call("heft_pairs", n, len(d), *pointers, farthest, library.address(work), out=out)
        return out[0], out[1]

    def sizes(self, which: Sequence[int]) -> Known:
        """Of some steps, if these are there and no others: mean, (r,), and a root of the covariance, (r, r)."""
        if len(which) == 1:
            (k,) = which
            scale = 1.0 / np.sqrt(1.0 + max(self.J[k, k], 0.0))
            return np.array([self.d[k] * scale**2]), np.array([[scale]])
        at = np.asarray(which, np.intp)
        values, V = eigen(np.eye(len(at)) + self.J[at[:, None], at])
        root = V / np.sqrt(np.maximum(values, 1.0))  # rounding alone makes an information negative
        return root @ (root.T @ self.d[at]), root

    def root(self, one: Hypothesis, _: FloatArray, part: slice) -> Known:
        """Of steps and a part of the state: gradient, (r,), and root of what they add to the covariance, (n, r)."""
        (_, root), at = self.sizes(one.steps), [*one.steps]
        D = self.D[:, at]
        return root.T @ self.d[at], (D * root if len(at) == 1 else D @ root)[part]

    def hypotheses(
        self, suspects: Sequence[Suspect], *, every: bool = False, farthest: float = np.inf
    ) -> list[Hypothesis]:
        """Each step, and each two that are likelier than either and half of what follows; weights are one.

        ``every``: also those that together weigh less than :data:`.LEAST_WEIGHT` beside the likeliest; ``farthest`` is
        that of :meth:`evidence`.
        """
        nats, logs = self.evidence(suspects, farthest)
        columns, alone = columns_of(suspects), logs.diagonal()
        least = float(logs.max(initial=0.0)) + math.log(LEAST_WEIGHT)
        ones = (every | (alone > least - math.log(max(len(alone), 1)))).nonzero()[0].tolist()
        each = nats.diagonal().tolist()
        found = [self._hypothesis(suspects[k], columns[k], each[k]) for k in ones]
        second = np.maximum(alone, alone[:, None]) + math.log(LIKELIER)
        for k, other in zip(*(part.tolist() for part in (logs > np.maximum(second, least)).nonzero()), strict=True):
            if k < other:
                both = _both(suspects[k], suspects[other])
                found.append(self._hypothesis(both, columns[k] + columns[other], float(nats[k, other])))
        return found

    def _hypothesis(self, suspect: Suspect, which: Sequence[int], nats: float) -> Hypothesis:
        if len(which) == 1:
            (k,) = which
            size = abs(float(self.d[k])) / (1.0 + max(float(self.J[k, k]), 0.0))
        else:
            size = float(np.abs(self.sizes(which)[0]).max())
        return Hypothesis(suspect, (), 1.0, nats, size, self, (*which,))


def columns_of(suspects: Sequence[Suspect]) -> list[tuple[int, ...]]:
    """Numbers of the columns of each suspect among those of all."""
    ends = accumulate((one.along.shape[1] for one in suspects), initial=0)
    return [tuple(range(*pair)) for pair in pairwise(ends)]


class Weighed(NamedTuple):
    """All hypotheses, "as stated" first."""

    stated: Known
    every: tuple[Hypothesis, ...]

    def known(self, one: Hypothesis, part: slice = slice(None)) -> Known:
        """Mean and covariance of a part of the state if a hypothesis is true."""
        x, P = self.stated
        if one.suspect is None:
            return x[part], P[part, part]
        shift, root = self.effect(one, part)
        return x[part] + shift, P[part, part] + root @ root.T

    def across(self, one: Hypothesis, part: slice) -> FloatArray:
        """Covariance of a part of the state with all of it, (n, p), if a hypothesis is true."""
        P = self.stated[1]
        if one.suspect is None:
            return P[part]
        root = self.effect(one)[1]
        return P[part] + root[part] @ root.T

    def effect(self, one: Hypothesis, part: slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """Of a hypothesis with a suspect on a part of the state.

        Returns:
            By which the mean lies off that of "as stated", (n,), and the root of what is added to its covariance,
            (n, r).
        """
        g, root = one.of.root(one, self.stated[1], part)
        return root @ g, root

    @property
    def of_steps(self) -> "Weighed":
        """If nothing but steps may be wrong."""
        some = [one for one in self.every if one.suspect is None or one.steps]
        of_all = sum(one.weight for one in some)
        if not of_all > 0.0:  # all the others are likelier by far
            return self._replace(every=(self.every[0]._replace(weight=1.0),))
        return self._replace(every=tuple(one._replace(weight=one.weight / of_all) for one in some))

    @property
    def likeliest(self) -> Hypothesis:
        """The one of the largest weight."""
        return max(self.every, key=_WEIGHT)

    @property
    def contradicts(self) -> bool:
        """Whether a fault is more probable than the file as stated, and of a size that the suspects have."""
        return self.every[0].weight < LIKELIER and not self.too_far

    @property
    def too_far(self) -> str:
        """Name of the most probable fault if it is larger than :data:`FARTHEST_SIZE`; else empty."""
        one = self.likeliest
        return one.suspect.name if one.suspect is not None and one.size >= FARTHEST_SIZE else ""

    @property
    def counting(self) -> tuple[Hypothesis, ...]:
        """Hypotheses that an answer covers, the most probable first: all but what :data:`.LEAST_WEIGHT` leaves out."""
        first = sorted(self.every, key=_WEIGHT, reverse=True)
        left = 1.0 - np.cumsum([one.weight for one in first])
        return tuple(first[: 1 + int((left > LEAST_WEIGHT).sum())])

    @property
    def likely(self) -> tuple[Hypothesis, ...]:
        """Those of them that weigh as much by themselves."""
        return tuple(one for one in self.counting if one.weight >= LEAST_WEIGHT)

    @property
    def names(self) -> tuple[str, ...]:
        """Suspects that may be wrong, the most probable first; empty while the file as stated is more probable."""
        if self.every[0].weight >= LIKELIER:
            return ()
        return tuple(dict.fromkeys(one.suspect.name for one in self.likely if one.suspect is not None))

    @property
    def judged(self) -> Judged:
        """What the evidence says of an answer."""
        if self.too_far:
            return (f"{self.too_far} is farther from what is stated than any error that is estimated",), ()
        return (), (f"not as stated: {' or '.join(self.names)}",) if self.names else ()

    def mixed(self, part: Callable[[Hypothesis], Known]) -> Mixture:
        """Mixture of the hypotheses that an answer covers; ``part`` gives mean and covariance under each."""
        some = self.counting
        weights = np.array([one.weight for one in some])
        means, covariances = (np.array(each) for each in zip(*map(part, some), strict=True))
        return Mixture(weights / weights.sum(), means, covariances)


class Bank:
    """The hypotheses of one filter.

    Args:
        suspects: one at most of which is wrong.
        sigma: (p,) of the state, as stated; of the suspects' constants finite and positive.

    Attributes:
        at: places of all suspects' constants in the state.
        spanned: those of which every error, in whatever direction, is one of a suspect.
    """

    def __init__(self, suspects: Sequence[Suspect], sigma: FloatArray) -> None:
        self.suspects, self._size = tuple(suspects), len(sigma)
        self._alike = np.array([one.alike for one in suspects], np.bool_)
        self._log_odds = np.log([one.odds for one in suspects])
        ends = np.cumsum([0, *(one.along.shape[1] for one in suspects)]).tolist()
        every = np.zeros((len(sigma), ends[-1]))
        self._columns = [slice(*pair) for pair in pairwise(ends)]
        for one, own in zip(suspects, self._columns, strict=True):
            every[one.at, own] = one.along
        self.at: IndexArray = np.unique(np.concatenate([np.zeros(0, np.intp), *(one.at for one in suspects)]))
        whole = (one.at for one in suspects if np.linalg.matrix_rank(one.along) == len(one.at))
        self.spanned: IndexArray = np.unique(np.concatenate([np.zeros(0, np.intp), *whole]))
        self._of_all = every[self.at] / sigma[self.at, None] ** 2
        self._inner = np.eye(every.shape[1]) + every[self.at].T @ self._of_all
        self._slopes = [one.along / sigma[one.at, None] ** 2 for one in suspects]
        self._compiled, self._places = self._struct()
        fixed = [self.at, self.spanned, self._alike, self._log_odds, self._of_all, self._inner]
        fixed += [part for one in suspects for part in (one.at, one.along)]
        for part in (*fixed, *self._slopes):
            part.setflags(write=False)  # a checkpoint refers to it by name

    def freed(self, known: Known, which: Sequence[int]) -> Known:
        """Mean and covariance if every suspect of these numbers may be wrong."""
        return self._of_prior(known, which, -1.0)[0]

    def as_stated(self, freed: Known, which: Sequence[int]) -> Known:
        """Mean and covariance if nothing is wrong: the inverse of :meth:`freed`."""
        return self._of_prior(freed, which, 1.0)[0]

    def steps_freed(self, known: Known, which: Sequence[int], steps: Changed) -> Changed:
        """Steps, if every suspect of these numbers may be wrong, too."""
        return self._of_prior(known, which, -1.0, steps)[1]

    def steps_as_stated(self, freed: Known, which: Sequence[int], steps: Changed) -> Changed:
        """Steps, if nothing else is wrong: the inverse of :meth:`steps_freed`."""
        return self._of_prior(freed, which, 1.0, steps)[1]

    def _of_prior(
        self, known: Known, which: Sequence[int], sign: float, steps: Changed | None = None
    ) -> tuple[Known, Changed]:
        """Bayes' rule on the joint state and steps; the priors of the steps stay as they are."""
        (x, P), (U, inner) = known, self._of_these(which)
        D, d, J, step = steps or Changed.none(len(x))
        times = D.shape[1] // max(step.shape[1], 1)
        # a prior is that of constants before a step
        PU, own, along = P[:, self.at] @ U, U.T @ x[self.at], U.T @ (D - np.tile(step, times))[self.at]
        solved = np.linalg.solve(inner + sign * (U.T @ PU[self.at]), np.column_stack([PU.T, along]))
        gain, of_steps = solved[:, : len(x)], sign * solved[:, len(x) :]
        now = x - sign * (own @ gain), P - sign * (PU @ gain)
        return now, Changed(D - PU @ of_steps, d - own @ of_steps, J + along.T @ of_steps, step)

    def released(self, which: Sequence[int]) -> FloatArray:
        """Root of what these suspects, if each may be wrong, take off the information that is stated, (p, r)."""
        U, inner = self._of_these(which)
        root = np.zeros((self._size, len(inner)))
        root[self.at] = np.linalg.solve(np.linalg.cholesky(inner), U.T).T
        return root

    def _of_these(self, which: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """``U`` at all suspects' constants and ``1 + D' U`` of some suspects' columns."""
        columns = np.concatenate([np.arange(self._columns[k].start, self._columns[k].stop) for k in which])
        return self._of_all[:, columns], self._inner[np.ix_(columns, columns)]

    def nats(self, stated: Known, which: Sequence[int]) -> float:
        """Evidence of every suspect of these numbers being wrong, over that of none of all."""
        (x, P), (U, inner) = stated, self._of_these(which)
        M, g = inner - U.T @ P[np.ix_(self.at, self.at)] @ U, U.T @ x[self.at]
        values, V = eigen(M)
        values = np.maximum(values, 1.0)  # below one by rounding
        return float(0.5 * ((V.T @ g) ** 2 / values).sum() - 0.5 * np.log(values).sum())

    def weigh(
        self,
        stated: Known,
        steps: Sequence[Hypothesis] = (),
        beyond: FloatArray | float = 0.0,
    ) -> Weighed:
        """All hypotheses; where a fault is more probable than the file as stated, also pairs of probable faults.

        Args:
            stated: mean and covariance if nothing is wrong.
            steps: further hypotheses.
            beyond: nats of each suspect that its evidence in this linear model does not have.
        """
        found, pairs = self.alone(stated), list[Hypothesis]()
        logs, n = np.append(0.0, self._log_weights(found) + beyond), len(self.suspects)
        likeliest = int(logs.argmax()) - 1
        if np.logaddexp.reduce(logs) > -np.log(LIKELIER) and likeliest >= 0 and found.sizes[likeliest] < FARTHEST_SIZE:
            counting = np.flatnonzero(logs[1:] > logs.max() + np.log(LEAST_WEIGHT))
            for first in counting.tolist():
                if found.sizes[first] < FARTHEST_SIZE:
                    both, more = self._pairs(first, found, stated, {one.numbers for one in pairs})
                    pairs += both
                    logs = np.append(logs, logs[1 + first] + np.array(more))
        of_steps = [one.nats + math.log(one.suspect.odds) for one in steps if one.suspect is not None]
        logs = np.concatenate([logs, of_steps])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        every = [Hypothesis(None, (), float(weights[0]), 0.0, 0.0, _NONE)]
        numbers = zip(*(part.tolist() for part in (weights[1 : 1 + n], found.nats, found.sizes)), strict=True)
        for k, (one, (weight, nats, size)) in enumerate(zip(self.suspects, numbers, strict=True)):
            every.append(Hypothesis(one, (k,), weight, nats, size, found))
        added = zip([*pairs, *steps], weights[1 + n :].tolist(), strict=True)
        every += [one._replace(weight=weight) for one, weight in added]
        return Weighed(stated, tuple(every))

    def _struct(self) -> tuple[structures.BankStruct, list[tuple[slice, slice]]]:
        """The suspects for the compiled core, and where it puts the root and the gradient of each."""
        count, width = (np.array([one.along.shape[k] for one in self.suspects], np.int64) for k in (0, 1))
        at = np.concatenate([np.zeros(0, np.int64), *(one.at for one in self.suspects)])
        slopes = np.concatenate([np.zeros(0), *(slope.ravel() for slope in self._slopes)])
        numbers = self._size, len(self.suspects), len(self._inner), len(at)
        made = structures.BankStruct(*numbers, count, width, library.indices(at, self._size), slopes, self._inner)
        for part in (count, width, at, slopes):
            part.setflags(write=False)
        ends = accumulate((part for r in width.tolist() for part in (r * r, r)), initial=2 * len(self.suspects))
        parts = [slice(*pair) for pair in pairwise(ends)]
        return made, list(zip(parts[::2], parts[1::2], strict=True))

    def alone(self, stated: Known, first: int = -1, given: tuple[FloatArray, ...] = ()) -> "_Alone":
        """Each suspect by itself, or beside the first, of which root and gradient are given."""
        p, n = self._size, len(self.suspects)
        known = library.given(stated[0], p), library.given(stated[1], p, p)
        end, r = self._places[-1][1].stop if n else 0, len(given[1]) if given else 0
        out = np.empty(end + r * len(self._inner))
        pointers = [library.address(part) for part in (*known, *(given or (None, None)))]
        library.call("heft_alone", ctypes.byref(self._compiled), *pointers[:2], first, *pointers[2:], out=out)
        return _Alone(out[:n], out[n : 2 * n], out, self._places, out[end:].reshape(-1, r or 1), self._slopes)

    def _log_weights(self, found: "_Alone") -> FloatArray:
        """Logarithms of the weights of suspects over that of none of them."""
        nats = found.nats.copy()
        nats[self._alike] = nats[self._alike].max(initial=-np.inf)  # they differ only by the linearisation
        return np.asarray(nats + self._log_odds, np.float64)

    def _pairs(
        self, first: int, alone: "_Alone", stated: Known, known: Collection[tuple[int, ...]]
    ) -> tuple[list[Hypothesis], list[float]]:
        """Pairs of the first suspect with each other whose odds, given the first, are above one half; log weights.

        The weights are relative to the first's. The second, given the first, is weighed by its columns projected off
        those of the first (the Schur complement in M), so that the evidence of both is the sum of the two. A fault
        without evidence is not added to another: a cell's scale beside a wrong base mass would widen every answer.
        """
        (root, g), nats, size = alone.of(first), float(alone.nats[first]), float(alone.sizes[first])
        one, given = self.suspects[first], self.alone(stated, first, (root, g))
        pairs, logs, weights = list[Hypothesis](), list[float](), self._log_weights(given)
        for k in ((weights >= np.log(LIKELIER)) & (given.sizes < FARTHEST_SIZE)).nonzero()[0].tolist():
            if k == first or (k, first) in known:
                continue
            other, r, (own, more) = self.suspects[k], len(g), given.of(k)
            whiten = block_diag(root, own)
            whiten[:r, r:] = -root @ given.onto[self._columns[k]].T @ own
            sizes = nats + float(given.nats[k]), max(size, float(given.sizes[k]))
            parts = block_diag(self._slopes[first], self._slopes[k]), whiten, np.concatenate([g, more])
            pairs.append(Hypothesis(_both(one, other), (first, k), 1.0, *sizes, Root(*parts)))
            logs.append(float(weights[k]))
        return pairs, logs


def _both(one: Suspect, other: Suspect) -> Suspect:
    """Two that may be wrong together."""
    name, at = " and ".join(dict.fromkeys([one.name, other.name])), np.concatenate([one.at, other.at])
    return Suspect(name, at, block_diag(one.along, other.along), one.odds * other.odds)


class _Alone(NamedTuple):
    """Suspects, each by itself or beside another one, not weighed: see :class:`Hypothesis`."""

    nats: FloatArray  # (n,)
    sizes: FloatArray  # (n,)
    out: FloatArray  # what the compiled core has put
    places: Sequence[tuple[slice, slice]]  # there of ``whiten`` and ``g``
    onto: FloatArray  # (R, r) columns of all along those of the other one
    slopes: Sequence[FloatArray]  # U of each at its constants

    def root(self, one: Hypothesis, covariance: FloatArray, part: slice) -> Known:
        """As :meth:`Root.root`."""
        (which,) = one.numbers
        return Root(self.slopes[which], *self.of(which)).root(one, covariance, part)

    def of(self, which: int) -> tuple[FloatArray, FloatArray]:
        """``whiten`` and ``g`` of one, see :class:`Root`."""
        root, g = (self.out[part] for part in self.places[which])
        return root.reshape(len(g), len(g)), g


_NONE = Root(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
_WEIGHT = attrgetter("weight")
