"""How often a healthy flight may be doubted or refused by chance, and how much of that one look at it may spend.

A flight's answer is put to several tests, and a test looks several times: at each correction, instrument, block or
reading. Each look has the chance that keeps that of any alarm within the budget (Šidák, J. Am. Stat. Assoc. 62, 1967),
whether or not the looks are independent of each other. A limit in sigmas is such a chance, of a normal's two sides.
"""

import numpy as np
from scipy.special import ndtri

DOUBT = 1e-2
"""Healthy flights of an hour that are doubted: as many as have a body or an instrument that is not as stated
(:data:`onboard.identification.evidence.policy.ODDS`), so that half of the doubts are right."""
REFUSE = 1e-4
"""Healthy flights that are refused: a hundredth of those in which something is wrong, so that 99 of 100 refusals are
right where all that is wrong is refused."""
TESTS = 6
"""That one answer is put to at most: residuals of each instrument, slow ones, lines in them, the largest correction,
all together, and instruments or parts of the flight against each other."""
INTERVAL = 0.95
"""Probability of the intervals that are told: GUM (JCGM 100:2008, 6.3)."""


def of_each(budget: float, looks: float = 1.0) -> float:
    """Chance of one look of a test that looks so many times at a flight: ``1 - (1 - budget)^(1 / (TESTS looks))``."""
    return float(-np.expm1(np.log1p(-budget) / (TESTS * max(looks, 1.0))))


def sigmas(chance: float) -> float:
    """Standard deviations that a normal is farther from its mean than, on either side, with a chance."""
    return float(-ndtri(0.5 * chance))


READING = of_each(DOUBT, 1e6)
"""Chance of a single reading, tick or row by which it is left out: a million of them come in an hour, 300 a second."""
HALF = sigmas(1.0 - INTERVAL)
"""Standard deviations in half of an interval of :data:`INTERVAL`."""
