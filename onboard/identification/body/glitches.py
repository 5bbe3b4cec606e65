"""Poses that no body can have: those that jump and come back, and jumps that stay.

A tracker takes another marker for the body's for a few frames, reports zeros while it sees none, or begins anew at
another origin. A step between two poses is a jump where it differs from what the median rate of the steps about it
makes by more than noise does by a chance of ``READING``; noise is what is stated, or the scatter of the steps where
that is larger. Poses between two jumps of which the second takes back most of the first are left out. Where none does
so in a second, the tracker has a new origin, and nothing is predicted across it; or it sees nothing, and repeats one
pose. A pose that repeats the one before is not looked at: it is left out with that one.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from onboard.estimation.arrays import PAUSE, BoolArray, FloatArray, scatter
from onboard.estimation.policy import MOSTLY, READING, sigmas

_BESIDE = 9  # steps of a median
_LONGEST_s = 1.0  # that a tracker is elsewhere, unless it repeats one pose


class Glitches(NamedTuple):
    """What is wrong with poses."""

    good: BoolArray  # (n,)
    moved: tuple[tuple[float, float, float], ...]  # from when to when the origin changed, s, and by how much, m
    lost: int  # of those that do not repeat the one before, how many are not good


def glitches(time_s: FloatArray, measured: FloatArray, noise: FloatArray) -> Glitches:
    """Which poses are of the body, and where their origin changes.

    Args:
        time_s: (n,) rising.
        measured: (n, 3) m, m, rad; the yaw by any turns.
        noise: sigma of x, y, yaw, (3,).
    """
    fresh = np.append(True, (np.diff(measured, axis=0) != 0.0).any(axis=1))
    of = np.cumsum(fresh) - 1
    found = _among(time_s[fresh], measured[fresh], noise, np.bincount(of) >= _BESIDE)
    return found._replace(good=found.good[of])


def _among(time_s: FloatArray, measured: FloatArray, noise: FloatArray, repeated: BoolArray) -> Glitches:
    """The same of poses none of which repeats the one before; ``repeated``: which are repeated for long, (n,)."""
    good, moved = np.ones(len(time_s), np.bool_), list[tuple[float, float, float]]()
    if len(time_s) <= _BESIDE:
        return Glitches(good, (), 0)
    lasted = np.diff(time_s)[:, None]
    steps = _turned(np.diff(measured, axis=0))
    beside = np.pad(steps / lasted, ((_BESIDE // 2, _BESIDE // 2), (0, 0)), "symmetric")
    rates = np.median(sliding_window_view(beside, _BESIDE, axis=0), axis=-1)
    off = steps - rates * lasted
    sigma = np.maximum(np.sqrt(2.0) * noise, scatter(off))
    jumps = np.flatnonzero(np.abs(off / sigma).max(axis=1) > sigmas(READING)).tolist()
    at_once, end = lasted[:, 0] < PAUSE * np.median(lasted), -1
    for k, first in enumerate(jumps):
        if first <= end or not at_once[first]:
            continue
        size = float(np.linalg.norm(off[first] / sigma))
        for last in jumps[k + 1 :]:
            apart_s = time_s[last + 1] - time_s[first]
            if apart_s > _LONGEST_s and last > first + 1:
                break
            left = _turned(measured[last + 1] - measured[first]) - 0.5 * (rates[first] + rates[last]) * apart_s
            if np.linalg.norm(left / sigma) < MOSTLY * size:
                good[first + 1 : last + 1], end = False, last
                break
        if end < first and repeated[first + 1]:
            good[first + 1] = False
        elif end < first:
            moved.append((float(time_s[first]), float(time_s[first + 1]), float(np.linalg.norm(off[first, :2]))))
    return Glitches(good, tuple(moved), int(np.sum(~good)))


def _turned(steps: FloatArray) -> FloatArray:
    """Differences of poses, of the yaw by less than half a turn."""
    return np.concatenate([steps[..., :2], np.remainder(steps[..., 2:] + np.pi, 2.0 * np.pi) - np.pi], axis=-1)
