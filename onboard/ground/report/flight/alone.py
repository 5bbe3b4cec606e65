"""Estimate of each sweep by itself, from the logged states of the estimator.

A growing least squares adds information, and the logged triangle ``[R z]`` is its square root. So the information of
the rows between two states is ``T' T`` of the later minus that of the earlier, exactly; with the prior it gives the
estimate of those rows alone, and the parts between neighbouring states are the blocks of its jackknife interval. Rows
are not recomputed. Unlike on board, the regressor's noise is not corrected, as it is not in the log.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray, eigen
from onboard.estimation.recursive.consistency import BlockScores, JackknifeEstimate
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.ground.report.flight.flight_data import SweepData
from onboard.identification.quantities import SUPPORTED_FREEDOM, SUPPORTED_SHRINKAGE
from onboard.identification.rows.identifier import Identifier


class Alone(NamedTuple):
    """A quantity from the rows of one sweep, up to several instants in it; NaN where they do not determine it."""

    name: str
    unit: str
    at_ns: NDArray[np.int64]  # (n,) vehicle time
    value: FloatArray  # (n,)
    low: FloatArray
    high: FloatArray


def alone(sweep: SweepData, identifier: Identifier) -> list[Alone]:
    """Every quantity of ``identifier`` by ``sweep`` alone, without those never determined.

    Args:
        sweep: sweep with the states of a growing least squares.
        identifier: identifier of the same vehicle without rows, for its prior and quantities.
    """
    size = identifier.rls.parameters + identifier.rls.considered + 1
    if not identifier.quantities or not sweep.states or len(sweep.states[0]["triangle"]) != size * (size + 1) // 2:
        return []
    start = identifier.rls.state().triangle if sweep.before is None else _square(sweep.before["triangle"], size)
    base = start.T @ start
    weights = np.vstack([quantity.weights for quantity in identifier.quantities])
    prior, right = identifier.rls.prior_equations()
    covariance = np.linalg.inv(prior)
    before = np.sqrt(np.einsum("ri,ij,rj->r", weights, covariance, weights))
    rls = SquareRootRls(identifier.rls.parameters, identifier.rls.considered)
    rls.prior(covariance @ right, covariance)
    blocks = BlockScores(identifier.rls.parameters, 1.0)
    at_ns = np.array([int(state["vehicle_ns"]) for state in sweep.states])
    values = np.full((3, len(at_ns), len(weights)), np.nan)
    for number, state in enumerate(sweep.states):
        triangle = _square(state["triangle"], size)
        rows = _root(triangle.T @ triangle - base)
        base = triangle.T @ triangle
        p = identifier.rls.parameters
        Y, C, y, sigma = rows[:, :p], rows[:, p:-1], rows[:, -1], np.ones(len(rows))
        rls.update(Y, y, sigma, C if C.shape[1] else None)
        blocks.add(np.full(len(rows), number + 0.5), Y, y, sigma)
        jackknife = JackknifeEstimate(rls, blocks, [cause.sigma for cause in identifier.considered])
        interval = jackknife.combination(weights)
        spread = np.maximum(interval.sigma, np.sqrt(jackknife.formal_variance(weights)))
        supported = (spread <= SUPPORTED_SHRINKAGE * before) & (interval.degrees_of_freedom >= SUPPORTED_FREEDOM)
        for part, found in zip(values, (interval.mean, interval.low, interval.high), strict=True):
            part[number] = np.where(supported, found, np.nan)
    return [
        Alone(quantity.name, quantity.unit, at_ns, *values[:, :, column])
        for column, quantity in enumerate(identifier.quantities)
        if np.isfinite(values[0, -1, column])
    ]


def _square(packed: FloatArray, size: int) -> FloatArray:
    triangle = np.zeros((size, size))
    triangle[np.triu_indices(size)] = packed
    return triangle


def _root(information: FloatArray) -> FloatArray:
    """Rows (r, size) with ``rows' rows = information``; eigenvalues negative by rounding are left out."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale[scale == 0.0] = 1.0
    values, vectors = eigen(information / np.outer(scale, scale))
    real = values > 1e-12 * max(values[-1], 0.0)
    rows: FloatArray = (vectors[:, real] * np.sqrt(values[real])).T * scale
    return rows
