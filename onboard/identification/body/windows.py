"""Windows of tracked poses, in each of which the state of the body begins anew."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.identification.windows import SHORTEST, WINDOW_s

_MOST_WINDOWS = 240
_STEP_s = 0.02  # of the prediction


class TrackedPoses(NamedTuple):
    """Poses of the tracked frame, (n,) and (n, 3): x, y, yaw, which goes on beyond half a turn."""

    time_s: FloatArray
    measured: FloatArray
    late_s: float = 0.0  # each may be as much as half of it earlier or later


class PoseWindows(NamedTuple):
    """The windows of a recording."""

    start_s: FloatArray  # (k,)
    steps: int
    period_s: float
    poses: list[TrackedPoses]
    noise: list[FloatArray]  # of each, (u, 3)

    @property
    def grid_s(self) -> FloatArray:
        """(k, steps + 1)."""
        return self.start_s[:, None] + self.period_s * np.arange(self.steps + 1)


def windows_of(
    poses: TrackedPoses,
    noise: FloatArray,
    known_s: tuple[float, float],
    unknown: Sequence[tuple[float, float]],
    longest_s: float,
) -> PoseWindows:
    """Windows of poses, at all of which the commands are known, the largest delay earlier too.

    Args:
        poses: in the order of their times.
        noise: sigma of x, y, yaw, (3,).
        known_s: from when to when the commands are known.
        unknown: times between them in which they are not.
        longest_s: the largest delay.

    Raises:
        ConvergenceError: there is none.
    """
    starts, kept, noises = [], list[TrackedPoses](), list[FloatArray]()
    moved = np.gradient(poses.measured, poses.time_s, axis=0) * poses.late_s / np.sqrt(12.0)
    at_s, end_s = max(float(poses.time_s[0]), known_s[0] + longest_s), min(float(poses.time_s[-1]), known_s[1])
    while at_s < end_s and len(kept) < _MOST_WINDOWS:
        until_s = min(at_s + WINDOW_s, end_s)
        inside = slice(*np.searchsorted(poses.time_s, [at_s, until_s]).tolist())
        lost = any(a < until_s and b > at_s - longest_s for a, b in unknown)
        if inside.stop - inside.start >= SHORTEST and not lost:
            kept.append(TrackedPoses(poses.time_s[inside], poses.measured[inside]))
            noises.append(np.hypot(noise, moved[inside]))
            starts.append(float(poses.time_s[inside][0]))
        at_s = until_s
    if not kept:
        text = f"no {WINDOW_s:g} s with {SHORTEST} poses and known commands"
        raise ConvergenceError(f"{text}: check that both are on the same clock")
    return PoseWindows(np.array(starts), int(np.ceil(WINDOW_s / _STEP_s)) + 1, _STEP_s, kept, noises)
