"""Scales of load cells that are estimated: their columns are what each cell should read."""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.recursive.rls import SquareRootRls

_ROUNDS = 2


def fill_scales(
    rls: SquareRootRls,
    scales: Sequence[tuple[int, int]],
    Y: FloatArray,
    measured: FloatArray,
    sigma: FloatArray,
    use: BoolArray,
) -> None:
    """Fills the columns of the scales with what the sensors should read.

    A scale multiplies its reading, so the rows are linear for a given prediction only. The prediction is that of the
    estimate with these very rows taken in on trial: it must not be the one of a payload not yet known.

    Args:
        rls: the estimate before these rows.
        scales: row and column of each.
        Y: t ticks' rows, the known part last, (t, rows, p + 1): changed in place.
        measured: (t, rows).
        sigma: (t, rows).
        use: which rows, (t, rows).
    """
    before, trial = rls.state(), SquareRootRls(rls.parameters, rls.considered)
    C = np.zeros((np.count_nonzero(use), rls.considered)) if rls.considered else None
    unscaled, columns = Y.copy(), [column for _, column in scales]
    unscaled[..., columns] = 0.0
    for _ in range(_ROUNDS):
        trial.restore(before)
        trial.update(Y[..., :-1][use], (measured - Y[..., -1])[use], sigma[use], C)
        predicted = unscaled @ [*trial.solve().mean, 1.0]  # (t, rows)
        for row, column in scales:
            Y[:, row, column] = predicted[:, row]


def estimated_scales(
    names: Sequence[str], scales: Sequence[tuple[int, int]], mean: FloatArray, prior_covariance: FloatArray
) -> dict[str, float]:
    """The scales by name, in sigmas of their prior.

    Args:
        names: of the parameters, p.
        scales: row and column of each.
        mean: the estimate, (p,).
        prior_covariance: of the parameters, (p, p).
    """
    sigma = np.sqrt(np.diag(prior_covariance))
    return {names[column]: float(mean[column] / sigma[column]) for _, column in scales}
