"""Tests fitted corrections of instruments and links against their stated sigmas.

Under the stated sigmas each is standard normal and their sum of squares is chi-squared. One that is too large, or an
improbable sum, means a changed calibration or an error without a parameter. How large depends on how many there are: of
a hundred the largest lies beyond three sigmas by chance in one healthy flight of four. A test of the largest is refused
and doubted as often as any other (:mod:`onboard.estimation.policy`).

The estimate of a correction about zero has the sigma ``(prior variance - posterior variance)^(1/2)`` (Hausman,
Econometrica 46, 1978). Data that tell less of it than its stated sigma move it by less than that sigma, however wrong
it is; in sigmas of what they tell, it is seen. Where the noise's variance is f times what the fit took it for, and g
the share of its stated variance that the data take away, its variance is ``g^2 + f g (1 - g)`` of what is stated
(derived here).

An error without a parameter, as slosh, is taken up by many corrections at once, none of them far. Together, in stated
sigmas, they have the covariance A = I - posterior, and ``z' A^-1 z`` is chi-squared. Data tell next to nothing of most
directions, where A is singular: ``z' (A + e I)^-1 z`` weighs a direction of which they tell a by w = a / (a + e). It is
``sum w^2 / sum w`` times a chi-squared of ``(sum w)^2 / sum w^2`` degrees of freedom, nearly (Satterthwaite, 1946).
These are ``sum w`` at least, which is at least ``sum a / (1 + e)``: no more squares than that, of one degree or more,
are no more than expected.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dtrsv
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import chdtrc, chdtri

from onboard.estimation.arrays import ROUNDING, FloatArray
from onboard.estimation.policy import DOUBT, MISFIT_DOUBTED, MISFIT_REFUSED, REFUSE, of_each, sigmas

DOUBTFUL = sigmas(of_each(DOUBT))  # of one
LEAST_TOLD = 0.05  # of a correction's prior variance: what the data must tell of it at least to be compared


class Chance(NamedTuple):
    """A sum of squares that is chi-squared if all is as stated."""

    squares: float = 0.0
    freedom: float = 0  # degrees of it

    @property
    def chance(self) -> float:
        """Probability of so large a sum; 1 where nothing was compared."""
        return float(chdtrc(self.freedom, self.squares)) if self.freedom else 1.0

    def text(self, part: str, others: str) -> str:
        """``the load_cell tells another payload than the rest (chi-squared 90 of 6)``."""
        return f"{part} tells another payload than {others} (chi-squared {self.squares:.0f} of {self.freedom:.0f})"


class Together(Chance):
    """All corrections held against what the data tell of them."""

    @property
    def widening(self) -> float:
        """Factor on variances: the squares over what they exceed as rarely as one does :data:`DOUBTFUL` sigmas."""
        usual = float(chdtri(self.freedom, float(chdtrc(1, DOUBTFUL**2)))) if self.freedom else np.inf
        return max(1.0, self.squares / usual)

    def refused(self) -> tuple[str, ...]:
        """Reason of refusal; empty if there is none."""
        return (self._text,) if self.chance < of_each(REFUSE) else ()

    def doubted(self) -> tuple[str, ...]:
        """Reason for a weak verdict; empty if there is none, or one of refusal."""
        return (self._text,) if of_each(REFUSE) <= self.chance < of_each(DOUBT) else ()

    @property
    def _text(self) -> str:
        times = (self.squares / self.freedom) ** 0.5
        return (
            f"all corrections together are {times:.1f} times what is stated of them: "
            "slosh, a flexible joint, or something that has changed"
        )


def together(corrections: FloatArray, posterior: FloatArray) -> Together:
    """Squares of all corrections, in what the data tell of them: this module's head.

    Args:
        corrections: (k,) in stated sigmas.
        posterior: (k, k) covariance of their errors, in stated sigmas.

    Returns:
        Chi-squared and its degrees of freedom, of no more squares than expected the squares and the least degrees;
        none where the posterior is wider than what is stated, or the data tell of none.
    """
    k = len(corrections)
    if not k:
        return Together()
    told = -posterior.T  # LAPACK's order; A + e I
    told.flat[:: k + 1] += 1.0 + LEAST_TOLD
    L, failed = dpotrf(told, lower=True, overwrite_a=True)
    if failed:  # some of them have a wider prior for now than what is stated
        return Together()
    solved = dtrsv(L, corrections, lower=True)
    squares, least = float(solved @ solved), (k - float(posterior.trace())) / (1.0 + LEAST_TOLD)
    if least >= 1.0 and squares <= least:  # nothing is improbable, and the inverse takes five times as long
        return Together(squares, least)
    inverse = dpotri(L, lower=True, overwrite_c=True)[0]  # its lower triangle, zeros above
    own = np.diag(inverse)
    trace = float(own.sum())
    mean = k - LEAST_TOLD * trace  # sum of the weights a / (a + e)
    of_all = 2.0 * float(np.vdot(inverse, inverse)) - float(own @ own)
    square = k - 2.0 * LEAST_TOLD * trace + LEAST_TOLD**2 * of_all
    if mean < ROUNDING * k:
        return Together()
    return Together(squares * mean / square, mean * mean / square)


def expected_sigma(prior: FloatArray, posterior: FloatArray, wider: float = 1.0) -> FloatArray:
    """Sigma that a correction's estimate about zero should have, from its variances: this module's head.

    Args:
        prior: (k,) as stated.
        posterior: (k,) after the fit.
        wider: factor on the noise's variance.
    """
    told = np.maximum(prior - posterior, LEAST_TOLD * prior)
    return np.asarray(np.sqrt(told * (wider + (1.0 - wider) * told / prior)), np.float64)


def too_large(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reasons of refusal for corrections by name, in stated sigmas; empty if both tests (this module's head) pass."""
    if not corrections:
        return ()
    each = np.abs(list(corrections.values()))
    worst = int(each.argmax())
    if each[worst] > refused_from(len(each)):
        name = list(corrections)[worst]
        return (f"{name} had to be corrected by {each[worst]:.0f} of its stated sigmas: it has changed, or is not so",)
    squares = float(each @ each)
    if chdtrc(len(each), squares) < of_each(REFUSE):
        return (f"corrections are larger than stated: squares of {len(each)} of them sum to {squares:.0f} sigmas",)
    return ()


