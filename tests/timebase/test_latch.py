"""The count latched on an edge says where between two coarse ticks the edge fell."""

import numpy as np
import pytest

from drivers.records import SCALAR
from onboard.timebase.latch import LatchedCounts

COUNTS_PER_TICK = 30.0


def turning(speed: float, acceleration: float, tick: np.ndarray) -> np.ndarray:
    return speed * tick + 0.5 * acceleration * tick**2


def latched(speed: float, acceleration: float, late_after: float | None = None, spacing: int = 1) -> LatchedCounts:
    when = np.arange(0.0, 60.0, spacing)
    rows = np.zeros(len(when), SCALAR)
    rows["tick"] = when
    if late_after is not None:  # samples due while the line is busy are taken when it is free again
        due = (when > late_after) & (when < late_after + 1.2)
        when[due] = late_after + 1.2
    rows["value_raw"] = np.floor(turning(speed, acceleration, when))
    counts = LatchedCounts()
    counts.append(rows)
    return counts


@pytest.mark.parametrize("spacing", [1, 4])
@pytest.mark.parametrize("speed", [-COUNTS_PER_TICK, 5.0, COUNTS_PER_TICK])
@pytest.mark.parametrize("place", [20.01, 20.3, 20.5, 20.99])
def test_the_edge_lies_in_the_interval_and_the_interval_is_narrow(speed: float, place: float, spacing: int) -> None:
    for acceleration in (0.0, 0.05):
        value = int(np.floor(turning(speed, acceleration, np.array(place))))
        low, high = latched(speed, acceleration, place, spacing).interval(20, value)
        assert low <= place <= high
        assert high - low < 2.7 / abs(speed)


def test_a_joint_that_stands_still_says_no_more_than_the_stamp() -> None:
    assert latched(0.0, 0.0).interval(20, 0) == (19.0, 21.0)
    assert latched(0.3, 0.0).interval(20, 6) == (19.0, 21.0)


def test_it_waits_for_the_samples_after_the_edge() -> None:
    counts = latched(COUNTS_PER_TICK, 0.0)
    assert counts.complete(45)
    assert not counts.complete(46)
    counts.clear()
    assert not counts.complete(0)
