"""What decides: how often a healthy flight may be doubted or refused by chance, and what may be wrong before a flight.

Limits by chance, and the odds and sizes of faults, are here, each with its source; floors of physics and limits of
convergence stand where they are used. So does a limit by chance that is not of the budget: from which on a kind of
correction is doubted, in a fit of the whole flight (:mod:`onboard.identification.whole_flight.witnesses`).

A flight's answer is put to several tests, and a test looks several times: at each correction, instrument, block or
reading. Each look has the chance that keeps that of any alarm within the budget (Šidák, J. Am. Stat. Assoc. 62, 1967).
A limit in sigmas is such a chance, of a normal's two sides.
"""

import math
from functools import lru_cache

import numpy as np
from scipy.special import gammainc, ndtri

LIKELY_SIZE = 0.1
"""One sigma of a wrong scale, of a wrong zero or mounting angle in rad, or of a wrong body: propellant used, a part
exchanged, a knocked load cell. The fault classes of the accuracy campaigns go from 1 to 20 %."""
LIKELY_DELAY_s = 0.01
"""One sigma of a wrong delay: one step of the slower control loops that read encoders, 100 Hz."""
LIKELY_PLACE_m = 0.01
"""One sigma of each coordinate of a joint or IMU that is off the drawing: an additional bracket, spacer or flange."""
FARTHEST_SIZE = 3.0
"""In these sigmas; chance exceeds it in 0.3 % of the cases. A larger error is of another kind (a dead cell, a wrong
sign, half the gain) that no linear model explains: an instrument with such an error is left out entirely."""
LARGEST_SIZE = FARTHEST_SIZE * LIKELY_SIZE
"""Of such an error: a calibration, or an edge of a rig, that is farther off is a wrong unit, sign, range or part."""
ODDS = 1e-2
"""Prior odds that a body, or an instrument's scale, is so wrong, against the file as stated: one flight in a hundred.
The hypothesis becomes the more probable one from 4.6 nats of evidence on."""
ODDS_OF_PART = 2e-3
"""Prior odds of a link, of all links of the arm, of an encoder or an IMU. They hold no consumables and are not opened
between the balance and the flight; what remains is a part exchanged or drawn wrong."""
ODDS_OF_ALL = 3e-3
"""Prior odds that all masses of the file are wrong by one factor: one balance for all of them, or a wrong unit. Motion
and a load cell cannot distinguish it from a scale of that cell: an interval that covers one covers both."""
LEAST_WEIGHT = 1e-3
"""Hypotheses of less probability are left out of the answers: a 99.9 % interval leaves out as much."""
LIKELIER = 0.5
"""Below this probability of the file as stated, the likely faults are named and no answer is rated good."""
STEPS_PER_HOUR = 0.1
"""Rate of steps of a load cell's scale, and of its zero, in flight: a knock, a connector. It equals the rate at which
a change may be detected falsely; a step in the minute of a flight then has the odds of an instrument's part,
:data:`ODDS_OF_PART`."""
DOUBT = 1e-2
"""Healthy flights of an hour that are doubted: as many as have a body or an instrument that is not as stated
(:data:`ODDS`), so that half of the doubts are right."""
REFUSE = 1e-4
"""Healthy flights that are refused: a hundredth of those in which something is wrong, so that 99 of 100 refusals are
right where all that is wrong is refused."""
TESTS = 6
"""That one answer is put to at most: residuals of each instrument, slow ones, lines in them, the largest correction,
all together, and instruments or parts of the flight against each other."""
DOUBLINGS = 12
"""Looks of a test that refuses an estimate by all rows so far, which is a new one when they have doubled: so often in
an hour, from a second on. A doubt is taken back where the next estimate is as stated: it looks once."""
INTERVAL = 0.95
"""Probability of the intervals that are reported: GUM (JCGM 100:2008, 6.3)."""
MISFIT_DOUBTED = 1.3
"""Mean square of residuals over what is stated: below it intervals are 14 % too narrow at most; 95 % are 91."""
MISFIT_REFUSED = 2.0
"""The same where as much is left over besides the noise as by the noise: such intervals hold 83 %."""
MISFIT_PART = MISFIT_REFUSED**2
"""The same of some of the readings, judged alone: a kind of rows, or what is slow; and of a search's result before it
is fitted on. What is stated of the noise of all may be as wrong as :data:`MISFIT_REFUSED` of a part of them."""
MOST_CONTRADICTED = 0.05
"""Share of readings that contradict the others, beyond which no answer is to be used: good data hold 1 to 10 % gross
errors (Hampel et al., Robust Statistics, 1986, section 1.2)."""
MOSTLY = 0.5
"""Share from which on something is most of it: of the ticks, an instrument that is there and takes part; of the power
of a channel, a line; of what is left over, what a reason names; of what is refused, a doubt."""
MOST_SHARE = 0.9
"""Of one, that what is divided by the rest may have: a leverage, a correlation, noise in an information. What is off by
a tenth of it is off by the whole of the rest."""
AGAIN = 1.2
"""Growth of the data after which what is costly is done again: sigmas have fallen by 9 %, less than they scatter."""


@lru_cache(maxsize=256)
def of_each(budget: float, looks: float = 1.0) -> float:
    """Chance of one look of a test that looks so many times at a flight: ``1 - (1 - budget)^(1 / (TESTS looks))``."""
    return float(-np.expm1(np.log1p(-budget) / (TESTS * max(looks, 1.0))))


def too_often(changes: int, within_s: float) -> bool:
    """Whether so many changes, of :data:`STEPS_PER_HOUR`, are within such a time of a flight more than is by chance."""
    by_chance = gammainc(changes, STEPS_PER_HOUR * within_s / 3600.0)  # Poisson: so many, or more
    return bool(by_chance < of_each(REFUSE, 3600.0 / within_s))


@lru_cache(maxsize=256)
def sigmas(chance: float) -> float:
    """Standard deviations that a normal is farther from its mean than, on either side, with a chance."""
    return float(-ndtri(0.5 * chance))


def contradicted_text(share: float, of: str = "rows", then: str = "") -> str:
    """Why no answer is to be used where such a share of readings contradicts the others; empty where few do.

    Args:
        share: of the readings, 0 to 1.
        of: what readings are called.
        then: what to do about it, or what it looks like; to check the sensors, where not given.
    """
    then = then or "check the sensors against each other"
    return f"{share:.0%} of the {of} contradict the others; {then}" if share > MOST_CONTRADICTED else ""


def times_text(nats: float) -> str:
    """How much likelier by so much evidence: ``7.39``, ``1e+12``."""
    digits = nats / math.log(10.0)
    return f"{math.exp(nats):.3g}" if digits < 3.0 else f"1e+{digits:.0f}"


READING = of_each(DOUBT, 1e6)
"""Chance of a single reading, tick or row by which it is left out: a million of them come in an hour, 300 a second."""
HALF = sigmas(1.0 - INTERVAL)
"""Standard deviations in half of an interval of :data:`INTERVAL`."""


def tails(outside: float) -> tuple[float, float]:
    """Probabilities of less than the lower and upper end of a central interval that leaves so much out."""
    return 0.5 * outside, 1.0 - 0.5 * outside


def wider() -> float:
    """Half a 99.9 % interval of a normal over that of 95 %."""
    return sigmas(LEAST_WEIGHT) / HALF
