"""When to stop: gains that do not converge, seen by the model before the first trial, by the errors between trials.

Within a trial the distance from the reference is watched, SYNC by SYNC.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from onboard.estimation.arrays import FloatArray

FARTHEST_RAD = 0.7  # from the reference
GROWN, RISES = 2.0, 3  # times the best error, after so many rises in succession


def astray(error: FloatArray, names: Sequence[str]) -> str:
    """Why a trial has to be stopped at an error of position, (n,) rad; empty while it is near."""
    if not np.isfinite(error).all():
        return "the control law gives no number"
    worst = int(np.abs(error).argmax())
    if abs(error[worst]) <= FARTHEST_RAD:
        return ""
    return f"{names[worst]} is {np.rad2deg(abs(error[worst])):.0f} deg from where it should be"


def diverges(errors: Sequence[float]) -> str:
    """Why no further trial is flown, by the rms errors of those so far; empty while they do not grow."""
    recent = errors[-RISES - 1 :]
    if len(recent) <= RISES or any(b <= a for a, b in pairwise(recent)):
        return ""
    if errors[-1] < GROWN * min(errors):
        return ""
    ratio = (recent[-1] / recent[0]) ** (1.0 / RISES)
    return f"the error grows {ratio:.2f} times a trial: the gains are too large for this arm"
