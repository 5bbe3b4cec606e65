"""What makes a motion good: one number of the covariance of what is asked."""

from enum import StrEnum

import numpy as np

from onboard.estimation.arrays import FloatArray, eigen


class Criterion(StrEnum):
    """Of the covariance in units of the quantities' scales; each is the logarithm of a sigma, lower is better."""

    D = "D"  # volume of the ellipsoid: mean of log sigma over its axes
    A = "A"  # root mean square of the sigmas
    WORST = "worst"  # longest axis of the ellipsoid


def cost(covariance: FloatArray, scales: FloatArray, criterion: Criterion) -> float:
    """The criterion of a covariance, (k, k), of quantities with scales (k,)."""
    scaled = covariance / np.outer(scales, scales)
    if criterion is Criterion.D:
        sign, logarithm = np.linalg.slogdet(scaled)
        return float(0.5 * logarithm / len(scaled)) if sign > 0.0 else np.inf
    if criterion is Criterion.A:
        return float(0.5 * np.log(np.trace(scaled) / len(scaled)))
    return float(0.5 * np.log(np.linalg.eigvalsh(scaled)[-1]))


def weakest(covariance: FloatArray, scales: FloatArray, names: tuple[str, ...]) -> str:
    """The longest axis of the ellipsoid in words: what is known least, alone or together."""
    values, vectors = eigen(covariance / np.outer(scales, scales))
    part = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
    order = np.argsort(-np.abs(part))
    shown = [k for k in order.tolist() if abs(part[k]) > 0.3]
    said = " ".join(f"{'+' if part[k] > 0.0 else '-'} {names[k]}" for k in shown).removeprefix("+ ")
    return f"known least: {said}, to {100.0 * float(np.sqrt(values[-1])):.2g} % of its size (1 sigma)"