def contradicted(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reason of refusal for corrections by name, in sigmas of what the data tell of each; empty if all are small."""
    name, away = max(corrections.items(), key=lambda one: abs(one[1]), default=("", 0.0))
    if abs(away) <= refused_from(len(corrections)):
        return ()
    return (f"the motion contradicts what is stated of {name} by {abs(away):.0f} sigmas: it has changed, or is not so",)


def doubtful_from(count: int) -> float:
    """Sigmas beyond which the largest of ``count`` corrections is doubted: this module's head."""
    return sigmas(of_each(DOUBT, count))


def refused_from(count: int) -> float:
    """Sigmas beyond which the largest of ``count`` corrections is refused: this module's head."""
    return sigmas(of_each(REFUSE, count))


def doubtful(corrections: Mapping[str, float], scale: str = "of its stated sigmas") -> tuple[str, ...]:
    """Reasons for a weak verdict: corrections that are larger than chance makes of so many; ``scale``: words of it."""
    low, high = doubtful_from(len(corrections)), refused_from(len(corrections))
    return tuple(
        f"{name} had to be corrected by {abs(away):.1f} {scale}"
        for name, away in corrections.items()
        if low < abs(away) <= high
    )


def misfit_text(instrument: str, misfit: float) -> str:
    """Words of the mean square of an instrument's residuals, over its noise."""
    return f"residuals of the {instrument} are {misfit**0.5:.1f} times its noise"


def misfit_texts(misfits: Iterable[tuple[str, float]]) -> tuple[list[str], list[str]]:
    """Reasons of refusal, and for a weak verdict, by the mean squares of residuals over the noise, by instrument."""
    large = [(misfit, misfit_text(name, misfit)) for name, misfit in misfits if misfit > MISFIT_DOUBTED]
    refused = [text for misfit, text in large if misfit > MISFIT_REFUSED]
    return refused, [text for misfit, text in large if misfit <= MISFIT_REFUSED]
