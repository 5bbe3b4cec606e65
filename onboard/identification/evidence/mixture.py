"""Mixture of Gaussians: the answer under several hypotheses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import INTERVAL, LEAST_WEIGHT, tails

Known = tuple[FloatArray, FloatArray]  # mean, (p,), and covariance, (p, p)
REPORTED = *tails(1.0 - INTERVAL), *tails(LEAST_WEIGHT)
"""Probabilities of less than the ends of the interval that is reported, and of the 99.9 % one."""
_HALVINGS = 12  # of what a quantile lies in


class Mixture(NamedTuple):
    """A mixture of Gaussians."""

    weights: FloatArray  # (k,), of sum one
    means: FloatArray  # (k, p)
    covariances: FloatArray  # (k, p, p)

    @property
    def known(self) -> Known:
        """Its mean and covariance."""
        mean = self.weights @ self.means
        apart = self.means - mean
        return mean, np.tensordot(self.weights, self.covariances, 1) + (self.weights * apart.T) @ apart

    def wider(self, covariance: FloatArray) -> "Mixture":
        """With a doubt of this covariance, (p, p), common to all."""
        return self._replace(covariances=self.covariances + covariance)

    def beside(self, others: Sequence[tuple[float, FloatArray, FloatArray]]) -> "Mixture":
        """With other hypotheses, each by its probability, the shift of its mean, (p,), and a root of its covariance.

        Both are relative to this one: the shift is of its mean, the root, (p, r), of what is added to its covariance.
        """
        if not others:
            return self
        mean, covariance = self.known
        weights, shifts, added = zip(*((w, shift, root @ root.T) for w, shift, root in others), strict=True)
        of_self = (1.0 - sum(weights)) * self.weights
        means = np.concatenate([self.means, mean + np.array(shifts)])
        return Mixture(np.append(of_self, weights), means, np.concatenate([self.covariances, covariance + added]))

    def or_else(self, other: "Mixture") -> "Mixture":
        """It, or another one, of which it is not known which is right."""
        both = zip(self._replace(weights=0.5 * self.weights), other._replace(weights=0.5 * other.weights), strict=True)
        return Mixture(*(np.concatenate(pair) for pair in both))

    def ends(self, along: FloatArray, below: ArrayLike) -> FloatArray:
        """Quantiles of linear functions of it, (q, m), about their means.

        Args:
            along: the functions, (m, p).
            below: probability of less than each quantile, (q,); rounded away from the median by a few thousandths of
                the distance between the same quantiles of the Gaussians.
        """
        apart, sigma = self._of(along)
        share = np.asarray(below, np.float64)[:, None]
        each = apart + ndtri(share)[..., None] * sigma  # (q, k, m)
        if len(self.weights) == 1:
            return np.asarray(each[:, 0], np.float64)
        low, high = each.min(axis=1), each.max(axis=1)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            less = np.einsum("k,qkm->qm", self.weights, ndtr((middle[:, None] - apart) / sigma)) < share
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return np.asarray(np.where(share < 0.5, low, high), np.float64)

    def half_widths(self, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of linear functions of it, half of what contains 95 %, and 99.9 %, about its mean, (m,) each.

        A large error of low probability hardly changes the variance, but determines the 99.9 % interval: of two
        Gaussians of one sigma, the second with weight 0.01 and ten sigmas away, 99.9 % lie within 11.5 sigmas of the
        mean, and 3.29 times the root of the variance is 4.6.

        Args:
            along: the functions, (m, p).
        """
        ends = np.abs(self.ends(along, REPORTED))
        return np.maximum(ends[0], ends[1]), np.maximum(ends[2], ends[3])

    def shares(self, along: FloatArray, ends: FloatArray) -> FloatArray:
        """Of what lies beyond intervals of linear functions, the share of each Gaussian, (k, m).

        Args:
            along: the functions, (m, p).
            ends: lower and upper ends about their means, (2, m).
        """
        apart, sigma = self._of(along)
        each = self.weights[:, None] * (ndtr((ends[0] - apart) / sigma) + ndtr((apart - ends[1]) / sigma))
        return np.asarray(each / each.sum(axis=0), np.float64)

    def _of(self, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Means about that of the mixture, and sigmas, of the functions under each Gaussian, (k, m)."""
        apart = (self.means - self.weights @ self.means) @ along.T
        return apart, np.sqrt(np.einsum("ij,kjl,il->ki", along, self.covariances, along))
