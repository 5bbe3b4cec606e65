"""Essential parameters: base parameters significantly different from zero.

A base parameter that is small compared with its sigma has no information and widens the intervals of the others. Pham
and Gautier (1991) remove the one with the largest relative sigma, estimate again, and repeat until all remaining ones
are significant. Here the criterion is a test of each parameter against zero at 95 %, so that the result does not depend
on the precision of the best-known parameter.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF


class Essential(NamedTuple):
    """Essential parameters and their estimate without the others."""

    kept: NDArray[np.bool_]  # (p,)
    order: tuple[int, ...]  # those left out, the worst known first
    mean: FloatArray  # (p,) zero for those left out
    sigma: FloatArray  # (p,) zero for those left out


def essential(mean: FloatArray, covariance: FloatArray) -> Essential:
    """Removes parameters one by one, largest relative sigma first (Pham and Gautier 1991).

    Removing one is conditioning the Gaussian estimate on its being zero, which needs no data rows.

    Args:
        mean: estimate of the base parameters, (p,).
        covariance: its covariance, (p, p).
    """
    x, C = mean.astype(np.float64), covariance.astype(np.float64)
    kept = np.ones(x.size, np.bool_)
    order: list[int] = []
    while (asked := np.flatnonzero(kept)).size:
        away = np.abs(x[asked]) / np.sqrt(np.diag(C)[asked])
        worst = int(asked[np.argmin(away)])
        if away.min() >= HALF:
            break
        gain = C[:, worst] / C[worst, worst]
        x = x - gain * x[worst]
        C = C - np.outer(gain, C[worst])
        x[worst] = C[worst, :] = C[:, worst] = 0.0
        kept[worst] = False
        order.append(worst)
    return Essential(kept, tuple(order), x, np.sqrt(np.maximum(np.diag(C), 0.0)))
