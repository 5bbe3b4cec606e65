"""Windows of tracked poses, in each of which the state of the body begins anew."""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.identification.windows import SHORTEST, WINDOW_s

_MOST_WINDOWS = 240
STEP_s = 0.02  # of the prediction
STEPS = int(np.ceil(WINDOW_s / STEP_s)) + 1  # in a window


class TrackedPoses(NamedTuple):
    """Poses of the tracked frame in the order of their times, and when the commands of the thrusters are known.

    (n,) and (n, 3): x, y, yaw, which goes on beyond half a turn.
    """

    time_s: FloatArray
    measured: FloatArray
    late_s: float = 0.0  # each may be as much as half of it earlier or later
    known_s: tuple[float, float] = (-np.inf, np.inf)  # from when to when commands are known
    unknown: tuple[tuple[float, float], ...] = ()  # times between them in which they are not


class PoseWindows(NamedTuple):
    """The windows of a recording."""

    start_s: FloatArray  # (k,)
    time_s: list[FloatArray]  # of the poses of each, (u,)
    measured: list[FloatArray]  # (u, 3)
    noise: list[FloatArray]  # (u, 3)

    @property
    def grid_s(self) -> FloatArray:
        """(k, steps + 1)."""
        return self.start_s[:, None] + STEP_s * np.arange(STEPS + 1)


def windows_of(poses: TrackedPoses, noise: FloatArray, longest_s: float) -> PoseWindows:
    """Windows of poses, at all of which the commands are known, the largest delay earlier too.

    Args:
        poses: of a recording.
        noise: sigma of x, y, yaw, (3,).
        longest_s: the largest delay.

    Raises:
        ConvergenceError: there is none.
    """
    kept, (begin_s, last_s) = list[slice](), poses.known_s
    moved = np.gradient(poses.measured, poses.time_s, axis=0) * poses.late_s / np.sqrt(12.0)
    at_s, end_s = max(float(poses.time_s[0]), begin_s + longest_s), min(float(poses.time_s[-1]), last_s)
    while at_s < end_s and len(kept) < _MOST_WINDOWS:
        until_s = min(at_s + WINDOW_s, end_s)
        inside = slice(*np.searchsorted(poses.time_s, [at_s, until_s]).tolist())
        lost = any(a < until_s and b > at_s - longest_s for a, b in poses.unknown)
        if inside.stop - inside.start >= SHORTEST and not lost:
            kept.append(inside)
        at_s = until_s
    if not kept:
        text = f"no {WINDOW_s:g} s with {SHORTEST} poses and known commands"
        raise ConvergenceError(f"{text}: check that both are on the same clock")
    time_s, measured = ([of[inside] for inside in kept] for of in (poses.time_s, poses.measured))
    noises = [np.hypot(noise, moved[inside]) for inside in kept]
    return PoseWindows(np.array([of[0] for of in time_s]), time_s, measured, noises)
