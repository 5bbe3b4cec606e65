"""Errors of an arm with all as stated, and which one explains all of its rows, by the sums over them.

Rows are linear about the motion as it was read. What a hypothesis that moves angles, or the level, leaves over here
tells nothing, then: rows that are made again about it judge it (:mod:`onboard.identification.rows.checks.suspects`).
Delays of encoders are as stated: their columns are of derivatives, whose noise is not that of the rows.
"""

from collections.abc import Callable, Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import FARTHEST_SIZE, MISFIT_PART, MISFIT_REFUSED
from onboard.identification.evidence.bank import Bank, Weighed
from onboard.identification.evidence.mixture import Known
from onboard.identification.rows.stated_errors.equations import ErrorEquations

ROUNDS, SETTLED = 6, 0.1  # of Gauss and Newton; sigmas of the change in one


def explained(
    rows: ErrorEquations, bank: Bank, x: FloatArray, linear: Callable[[Weighed], bool] = lambda weighed: True
) -> tuple[Weighed, FloatArray | None, float]:
    """All hypotheses by the rows, and whether the likeliest, of something wrong, explains these.

    First all is as stated; then the likeliest of those hypotheses is followed whose size a linear model explains.

    Args:
        rows: of an arm.
        bank: suspects in its state.
        x: an estimate to begin with, (s,).
        linear: whether rows are linear in the error of the likeliest; what is left over of one in which they are not
            tells nothing.

    Returns:
        The hypotheses; what the scatter of blocks adds to the covariance, (s, s), None where what is stated is
        likelier, or more is left over than is doubted of noise; and the largest misfit of an instrument with all as
        stated.
    """
    stated, noise = _settled(rows, x, rows.noise(rows.at(x)))
    x, as_it_is = stated, float(rows.misfits(rows.at(stated)).max())
    weighed, colour = _weighed(rows, bank, x, noise)
    likely = max((one for one in weighed.every if one.size < FARTHEST_SIZE), key=lambda one: one.weight)
    if likely.suspect is not None:
        x, noise = _settled(rows, x, noise, bank, likely.numbers[:1])
        weighed, colour = _weighed(rows, bank, x, noise)
    misfit = rows.misfit(rows.at(x), rows.at(stated))
    too_much = linear(weighed) and (colour > MISFIT_REFUSED or misfit > MISFIT_PART)
    if not weighed.contradicts or too_much:
        return weighed, None, as_it_is
    x, P = weighed.known(weighed.likeliest)
    return weighed, rows.information(rows.at(x), colour * noise).scatter(P), as_it_is


def as_stated(rows: ErrorEquations, x: FloatArray) -> Known:
    """State with all as stated, and its covariance with what the scatter of blocks adds; begins with the estimate x."""
    x, noise = _settled(rows, x, rows.noise(rows.at(x)))
    told = rows.information(rows.at(x), noise)
    colour = told.colour()
    x, P = told.known(colour)
    return x, P + rows.information(rows.at(x), colour * noise).scatter(P)


def that_agree(rows: ErrorEquations, x: FloatArray, cells: Sequence[int]) -> tuple[ErrorEquations, int | None]:
    """The rows, those of the one cell counting as one that contradicts all others with all as stated, and its number.

    Where none does, or the others contradict each other too: all rows, as they are.

    Args:
        rows: of an arm.
        x: an estimate to begin with, (s,).
        cells: which instruments may be doubted.
    """
    x, _ = _settled(rows, x, rows.noise(rows.at(x)))
    misfits = rows.misfits(rows.at(x))
    worst = int(misfits.argmax())
    if worst not in cells or misfits[worst] <= MISFIT_PART:
        return rows, None
    doubted = rows.doubting(worst)
    left = doubted.misfits(doubted.at(as_stated(doubted, x)[0])) > MISFIT_PART
    return (doubted, worst) if left[worst] and left.sum() == 1 else (rows, None)


def _settled(
    rows: ErrorEquations, x: FloatArray, noise: FloatArray, bank: Bank | None = None, which: tuple[int, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Estimate and noise where Gauss and Newton end, with all as stated or under the suspect of a bank of this number.

    They end at once where the suspect becomes larger than a linear model explains.
    """
    for _ in range(ROUNDS):
        before, louder, (x, P) = x, noise, rows.information(rows.at(x), noise).known()
        if bank is not None:
            weighed = bank.weigh((x, P))
            one = next(one for one in weighed.every if one.numbers == which)
            if one.size >= FARTHEST_SIZE:
                return before, noise
            x, P = weighed.known(one)
        noise = np.minimum(noise, rows.noise(rows.at(x)))
        moved = float((np.abs(x - before) / np.sqrt(np.diag(P))).max())
        if moved < SETTLED and np.allclose(noise, louder, rtol=SETTLED):
            break
    return x, noise


def _weighed(rows: ErrorEquations, bank: Bank, x: FloatArray, noise: FloatArray) -> tuple[Weighed, float]:
    """All hypotheses about an estimate, information divided by its colour, and that."""
    told = rows.information(rows.at(x), noise)
    colour = told.colour()
    return bank.weigh(told.known(colour)), colour
