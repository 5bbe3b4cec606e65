"""Tests fitted corrections of instruments and links against their stated sigmas.

Under the stated sigmas each is standard normal and their sum of squares is chi-squared. A correction beyond five
sigmas, or an improbable sum, means a changed calibration or an error without a parameter.
"""

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

FARTHEST, DOUBTFUL = 5.0, 3.0  # sigmas, of one
UNLIKELY = 1e-6  # chance of all of them together


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


def doubtful(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """Reasons for a weak verdict: corrections of more than three of their stated sigmas."""
    return tuple(
        f"{name} had to be corrected by {abs(sigmas):.1f} of its stated sigmas"
        for name, sigmas in corrections.items()
        if DOUBTFUL < abs(sigmas) <= FARTHEST
    )
