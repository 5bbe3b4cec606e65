"""Corrections that an estimator fitted to instruments and links, against the sigmas they were stated with.

Each is a normal number when all is as stated. One that lies far out has changed since it was calibrated, or makes up
for something that no parameter is for; so do all of them together when their squares are too many.
"""

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

FARTHEST = 5.0  # sigmas, of one
UNLIKELY = 1e-6  # chance of all of them together


def too_large(corrections: Mapping[str, float]) -> tuple[str, ...]:
    """What is wrong with corrections by name, in stated sigmas; nothing when all is as stated."""
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
