"""Chi-squared tests of what a fit found against what was said of it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import FloatArray

_DETERMINED = 1e-6  # share of a score's information that is its own, in a direction that counts: less is rounding


@dataclass(frozen=True)
class Chance:
    """A sum of squares that is chi-squared if what was said is so."""

    squares: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability of so large a sum; 1 where nothing was compared."""
        return float(chdtrc(self.freedom, self.squares)) if self.freedom else 1.0


def score_of(gradient: FloatArray, own: FloatArray, spread: FloatArray) -> tuple[float, int]:
    """``g' S^-1 g`` over the principal directions of S that are not rounding, and their number, in units of ``own``.

    Args:
        gradient: g, the score, (k,).
        own: its information, (k, k).
        spread: S, its covariance.
    """
    scale = np.sqrt(np.maximum(np.diag(own), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
    told = values > _DETERMINED
    return float(((vectors[:, told].T @ (gradient / scale)) ** 2 / values[told]).sum()), int(np.count_nonzero(told))
