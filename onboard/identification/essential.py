"""Essential parameters: base parameters significantly different from zero.

A base parameter that is small compared with its sigma has no information and widens the intervals of the others. Pham
and Gautier (1991) remove the one with the largest relative sigma, estimate again, and repeat until all remaining ones
are significant. Here the criterion is a test of each parameter against zero at 95 %, so that the result does not depend
on the precision of the best-known parameter.
"""

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import HALF


def essential(mean: FloatArray, covariance: FloatArray) -> BoolArray:
    """Those left when parameters are removed one by one, largest relative sigma first (Pham and Gautier 1991), (p,).

    Removing one is conditioning the Gaussian estimate on its being zero, which needs no data rows.

    Args:
        mean: estimate of the base parameters, (p,).
        covariance: its covariance, (p, p).
    """
    x, C = mean.astype(np.float64), covariance.astype(np.float64)
    kept = np.ones(x.size, np.bool_)
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
    return kept
