"""One estimate of several, of which one is right: the mixture by their weights."""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF
from onboard.identification.evidence.mixture import REPORTED, Mixture
from onboard.identification.quantities import Estimate, QuantityEstimate


def mixed(estimates: Sequence[Estimate], weights: FloatArray) -> Estimate:
    """Mean, sigma and intervals of the mixture of Gaussians that have the intervals of the estimates.

    What one of them does not determine is not supported. Names, notes and counts of rows are the first's.

    Args:
        estimates: of the same parameters and quantities.
        weights: probability of each, (k,), of sum one.
    """
    first = estimates[0]
    parameters = _Mixed([(one.mean, one.low, one.high) for one in estimates], weights)
    supported = np.all([one.supported for one in estimates], axis=0)
    columns = ("value", "low", "high")
    numbers = [[np.array([getattr(q, name) for q in one.quantities]) for name in columns] for one in estimates]
    of_quantities = _Mixed([(mean, low, high) for mean, low, high in numbers], weights)
    quantities = [
        of_quantities.quantity(k, [one.quantities[k] for one in estimates]) for k in range(len(first.quantities))
    ]
    told = parameters.sigma, parameters.low, parameters.high, supported, tuple(quantities)
    return Estimate(first.names, parameters.mean, *told, first.rows_used, first.refused)


class _Mixed:
    """Of means with the ends of their intervals, (n,) of each of k estimates; NaN where one of these is not finite."""

    def __init__(self, each: Sequence[tuple[FloatArray, FloatArray, FloatArray]], weights: FloatArray) -> None:
        means = np.array([mean for mean, _, _ in each])
        halves = np.array([np.maximum(high - mean, mean - low) for mean, low, high in each])
        self._determined = np.isfinite(means).all(axis=0) & np.isfinite(halves).all(axis=0)
        n, one = means.shape[1], np.where(self._determined, means, 0.0)
        variances = np.where(self._determined, (halves / HALF) ** 2, 1.0)
        mixture = Mixture(weights, one, variances[:, :, None] * np.eye(n))
        mean, covariance = mixture.known
        lower, upper, *self._outer = mean + mixture.ends(np.eye(n), REPORTED)
        self.mean, self.sigma = self._or_nan(mean), self._or_nan(np.sqrt(np.diag(covariance)))
        self.low, self.high = self._or_nan(lower), self._or_nan(upper)

    def _or_nan(self, numbers: FloatArray) -> FloatArray:
        return np.where(self._determined, numbers, np.nan)

    def quantity(self, k: int, of_each: Sequence[QuantityEstimate]) -> QuantityEstimate:
        """The k-th; whatever else it has, notes say, is of the estimate that determines it least."""
        least = min(of_each, key=lambda one: (one.supported, -one.shrinkage))
        if not least.supported:
            return least
        mean, sigma, low, high = (float(part[k]) for part in (self.mean, self.sigma, self.low, self.high))
        ends = float(self._outer[0][k]), float(self._outer[1][k])
        return least._replace(value=mean, sigma=sigma, low=low, high=high, own_outer=ends)
