"""Parts of a flight held against each other, and one payload from several flights: maximum likelihood.

Common to several are the payload, the links, the joints and the constants of the instruments; the rate at the start and
the biases are each flight's own. The likelihood is that of :mod:`onboard.identification.whole_flight.fit` of every
flight, so that an error common to them all is estimated once and not averaged away. In every Gauss-Newton step a
flight's own unknowns are eliminated from its normal equations: with o its own, c the common ones and prior information
L about zero,

    S = N_cc - N_co (N_oo + L_oo)^-1 N_oc,    s = g_c - N_co (N_oo + L_oo)^-1 (g_o + L_oo x_o),

and the step is ``d = -(L_cc + sum S)^-1 (L_cc x_c + sum s)``: flights that determine nothing by themselves count for
what they tell.

Whether parts of a flight that was fitted as a whole agree follows from its normal equations (no further prediction).
With r and J of some rows at the estimate x, N = J' J and g = J' r, a change of the parameters by d makes their residual
sum ``r' r + 2 g' d + d' N d``. Two questions are asked of this:

- *another payload* in a part (score test; Cox and Hinkley, Theoretical Statistics, 1974, section 9.3): if the payload
  differed by e in these rows only, all other unknowns common, then ``S e = -g_p`` with
  ``S = N_pp - N_p. P N_.p`` (P: covariance of the fit), and ``g_p' S^-1 g_p`` is chi-squared where it does not differ;
- *prediction* of one half of the held time from the other, with rates and biases of the predicted half re-estimated.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import FloatArray, IndexArray, eigen
from onboard.estimation.errors import ConvergenceError, SingularError
from onboard.estimation.maximum_likelihood import ITERATIONS, MINIMUM, Normal, inverse_of
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.corrections import Chance
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.whole_flight.blocks import FlightFit, NormalEquations, misfit_by_instrument, total_of
from onboard.identification.whole_flight.fit import WholeFlight

PAYLOAD = slice(0, 10)
_DETERMINED = 1e-6  # share of a score's information that is its own, in a direction that counts: less is rounding


def score_of(gradient: FloatArray, own: FloatArray, spread: FloatArray, misfit: float) -> Chance:
    """``g' S^-1 g`` over the principal directions of S that are not rounding, and their number, in units of ``own``.

    Args:
        gradient: g, the score, (k,).
        own: its information, (k, k).
        spread: S, its covariance.
        misfit: of the fit, by which the sum is less where it is above one.
    """
    scale = np.sqrt(np.maximum(np.diag(own), np.finfo(np.float64).tiny))
    values, vectors = eigen(spread / np.outer(scale, scale))
    told = values > _DETERMINED
    squares = float(((vectors[:, told].T @ (gradient / scale)) ** 2 / values[told]).sum())
    return Chance(squares / max(1.0, misfit), int(np.count_nonzero(told)))


def differences(found: FlightFit, phases: Callable[[float], int]) -> dict[str, Chance]:
    """Score tests of the later half of the held time, of each instrument but the first, and of each phase.

    Args:
        found: the fit.
        phases: code of the phase at a time, s.
    """
    held = [block for block in found.blocks if block.held]
    middle_s = _middle(held)
    parts = {"the later half of the motion": [block for block in held if block.middle_s > middle_s]}
    for name in list(dict.fromkeys(block.instrument for block in held))[1:]:
        parts[f"the {name}"] = [block for block in held if block.instrument == name]
    for code in sorted({phases(block.middle_s) for block in held})[1:]:
        parts[f"phase {code}"] = [block for block in held if phases(block.middle_s) == code]
    return {part: _difference(found, rows) for part, rows in parts.items()}


def halves(flight: WholeFlight, found: FlightFit) -> HeldOut:
    """Prediction of each half of the held time from the other one and all that was flown free.

    The relative error is that of the residual over that without a payload.

    Raises:
        SingularError: a half that determines too little.
    """
    x, prior = found.fit.x, flight.prior_information
    bare = flight.without_payload(x)
    held, free = ([block for block in found.blocks if block.held == wanted] for wanted in (True, False))
    middle_s = _middle(held)
    predicted = []
    for later in (True, False):
        own = [block for block in held if (block.middle_s > middle_s) == later]
        none = sum(squares for at_s, squares in bare if (at_s > middle_s) == later)
        other = [block for block in held if (block.middle_s > middle_s) != later]
        if not own or not other:
            raise SingularError("the payload was not held for long enough to be divided into halves")
        known = total_of([*other, *free], x.size).plus(Normal(prior, prior @ x, 0.0))
        away = -inverse_of(_without_rates_elsewhere(known.information, flight)) @ known.gradient
        predicted.append(_prediction(total_of(own, x.size), x, away, flight, none, own))
    of_all, rows = total_of(held, x.size).squares, sum(block.rows for block in held)
    later_half, earlier_half = predicted
    return HeldOut(
        later_half,
        earlier_half,
        HeldOutFit(float(np.sqrt(of_all / sum(squares for _, squares in bare))), of_all / rows),
    )


def _prediction(
    rows: Normal, x: FloatArray, away: FloatArray, flight: WholeFlight, none: float, blocks: Sequence[NormalEquations]
) -> HeldOutFit:
    """Residual of rows at ``x + away`` with what is specific to a part of the flight re-estimated there."""
    anew, prior = flight.of_a_part, np.diag(flight.prior_information)
    tried = x + away
    tried[anew] = x[anew]
    start = tried - x
    gradient = rows.gradient + rows.information @ start
    information = _without_rates_elsewhere(rows.information + np.diag(prior), flight)
    step = -inverse_of(information[np.ix_(anew, anew)]) @ (gradient[anew] + prior[anew] * x[anew])
    start[anew] += step
    squares = max(0.0, rows.squares + float(2.0 * rows.gradient @ start + start @ rows.information @ start))
    return HeldOutFit(float(np.sqrt(squares / none)), squares / sum(block.rows for block in blocks))


def _without_rates_elsewhere(information: FloatArray, flight: WholeFlight) -> FloatArray:
    """Information that is not singular where it holds nothing of the rates at the start of segments, (p, p)."""
    own = flight.of_a_part[information[flight.of_a_part, flight.of_a_part] == 0.0]
    information = information.copy()
    information[own, own] = 1.0
    return information


def _difference(found: FlightFit, rows: Sequence[NormalEquations]) -> Chance:
    """How far the payload of these rows is from that of the rest."""
    if not rows or len(rows) == len(found.blocks):
        return Chance()
    some = total_of(rows, found.fit.x.size)
    across = some.information[PAYLOAD]  # (10, p)
    own = across[:, PAYLOAD]
    S = own - across @ found.fit.covariance @ across.T
    noise = np.zeros(found.fit.x.size)
    for block in rows:
        noise[block.columns] += block.noise
    doubt = across @ found.correction.sigma - NOISE_SIGMA * noise[PAYLOAD]
    S += np.outer(doubt, doubt)
    return score_of(some.gradient[PAYLOAD], own, S, found.misfit)


def _middle(blocks: Sequence[NormalEquations]) -> float:
    """Time that halves the rows of blocks."""
    return float(np.median([block.middle_s for block in blocks])) if blocks else 0.0


_HALVINGS = 6


class _Reduced(NamedTuple):
    """A flight at an estimate, its own unknowns eliminated."""

    S: FloatArray  # (c, c)
    s: FloatArray  # (c,)
    squares: float  # at the estimate, its own unknowns' prior included
    gained: float  # by their step
    step: FloatArray  # (o,) of its own for no change of the common ones
    by_common: FloatArray  # (o, c) change of its own for a change of these
    blocks: tuple[NormalEquations, ...]


class Pooled(NamedTuple):
    """The payload of all flights."""

    payload: BodyEstimate  # in the payload link's frame
    chi: FloatArray  # (10,) standard parameters
    chi_covariance: FloatArray  # (10, 10)
    misfit: float  # residual sum over its degrees of freedom
    by_instrument: dict[str, float]
    disagreements: tuple[Chance, ...]  # how far the payload of each flight is from that of all
    held_out: HeldOut | None  # later flights from earlier ones and the reverse; None of a single one
    rows: int


class Pool:
    """Flights of one vehicle with one payload, held in all of their segments.

    Args:
        flights: with the same instruments.
    """

    def __init__(self, flights: Sequence[WholeFlight]) -> None:
        self._flights, one = tuple(flights), flights[0]
        self._common = np.setdiff1d(np.arange(one.constants), one.of_a_part).astype(np.intp)
        self._prior = np.nan_to_num(1.0 / one.sigma[self._common] ** 2)

    def fit(self, starts: Sequence[FloatArray], best: FloatArray) -> Pooled:
        """The estimate.

        Args:
            starts: parameters of each flight, (p,), of which its own are used.
            best: parameters of one, of which the common ones are used.

        Raises:
            ConvergenceError, SingularError: flights that determine too little, or contradict each other.
            SignalError: a payload without a mass.
        """
        x, z = [start.copy() for start in starts], best[self._common]
        for flight, one in zip(self._flights, x, strict=True):
            one[self._common] = z
            flight.weigh(one)
        parts = self._reduced(x)
        for _ in range(ITERATIONS):
            information = np.diag(self._prior) + sum(part.S for part in parts)
            gradient = self._prior * z + sum(part.s for part in parts)
            d = -inverse_of(information) @ gradient
            promised = float(-gradient @ d) + sum(part.gained for part in parts)
            x, z, parts = self._moved(x, z, d, parts)
            if promised < MINIMUM:
                return self._pooled(x, z, parts)
        raise ConvergenceError(f"the flights together did not converge in {ITERATIONS} steps")

    def _moved(
        self, x: list[FloatArray], z: FloatArray, d: FloatArray, parts: list[_Reduced]
    ) -> tuple[list[FloatArray], FloatArray, list[_Reduced]]:
        """After a step, or the largest half, quarter ... of it that makes the residual sum no larger."""
        before = self._cost(z, parts)
        for k in range(_HALVINGS):
            share = 0.5**k
            moved = [one.copy() for one in x]
            for one, flight, part in zip(moved, self._flights, parts, strict=True):
                one[flight.of_a_part] += share * (part.step + part.by_common @ d)
                one[self._common] = z + share * d
            found = self._reduced(moved)
            if self._cost(z + share * d, found) <= before + MINIMUM:
                return moved, z + share * d, found
        raise ConvergenceError("no step of all flights together makes their residuals smaller")

    def _cost(self, z: FloatArray, parts: Sequence[_Reduced]) -> float:
        return float(self._prior @ z**2) + sum(part.squares for part in parts)

    def _reduced(self, x: Sequence[FloatArray]) -> list[_Reduced]:
        return [_reduced(flight, one, self._common) for flight, one in zip(self._flights, x, strict=True)]

    def _pooled(self, x: list[FloatArray], z: FloatArray, parts: list[_Reduced]) -> Pooled:
        P = inverse_of(np.diag(self._prior) + sum(part.S for part in parts))
        blocks = [block for part in parts for block in part.blocks]
        rows = sum(block.rows for block in blocks)
        unknown = int((self._prior == 0.0).sum()) + 3 * sum(len(flight.segments) for flight in self._flights)
        misfit = self._cost(z, parts) / max(1, rows - unknown)
        return Pooled(
            body_estimate(z[:10], P[PAYLOAD, PAYLOAD]),
            z[:10],
            P[PAYLOAD, PAYLOAD],
            misfit,
            misfit_by_instrument(blocks),
            tuple(_disagreement(part, P, misfit) for part in parts),
            self._halves(x, z, parts),
            rows,
        )

    def _halves(self, x: Sequence[FloatArray], z: FloatArray, parts: Sequence[_Reduced]) -> HeldOut | None:
        """Prediction of the later flights from the earlier ones, and the reverse."""
        if len(parts) < 2:
            return None
        bare = [sum(s for _, s in f.without_payload(one)) for f, one in zip(self._flights, x, strict=True)]
        squares = [sum(block.normal.squares for block in part.blocks) for part in parts]
        rows, middle = [sum(block.rows for block in part.blocks) for part in parts], (len(parts) + 1) // 2
        predicted = []
        for own in (slice(middle, None), slice(0, middle)):
            others = [part for k, part in enumerate(parts) if k not in range(len(parts))[own]]
            known = np.diag(self._prior) + sum(part.S for part in others)
            a = -inverse_of(known) @ (self._prior * z + sum(part.s for part in others))
            more = sum(float(2.0 * part.s @ a + a @ part.S @ a) for part in parts[own])
            left = max(0.0, sum(squares[own]) + more)
            predicted.append(HeldOutFit(float(np.sqrt(left / sum(bare[own]))), left / sum(rows[own])))
        fit = HeldOutFit(float(np.sqrt(sum(squares) / sum(bare))), sum(squares) / sum(rows))
        return HeldOut(predicted[0], predicted[1], fit)


def _reduced(flight: WholeFlight, x: FloatArray, common: IndexArray) -> _Reduced:
    blocks, own = tuple(flight.blocks(x)), flight.of_a_part
    rows, prior = total_of(blocks, x.size), np.nan_to_num(1.0 / flight.sigma[own] ** 2)
    A = rows.information[np.ix_(own, own)] + np.diag(prior)
    A[np.diag_indices_from(A)] += np.where(np.diag(A) > 0.0, 0.0, 1.0)  # a rate that no row shows
    across, g = rows.information[np.ix_(common, own)], rows.gradient[own] + prior * x[own]
    inverse = inverse_of(A)
    step, by_common = -inverse @ g, -inverse @ across.T
    S = rows.information[np.ix_(common, common)] + across @ by_common
    return _Reduced(
        0.5 * (S + S.T),
        rows.gradient[common] + across @ step,
        rows.squares + float(prior @ x[own] ** 2),
        float(-g @ step),
        step,
        by_common,
        blocks,
    )


def _disagreement(part: _Reduced, P: FloatArray, misfit: float) -> Chance:
    """Score test: does the payload of one flight differ, all else common?"""
    across = part.S[PAYLOAD]
    own = across[:, PAYLOAD]
    return score_of(part.s[PAYLOAD], own, own - across @ P @ across.T, misfit)
