"""Chi-squared tests of what a fit found against what was said of it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import FloatArray


@dataclass(frozen=True)
class Chance:
    """A sum of squares that is chi-squared if what was said is so."""

    squares: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability of so large a sum; 1 where nothing was compared."""
        return float(chdtrc(self.freedom, self.squares)) if self.freedom else 1.0


def score_of(gradient: FloatArray, own: FloatArray, spread: FloatArray, least: float) -> tuple[float, int]:
    """:func:`squares_of` of a score, (k,), with covariance ``spread``, in units of its own information's roots.

    Args:
        gradient: the score.
        own: its information, (k, k).
        spread: covariance, of the same unit.
        least: variance, as a share of the information.
    """
    scale = np.sqrt(np.maximum(np.diag(own), np.finfo(np.float64).tiny))
    return squares_of(gradient / scale, spread / np.outer(scale, scale), least)


def squares_of(gap: FloatArray, covariance: FloatArray, least: float) -> tuple[float, int]:
    """``g' S^-1 g`` over the principal directions of S with a variance above ``least``, and their number.

    Args:
        gap: g, (k,).
        covariance: S of g, (k, k), scaled so that its largest variances are about one.
        least: variance.
    """
    values, vectors = np.linalg.eigh(covariance)
    told = values > least
    return float(((vectors[:, told].T @ gap) ** 2 / values[told]).sum()), int(np.count_nonzero(told))
