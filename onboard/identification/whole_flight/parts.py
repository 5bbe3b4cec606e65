"""Agreement of parts of a flight that was fitted as a whole, from its normal equations (no further prediction).

With r and J of some rows at the estimate x, N = J' J and g = J' r, a change of the parameters by d makes their residual
sum ``r' r + 2 g' d + d' N d``. Two questions are asked of this:

- *another payload* in a part (score test; Cox and Hinkley, Theoretical Statistics, 1974, section 9.3): if the payload
  differed by e in these rows only, all other unknowns common, then ``S e = -g_p`` with
  ``S = N_pp - N_p. P N_.p`` (P: covariance of the fit), and ``g_p' S^-1 g_p`` is chi-squared where it does not differ;
- *prediction* of one half of the held time from the other, with rates and biases of the predicted half re-estimated.
"""

from collections.abc import Callable, Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import SingularError
from onboard.estimation.maximum_likelihood import Normal, inverse_of
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.corrections import Chance
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.whole_flight.blocks import FlightFit, NormalEquations, total_of
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
    values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
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
