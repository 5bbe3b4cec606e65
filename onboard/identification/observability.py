"""Observability: combinations of base parameters determined by a motion, and the others in words."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import MOSTLY
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
