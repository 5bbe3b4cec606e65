"""On which stated sigmas an answer leans: those of the vehicle file that its own sigma would change with.

A shift of a prior's mean by one sigma s moves an estimate by its covariance P with that parameter over s; this is also
what the prior adds to its variance: ``dP / d(ln s) = 2 (P / s)^2``. Parameters of one key are summed as squares.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.quantities import SUPPORTED_SHRINKAGE

MEASURED = "noise of what was measured, and scatter beyond it"


class Contribution(NamedTuple):
    """A part of an answer's sigma."""

    cause: str  # a key of vehicle.toml, or what the data leave
    sigma: float  # in the unit of the answer
    share: float  # of the variance


class Causes:
    """The keys that answers may lean on.

    Args:
        keys: of each parameter; empty for what has none.
        sigma: stated, of each parameter, (p,).
        further: keys of which no parameter is; the last ones.

    Attributes:
        names: of the c keys.
        at: of each parameter's key among these; -1 for none.
    """

    def __init__(self, keys: Sequence[str], sigma: FloatArray, further: Sequence[str] = ()) -> None:
        stated = [key if np.isfinite(s) and s > 0.0 else "" for key, s in zip(keys, sigma.tolist(), strict=True)]
        self.names = (*dict.fromkeys(key for key in stated if key), *further)
        self.at = np.array([self.names.index(key) if key else -1 for key in stated], np.intp)
        self._of = np.zeros((len(keys), len(self.names)))
        some = np.flatnonzero(self.at >= 0)
        self._of[some, self.at[some]] = 1.0 / sigma[some] ** 2

    def effects(self, along: FloatArray) -> FloatArray:
        """What one sigma of each key does to some answers, (k, c); zero of those of which no parameter is.

        Args:
            along: covariance of the answers with each parameter, (k, p).
        """
        return np.asarray(np.sqrt(along**2 @ self._of), np.float64)

    def said(self, effects: FloatArray, sigma: FloatArray, size: FloatArray, most: int = 3) -> tuple[str, ...]:
        """Of each answer the keys that make up a good part of its sigma, with their effects in per cent; else empty.

        Args:
            effects: of each key, (k, c).
            sigma: of the answers, (k,).
            size: that effects are shown over, (k,); over zero they are not shown.
            most: keys that are said.
        """
        found = []
        for each, one, whole in zip(effects, sigma.tolist(), size.tolist(), strict=True):
            large = [c for c in np.argsort(-each)[:most].tolist() if each[c] > SUPPORTED_SHRINKAGE * one]
            told = ", ".join(self.names[c] + (f" ({100.0 * each[c] / whole:.2g} %)" if whole else "") for c in large)
            found.append(f"leans on {told}" if told else "")
        return tuple(found)

    def budget(self, effects: FloatArray, sigma: FloatArray) -> tuple[tuple[Contribution, ...], ...]:
        """Of each answer what its sigma is made of, the largest first; arguments as of :meth:`said`."""
        rest = np.sqrt(np.maximum(sigma**2 - (effects**2).sum(axis=1), 0.0))
        every = zip(effects.tolist(), rest.tolist(), strict=True)
        return tuple(by_size(dict(zip((*self.names, MEASURED), (*each, left), strict=True))) for each, left in every)


def by_size(parts: Mapping[str, float]) -> tuple[Contribution, ...]:
    """Parts of a sigma by their cause, the largest first; empty where they are not known."""
    whole: FloatArray = np.array(list(parts.values())) ** 2
    if not np.isfinite(whole).all() or not whole.sum() > 0.0:
        return ()
    made = [Contribution(cause, sigma, sigma**2 / float(whole.sum())) for cause, sigma in parts.items() if sigma > 0.0]
    return tuple(sorted(made, key=lambda one: -one.sigma))
