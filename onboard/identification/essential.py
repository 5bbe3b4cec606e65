"""Essential parameters: those that the data tell from nothing.

A base parameter that is small beside its own sigma says nothing, and while it stays in the model it widens the
intervals of the others. Pham and Gautier (1991) leave out the one that is known worst, estimate again, and go on until
all that stay are known well. Here "well" is the test of one parameter against zero at 95 %, so that the number of
parameters that stay does not depend on how well the best of them is known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray

SIGNIFICANT = 1.96  # a parameter stays that is so many of its sigmas from zero


class Essential(NamedTuple):
    """What stays, and what it is estimated at without the rest."""

    kept: NDArray[np.bool_]  # (p,)
    order: tuple[int, ...]  # those left out, the worst known first
    mean: FloatArray  # (p,) zero for those left out
    sigma: FloatArray  # (p,) zero for those left out


def essential(mean: FloatArray, covariance: FloatArray, held: NDArray[np.bool_] | None = None) -> Essential:
    """Leaves out one parameter after the other, the one with the largest relative sigma first.

    Leaving one out is estimating again with it known to be zero, which for Gaussian estimates needs no row of the data.

    Args:
        mean: estimate of the base parameters, (p,).
        covariance: its covariance, (p, p).
        held: (p,) parameters that stay whatever comes: the offset of a sensor, say.
    """
    x, C = mean.astype(np.float64), covariance.astype(np.float64)
    kept = np.ones(x.size, np.bool_)
    stays = np.zeros(x.size, np.bool_) if held is None else held
    order: list[int] = []
    while (asked := np.flatnonzero(kept & ~stays)).size:
        away = np.abs(x[asked]) / np.sqrt(np.diag(C)[asked])
        worst = int(asked[np.argmin(away)])
        if away.min() >= SIGNIFICANT:
            break
        gain = C[:, worst] / C[worst, worst]
        x = x - gain * x[worst]
        C = C - np.outer(gain, C[worst])
        x[worst] = C[worst, :] = C[:, worst] = 0.0
        kept[worst] = False
        order.append(worst)
    return Essential(kept, tuple(order), x, np.sqrt(np.maximum(np.diag(C), 0.0)))
