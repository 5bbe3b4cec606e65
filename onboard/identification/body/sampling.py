"""Error of commands that a recorder sampled: a change may have come at any time in the sample before it is seen.

Of a clock of its own each change of a command is late by another time, evenly spread over a sample. A step of the level
by d that comes dt later leaves the body slower by d dt F / m, and turning by so much less: all poses after it are away
by this times the time since. Such errors, one a step, are noise that the poses of a window share: with G the change of
the whitened poses by one sigma of each, their covariance is I + G G'.

How late the mean of them is, the poses cannot say: a delay of the valves does the same. Changes that scatter at all
come at two phases of a sample at least, half a sample apart: their mean is within a quarter of the middle. Changes that
do not scatter came with the sample, or all of them by one part of a sample before.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import OF_STEP, FloatArray
from onboard.identification.body.stated import Edges

_NEGLIGIBLE = 0.1  # of the noise: a direction with so little more, half a per cent of a sigma, is left as it is


class Lateness(NamedTuple):
    """What the fitted delay leaves out."""

    shift_s: float  # to be added
    low_s: float  # then, how far below it may be
    high_s: float
    sigma_s: float


def lateness(late_s: float, scattered: bool, poses_late_s: float) -> Lateness:
    """Of commands that may be older by ``late_s``, and poses, by half of ``poses_late_s`` more or less."""
    shift, low, high = (0.5 * late_s, 0.25 * late_s, 0.25 * late_s) if scattered else (0.0, 0.0, late_s)
    own = (low**2 + high**2 - low * high) / 3.0  # mean square of what is evenly spread between -low and high
    half = 0.5 * poses_late_s
    return Lateness(shift, low + half, high + half, float(np.sqrt(own + half**2 / 3.0)))


class Whitener(NamedTuple):
    """``(I + G G')^-1/2`` of the poses of a window: ``I - U w U'``."""

    U: FloatArray  # (3 u, e)
    w: FloatArray  # (e,)
    log_determinant: float

    def of(self, lines: FloatArray) -> FloatArray:
        """Lines (3 u, c) of which none shares noise with another."""
        return np.asarray(lines - self.U @ (self.w[:, None] * (self.U.T @ lines)), np.float64)


def whitener(G: FloatArray) -> Whitener:
    """Of the change of whitened poses by one sigma of each step, (u, 3, e)."""
    U, s, _ = np.linalg.svd(G.reshape(3 * len(G), G.shape[2]), full_matrices=False)
    U, s = U[:, s > _NEGLIGIBLE], s[s > _NEGLIGIBLE]
    return Whitener(U, 1.0 - 1.0 / np.sqrt(1.0 + s * s), float(np.log1p(s * s).sum()))


class DrivenWindow(NamedTuple):
    """A window as predicted, n steps."""

    grid_s: FloatArray  # (n + 1,)
    yaw: FloatArray  # (n + 1,) of the body
    pushed: FloatArray  # (n, 2) acceleration by all thrusters, body axes
    lever_m: FloatArray  # (2,) of the tracked frame from the centre of mass, body axes


def by_steps(motion: DrivenWindow, steps: Sequence[Edges], each: FloatArray, time_s: FloatArray) -> FloatArray:
    """Change of the tracked poses, (u, 3, e), by one sigma of the time of each step within the window.

    Args:
        motion: of the body.
        steps: of each thruster.
        each: acceleration, body axes, and that of the yaw, by each thruster at level one, (j, 3).
        time_s: of the poses, (u,).
    """
    at, by = [], []
    for (edge_s, change, late_s), own in zip(steps, each, strict=True):
        inside = (edge_s > motion.grid_s[0]) & (edge_s < time_s[-1]) & (late_s > 0.0)
        at.append(edge_s[inside])
        by.append((-OF_STEP * change * late_s)[inside, None] * own)
    edge_s, slower = np.concatenate(at), np.concatenate(by)  # (e,), (e, 3)
    h = np.diff(motion.grid_s)
    middle = motion.grid_s[:-1] + 0.5 * h
    yaw_then, yaw_middle = (np.interp(of, motion.grid_s, motion.yaw) for of in (edge_s, middle))
    since, since_middle = (np.maximum(of[:, None] - edge_s, 0.0) for of in (time_s, middle))
    left = _left(motion.pushed, yaw_middle)[:, :, None] * (slower[:, 2] * since_middle)[:, None]  # (n, 2, e)
    rate = np.cumsum(left * h[:, None, None], axis=0)
    turned = np.concatenate([np.zeros((1, *rate.shape[1:])), np.cumsum(rate * h[:, None, None], axis=0)])
    first = np.clip(np.searchsorted(motion.grid_s, time_s, side="right") - 1, 0, len(h) - 1)
    part = ((time_s - motion.grid_s[first]) / h[first])[:, None, None]
    begun = _left(slower[:, :2], yaw_then - 0.5 * np.pi).T  # table axes, (2, e)
    angle = slower[:, 2] * since
    place = (1.0 - part) * turned[first] + part * turned[first + 1] + begun * since[:, None]
    lever = _left(np.broadcast_to(motion.lever_m, (len(time_s), 2)), np.interp(time_s, motion.grid_s, motion.yaw))
    return np.concatenate([place + lever[:, :, None] * angle[:, None], angle[:, None]], axis=1)


def _left(vectors: FloatArray, yaw: FloatArray) -> FloatArray:
    """Vectors (n, 2) turned by the yaw and a quarter turn more."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([-s * vectors[:, 0] - c * vectors[:, 1], c * vectors[:, 0] - s * vectors[:, 1]], axis=1)
