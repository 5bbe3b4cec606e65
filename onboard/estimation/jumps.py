"""Finds where the angle of a joint jumps for good: from there on its encoder is another one.

A belt or coupling that slips, counts that are lost or a buffer that falls behind change an encoder's zero, scale or
delay from one sample to the next, and the joint has not moved. A step between two samples is a jump where it differs

- from a line through the three steps on either side, by more than :data:`SCATTERS` times the largest difference of
  these from it, and by more than noise and rounding make by a chance of ``READING``, and
- from zero by more than :data:`TRAVELS` of the neighbouring steps: a sample or two that a recorder left out, or
  repeated, are an error of time, and
- from its neighbours by more than :data:`TRAVELS` times what any of the :data:`_BEFORE` steps before it did: the
  error of an encoder that interpolates, or whose joint is coupled to another motor, is no noise; it makes such
  steps again and again.

A single wrong sample jumps there and back, which the line shows. A step beside four equal readings is not judged: an
encoder that was stuck, or a recorder that repeats, catches up (:mod:`onboard.estimation.stuck`). Where no sample came
for as long as the joint needs for half of the step, it moved meanwhile, and what is wrong is its time.
"""

import math
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import MOSTLY, READING, sigmas

SCATTERS, TRAVELS = 10.0, 3.0
ALIKE = 0.2
"""Relative: as large as another jump. That of a delay follows from the rate to the third order of delay over period."""
_SIDE = 3  # steps on either side
_WINDOW = 2 * _SIDE + 1  # steps
_BEFORE = 64  # steps
_UNEVEN = 1.5  # times the shortest interval of a window: between these, steps do not tell a rate
_AT = np.delete(np.arange(_WINDOW) - _SIDE, _SIDE).astype(np.float64)
_LINE = np.column_stack([np.ones(2 * _SIDE), _AT])
_OFF_LINE = np.eye(2 * _SIDE) - _LINE @ np.linalg.pinv(_LINE)
_MEAN_BESIDE = np.where(np.arange(_WINDOW) == _SIDE, 0.0, 1.0 / (2 * _SIDE))
_FAR = sigmas(READING) * math.sqrt(2.0 + 1.0 / _SIDE)  # of a step less a mean of its neighbours'


class Jump(NamedTuple):
    """A step that no motion makes."""

    at: int  # the first reading after it
    size: float  # readings
    expected: float  # reading in its place, had there been none
    travel: float  # mean step beside it

    def undoes(self, other: "Jump") -> bool:
        """Whether the encoder is again what it was before another jump: a zero, scale or delay that was wrong is right.

        Args:
            other: the jump before this one.
        """
        zero, scaled, late = -other.size, -self.expected * other.size, -other.size * self.travel
        read = other.expected + other.size  # after it: by the scale times what it should be
        each = (zero, scaled / read if read else 0.0, late / other.travel if other.travel else 0.0)
        return any(abs(self.size - one) < ALIKE * abs(one) for one in each)


class AngleJumps:
    """Finds jumps in the readings of one encoder.

    Args:
        sigma: of a reading, with its rounding.
    """

    def __init__(self, sigma: float) -> None:
        self._least = _FAR * sigma
        self._kept = np.zeros((3, 0))

    def forget(self) -> None:
        """What comes next does not follow on what came last."""
        self._kept = self._kept[:, :0]

    def watch(self, readings: FloatArray, times: FloatArray, arrived: FloatArray) -> list[Jump]:
        """Judge the next readings, and the last few before them.

        Args:
            readings: (n,); NaN where one may not be used.
            times: (n,) in any unit; NaN where one is not known.
            arrived: (n,) when, in the same unit.
        """
        kept = self._kept.shape[1]
        every = np.empty((3, kept + len(readings)))
        every[:, :kept], every[0, kept:], every[1, kept:], every[2, kept:] = self._kept, readings, times, arrived
        self._kept = every[:, -_WINDOW - _BEFORE :]
        step = every[:, 1:] - every[:, :-1]
        if step.shape[1] < _WINDOW:
            return []
        length = np.abs(step[0])
        may_be = (length[1:-1] > (TRAVELS - 1.0) * np.maximum(length[2:], length[:-2])) & (
            length[1:-1] > 0.5 * self._least
        )
        found = list[Jump]()
        for k in (may_be.nonzero()[0] + 1).tolist():
            if not max(kept - _SIDE - 1, _SIDE) <= k < step.shape[1] - _SIDE:
                continue  # judged when it came, or not before more have come
            size, travel = _jump(*step[:, k - _SIDE : k + _SIDE + 1])
            if abs(size) > max(self._least, TRAVELS * _farthest(step[0, max(k - _SIDE - _BEFORE, 0) : k])):
                found.append(Jump(k + 1 - kept, size, float(every[0, k + 1]) - size, travel))
        return found


def _jump(steps: FloatArray, intervals: FloatArray, arrivals: FloatArray) -> tuple[float, float]:
    """By how much the middle one of some steps differs from the mean of the others, and that; 0 where it is no jump."""
    beside = np.delete(steps, _SIDE)
    travel = float(beside.mean())
    if not beside[:_SIDE].any() or not beside[_SIDE:].any() or not intervals.max() <= _UNEVEN * intervals.min():
        return 0.0, travel
    size = float(steps[_SIDE] - travel)
    paused = abs(travel) * float(arrivals[_SIDE] / intervals[_SIDE] - 1.0)
    largest = max(SCATTERS * float(np.abs(_OFF_LINE @ beside).max()), TRAVELS * float(np.abs(beside).max()))
    return size if abs(size) > max(largest, paused / MOSTLY) else 0.0, travel


def _farthest(steps: FloatArray) -> float:
    """The largest difference of a step from the mean of its neighbours; 0 where there are too few."""
    if len(steps) < _WINDOW:
        return 0.0
    off = steps[_SIDE:-_SIDE] - np.correlate(steps, _MEAN_BESIDE, "valid")
    return float(np.nanmax(np.abs(off), initial=0.0))
