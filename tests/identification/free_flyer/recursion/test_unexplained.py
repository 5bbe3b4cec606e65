"""What windows that no hypothesis explains leave over: a line where there is one, and for how long to wait."""

import numpy as np
import pytest

from onboard.identification.free_flyer.recursion.lines import Unexplained, line_of

PERIOD_s = 0.01


def residual(rng, seconds, swing, frequency_Hz, channel=1, slow=0.0):
    time_s = PERIOD_s * np.arange(round(seconds / PERIOD_s))
    out = rng.normal(size=(len(time_s), 6))
    out[:, channel] += swing * np.sin(2.0 * np.pi * frequency_Hz * time_s + 0.3)
    return out + slow * np.sin(2.0 * np.pi * 0.2 * time_s + 1.0)[:, None]


@pytest.mark.parametrize(("seconds", "frequency_Hz"), [(1.0, 3.3), (2.0, 2.0), (4.0, 15.0), (8.0, 1.6)])
@pytest.mark.parametrize(("channel", "instrument"), [(2, "gyro"), (3, "accelerometer")])
def test_a_swing_is_named_with_its_frequency(rng, seconds, frequency_Hz, channel, instrument):
    found = line_of(residual(rng, seconds, 4.0, frequency_Hz, channel), PERIOD_s)
    assert found.frequency_Hz == pytest.approx(frequency_Hz, abs=0.6 / seconds)
    assert found.instrument == instrument
    assert found.beyond > 1.0


@pytest.mark.parametrize("seconds", [1.0, 2.0, 4.0, 8.0])
def test_neither_noise_nor_what_the_arm_leaves_at_its_own_pace_is_a_line(rng, seconds):
    assert line_of(residual(rng, seconds, 0.0, 1.0), PERIOD_s) is None
    assert line_of(residual(rng, seconds, 0.0, 1.0, slow=200.0), PERIOD_s) is None
    assert line_of(residual(rng, seconds, 100.0, 0.4), PERIOD_s) is None
    assert line_of(residual(rng, 8.0, 4.0, 0.75), PERIOD_s) is None


def test_a_handful_of_ticks_has_no_line(rng):
    assert line_of(rng.normal(size=(3, 6)), PERIOD_s) is None


def test_a_window_counts_where_it_contradicts_a_shorter_one_or_was_waited_for():
    made = Unexplained(PERIOD_s)
    for longer, count, wait in ((False, 0, 50), (False, 1, 100), (True, 2, 200), (False, 3, 400), (False, 4, 800)):
        made.add(1.0, None, longer=longer)
        assert (made.count, made.wait) == (count, wait)
    made.add(1.0, None, longer=True)
    assert made.wait == 800
    made.settle()
    assert (made.count, made.wait) == (0, 0)


def test_what_contradicts_each_other_in_the_last_window_is_kept_until_the_filter_steps():
    made = Unexplained(PERIOD_s)
    made.add(1.0, None, longer=False, between="one and another")
    assert made.between == "one and another"
    made.settle()
    assert not made.between
    made.add(1.0, None, longer=False, between="one and another")
    made.add(2.0, None, longer=False)
    assert not made.between


def test_windows_that_overlap_show_one_swing_once(rng):
    made, swinging = Unexplained(PERIOD_s), residual(rng, 1.0, 9.0, 4.0)
    for end_s, swings in ((10.0, False), (10.5, False), (11.2, True)):
        made.add(end_s, swinging, longer=False)
        assert made.swings == swings


def test_two_lines_in_a_minute_are_a_swing_that_is_remembered_for_one(rng):
    made, swinging = Unexplained(PERIOD_s), residual(rng, 1.0, 9.0, 4.0)
    made.add(10.0, swinging, longer=False)
    assert not made.swings
    assert made.count == 1
    assert made.line.frequency_Hz == pytest.approx(4.0, abs=0.5)
    made.add(12.0, residual(rng, 1.0, 0.0, 1.0), longer=False)
    assert not made.swings
    made.add(69.0, swinging, longer=False)
    assert made.swings
    made.settle()
    assert made.swings
    made.add(71.0, None, longer=False)
    assert not made.swings
