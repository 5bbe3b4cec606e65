"""Observability: combinations of base parameters determined by a motion, the others in words, and essential parameters.

Essential are base parameters significantly different from zero. A base parameter that is small compared with its sigma
has no information and widens the intervals of the others. Pham and Gautier (1991) remove the one with the largest
relative sigma, estimate again, and repeat until all remaining ones are significant. Here the criterion is a test of
each parameter against zero at 95 %, so that the result does not depend on the precision of the best-known parameter.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import HALF, MOSTLY
from onboard.estimation.recursive.rls import Observability
from onboard.identification.quantities import SUPPORTED_SHRINKAGE

_GAIN = 1.0 / SUPPORTED_SHRINKAGE**2 - 1.0  # information over the prior's at which a direction counts as determined


class ObservedDirections(NamedTuple):
    """Directions determined by the rows relative to the prior."""

    determined: int  # directions
    of: int
    condition: float  # of the rows over the determined directions, in units of the prior
    undetermined: tuple[str, ...]  # the other directions, the least determined first; shares in units of the prior


def observed_directions(seen: Observability, names: Sequence[str]) -> ObservedDirections:
    """Directions of :meth:`SquareRootRls.observability`, determined (sigma at most a fifth of the prior's) or not.

    Args:
        seen: of the estimator after its rows.
        names: of the base parameters.
    """
    fine = seen.gain >= _GAIN
    spread = np.sqrt(seen.gain[-1] / seen.gain[fine][0]) if fine.any() else np.nan
    shares = seen.directions / np.linalg.norm(seen.directions, axis=1, keepdims=True)
    said = tuple(_words(shares[:, k], names) for k in np.flatnonzero(~fine))
    return ObservedDirections(int(fine.sum()), fine.size, float(spread), said)


def _words(share: FloatArray, names: Sequence[str]) -> str:
    """``0.8 XX_arm_R - 0.5 XZ_arm``; a direction along one parameter is that parameter."""
    largest = np.abs(share).max()
    order = [k for k in np.argsort(-np.abs(share)) if abs(share[k]) > MOSTLY * largest]
    if len(order) == 1:
        return str(names[order[0]])
    share = share / (np.linalg.norm(share) * np.sign(share[order[0]]))
    first, *rest = order
    text = f"{share[first]:.2g} {names[first]}"
    return text + "".join(f" {'+' if share[k] > 0 else '-'} {abs(share[k]):.2g} {names[k]}" for k in rest)


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
