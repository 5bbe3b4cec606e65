"""Short gaps of the joints: ticks of unknown joints wait until these are known again, and move smoothly in between.

A filter carries the momentum from tick to tick, which needs the joints at each; a window of seconds would have to begin
anew at each gap. The joints are those of the polynomial of fifth degree that has position, rate and acceleration of
both ends. What instruments show there is not used.
"""

import math

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.prediction.ticks import Ticks

LONGEST_s = 0.8
"""Over which the error of the interpolation turns the momentum by less than a gyro's noise in a tick, for a swing of
0.3 rad at 0.6 Hz; it grows with the fifth power."""


class JointGaps:
    """Of one filter's ticks.

    Args:
        period_s: between ticks.
        none: no ticks, of this vehicle.
    """

    def __init__(self, period_s: float, none: Ticks) -> None:
        self._period_s, self._none = period_s, none
        self._held = none  # the newest tick of known joints, which was given, and those of unknown ones since

    def take(self, ticks: Ticks) -> Ticks:
        """Those of known joints, and those of a gap that is over; of a longer one than :data:`LONGEST_s` nothing."""
        given = len(self._held.time_s) > 0
        ticks = self._held.and_then(ticks)
        at = np.isfinite(np.concatenate([ticks.q, ticks.dq, ticks.ddq], axis=1)).all(axis=1).nonzero()[0]
        if not at.size:
            return self._none
        parts, before = [], None
        for one in [at] if at[-1] - at[0] < len(at) else np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            first, last = int(one[0]), int(one[-1])
            if before is not None:
                gap_s = ticks.time_s[first] - ticks.time_s[before]
                if gap_s <= LONGEST_s and round(gap_s / self._period_s) == first - before:
                    parts.append(_filled(ticks.part(slice(before, first + 1))))
            parts.append(ticks.part(slice(first, last + 1)))
            before = last
        waits = ticks.time_s[-1] - ticks.time_s[at[-1]] <= LONGEST_s
        self._held = ticks.part(slice(at[-1], None if waits else at[-1] + 1))
        return Ticks.joined(parts).part(slice(int(given), None))


def _filled(ticks: Ticks) -> Ticks:
    """The inner ones of some of which the first and the last have known joints."""
    inner = ticks.part(slice(1, -1))
    at_s, whole_s = inner.time_s - ticks.time_s[0], float(ticks.time_s[-1] - ticks.time_s[0])
    ends = np.stack([ticks.q, ticks.dq, ticks.ddq], axis=1)[[0, -1]]
    joints = _between(ends, at_s, whole_s)
    return inner._replace(
        q=joints[:, 0],
        dq=joints[:, 1],
        ddq=joints[:, 2],
        measured=np.full(inner.measured.shape, np.nan),
        joint_sigma=np.repeat(ticks.joint_sigma[[0, -1]].max(axis=0, keepdims=True), len(at_s), axis=0),
        sample_sigma=np.zeros(inner.sample_sigma.shape),  # none of these is used
        cyclic=_between(ticks.cyclic[[0, -1]], at_s, whole_s),
    )


def _between(ends: FloatArray, at_s: FloatArray, whole_s: float) -> FloatArray:
    """Values and two derivatives, (n, 3, m), at times after the first of two ends, (2, 3, m), that are so far apart."""
    scale = np.array([1.0, whole_s, 0.5 * whole_s**2])[:, None]  # of a power series in the share of the time
    (a, b, c), (d, e, f) = ends[0] * scale, ends[1] * scale
    d, e, f = d - a - b - c, e - b - 2.0 * c, f - c
    powers = a, b, c, 10.0 * d - 4.0 * e + f, 7.0 * e - 15.0 * d - 2.0 * f, 6.0 * d - 3.0 * e + f
    x = (at_s / whole_s)[:, None]
    value, rate, bend = (
        sum(math.perm(k, order) * one * x ** (k - order) for k, one in enumerate(powers) if k >= order)
        for order in range(3)
    )
    return np.stack([value, rate / whole_s, bend / whole_s**2], axis=1)
