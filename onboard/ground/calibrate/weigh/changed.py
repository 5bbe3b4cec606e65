"""Whether another body was held from some pose on: each part of the poses with a body and zeros of its own, or one.

A payload that is gripped between poses, or a tool that is exchanged, is to a single fit a larger noise of some poses,
and its answer a mean that neither body weighs.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.calibration import wrist, wrist_model
from onboard.estimation.policy import ODDS
from onboard.ground.calibrate.weigh.conventions import Poses

PART = wrist.FEWEST + 2  # poses of a part: a fit, and two more that show its noise


class BodyChange(NamedTuple):
    """Another body.

    Attributes:
        at: pose that is the first with it, counted from 0.
        before_kg: mass of the first one.
        after_kg: of the other.
        nats: of evidence over one body whose zeros jumped there.
    """

    at: int
    before_kg: float
    after_kg: float
    nats: float


def change(poses: Poses, prior: wrist_model.Priors, whole: wrist.PoseFit) -> BodyChange | None:
    """The likeliest change of the body; None where none is likely.

    Args:
        poses: all, in the order in which they were taken.
        prior: of the fits.
        whole: one body for all of them.
    """
    n = len(poses.R)
    instants = range(PART, n - PART + 1)
    if not instants:
        return None

    def misfit(at: int) -> float:
        """Of two bodies in closed form, nats."""
        left = np.concatenate([_left(poses, prior, slice(0, at)), _left(poses, prior, slice(at, n))])
        return 0.5 * n * float(np.log((left**2).mean(axis=0) + 1e-18).sum())

    at = min(instants, key=misfit)
    parts = [wrist.fit(poses.R[part], poses.wrench[part], prior) for part in (slice(0, at), slice(at, n))]
    if sum(part.evidence for part in parts) < whole.evidence - np.log(ODDS / len(instants)):
        return None
    values = [np.array([part.state.mass, *part.state.first_moment]) for part in parts]
    chance = parts[0].covariance[:4, :4] + parts[1].covariance[:4, :4]
    size = np.maximum(*(np.abs([value[0], *[np.linalg.norm(value[1:])] * 3]) for value in values))
    nats = _log(values[1] - values[0], chance + np.diag(size**2)) - _log(values[1] - values[0], chance)
    found = BodyChange(at, float(values[0][0]), float(values[1][0]), nats)
    return found if nats > -np.log(ODDS / len(instants)) else None


def _left(poses: Poses, prior: wrist_model.Priors, part: slice) -> FloatArray:
    R, wrench = poses.R[part], poses.wrench[part]
    left = wrench - wrist_model.predicted(R, wrist.begun(R, wrench, prior), prior)
    return np.asarray(left - left.mean(axis=0), np.float64)


def _log(off: FloatArray, covariance: FloatArray) -> float:
    """Density of a normal but for its constant, nats."""
    return -0.5 * float(off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1])
