"""One payload from several flights: maximum likelihood with what is common to them, and what is each one's own.

Common are the payload, the links, the joints and the constants of the instruments; the rate at the start and the biases
are each flight's own. The likelihood is that of :mod:`onboard.identification.whole_flight.fit` of every flight, so
that an error common to them all is estimated once and not averaged away. In every Gauss-Newton step a flight's own
unknowns are eliminated from its normal equations: with o its own, c the common ones and prior information L about zero,

    S = N_cc - N_co (N_oo + L_oo)^-1 N_oc,    s = g_c - N_co (N_oo + L_oo)^-1 (g_o + L_oo x_o),

and the step is ``d = -(L_cc + sum S)^-1 (L_cc x_c + sum s)``: flights that determine nothing by themselves count for
what they tell.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import ITERATIONS, MINIMUM, inverse_of
from onboard.identification.corrections import Chance
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.whole_flight.blocks import NormalEquations, misfit_by_instrument, total_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.parts import PAYLOAD, score_of

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
