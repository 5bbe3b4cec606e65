"""Faults of connectors and clocks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.faults import Fault, FaultError, FaultyClock
from tests.hil_sim.devices.twin_bench import MS, START_NS, RateClock
from tests.hil_sim.faults.fault_bench import S, of


def test_a_loose_connector_is_open_for_half_of_each_period():
    faults = of(Fault("intermittent", "x", 1.0, 1.25, 0.1), Fault("silent", "x", 2.0, 3.0))
    away = [(1.0, 1.05), (1.1, 1.15), (1.2, 1.25), (2.0, 3.0)]
    assert faults.absences() == [(START_NS + round(a * S), START_NS + round(b * S)) for a, b in away]


@given(st.integers(0, 400))
def test_is_away_says_what_absences_say(at):
    faults = of(Fault("intermittent", "x", 0.1, 0.25, 0.07), Fault("silent", "x", 0.3, 0.35))
    now_ns = START_NS + at * MS
    assert faults.is_away(now_ns) == any(a <= now_ns < b for a, b in faults.absences())


def clock_with(*faults):
    return FaultyClock(RateClock(0.0), of(*faults))


def test_a_clock_stands_still_or_is_put_forward():
    still = clock_with(Fault("clock_jump", "x", 1.0, 2.0, -0.25))
    assert [still.chip_ns(START_NS + t) for t in (S, 5 * S // 4, 2 * S)] == [S, S, 7 * S // 4]
    assert still.time_ns(S + 1) == START_NS + 5 * S // 4 + 1
    ahead = clock_with(Fault("clock_jump", "x", 1.0, 2.0, 0.25))
    assert [ahead.chip_ns(START_NS + t) for t in (S - 1, S, 2 * S)] == [S - 1, 5 * S // 4, 9 * S // 4]
    assert {ahead.time_ns(t) for t in (S, S + 1, 5 * S // 4)} == {START_NS + S}


def test_a_slow_clock_loses_its_share():
    slow = clock_with(Fault("slow", "x", 1.0, 2.0, 0.2))
    assert [slow.chip_ns(START_NS + t) for t in (S, 2 * S, 3 * S)] == [S, 18 * S // 10, 28 * S // 10]
    np.testing.assert_allclose(slow.times_s(np.array([0.5e9, 1.4e9, 2.8e9])), [0.5, 1.5, 3.0])


@given(st.lists(st.integers(0, 4000), min_size=1, max_size=20))
def test_a_faulty_clock_is_monotone_and_its_inverse_is_one(at_ms):
    clock = clock_with(
        Fault("clock_jump", "x", 0.5, 9, 0.1), Fault("slow", "x", 1.0, 2.0, 0.3), Fault("clock_jump", "x", 2.5, 9, -0.2)
    )
    shown = [clock.chip_ns(START_NS + t * MS) for t in sorted(at_ms)]
    assert shown == sorted(shown)
    for value in shown:
        assert abs(clock.chip_ns(clock.time_ns(value)) - value) <= 2
    times = clock.times_s(np.array(shown, np.float64))
    np.testing.assert_allclose(times, [(clock.time_ns(v) - START_NS) * 1e-9 for v in shown], atol=1e-8)


@pytest.mark.parametrize(
    "faults",
    [
        [Fault("slow", "x", 1.0, 2.0, 1.5)],
        [Fault("slow", "x", 1.0, 2.0, 0.5), Fault("clock_jump", "x", 1.5, 9.0, 0.1)],
    ],
)
def test_a_clock_that_cannot_be_is_refused(faults):
    with pytest.raises(FaultError):
        clock_with(*faults)
