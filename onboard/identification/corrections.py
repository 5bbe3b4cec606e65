"""Tests fitted corrections of instruments and links against their stated sigmas.

Under the stated sigmas each is standard normal and their sum of squares is chi-squared. A correction beyond five
sigmas, or an improbable sum, means a changed calibration or an error without a parameter.

The estimate of a correction about zero has the sigma ``(prior variance - posterior variance)^(1/2)`` (Hausman,
Econometrica 46, 1978). Data that tell less of it than its stated sigma move it by less than that sigma, however wrong
it is; in sigmas of what they tell, it is seen.
"""

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import FloatArray

FARTHEST, DOUBTFUL = 5.0, 3.0  # sigmas, of one
UNLIKELY = 1e-6  # chance of all of them together
_LEAST_TOLD = 0.05  # of a correction's prior variance: what the data must tell of it at least to be compared


def told(prior: FloatArray, posterior: FloatArray) -> FloatArray:
    """Sigma that a correction's estimate about zero should have, from its variances: this module's head."""
    return np.asarray(np.sqrt(np.maximum(prior - posterior, _LEAST_TOLD * prior)), np.float64)


def too_large(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reasons of refusal for corrections by name, in stated sigmas; empty if both tests (this module's head) pass."""
    if not corrections:
        return ()
    sigmas = np.abs(list(corrections.values()))
    worst = int(sigmas.argmax())
    if sigmas[worst] > FARTHEST:
        name = list(corrections)[worst]
        return (
            f"{name} had to be corrected by {sigmas[worst]:.0f} of its stated sigmas: it has changed, or is not so",
        )
    squares = float(sigmas @ sigmas)
    if chdtrc(len(sigmas), squares) < UNLIKELY:
        return (f"corrections are larger than stated: squares of {len(sigmas)} of them sum to {squares:.0f} sigmas",)
    return ()


def contradicted(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reason of refusal for corrections by name, in sigmas of what the data tell of each; empty if all are small."""
    name, sigmas = max(corrections.items(), key=lambda one: abs(one[1]), default=("", 0.0))
    if abs(sigmas) <= FARTHEST:
        return ()
    return (
        f"the motion contradicts what is stated of {name} by {abs(sigmas):.0f} sigmas: it has changed, or is not so",
    )


def doubtful(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reasons for a weak verdict: corrections of more than three of their stated sigmas."""
    return tuple(
        f"{name} had to be corrected by {abs(sigmas):.1f} of its stated sigmas"
        for name, sigmas in corrections.items()
        if DOUBTFUL < abs(sigmas) <= FARTHEST
    )
