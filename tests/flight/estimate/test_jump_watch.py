"""What a jump of an angle does to the rows of its channel, before and after rows of the estimator were used.

And where the estimator follows it.
"""

import numpy as np
import pytest

from drivers.records import SCALAR, SampleStatus, Severity
from onboard import config
from onboard.flight.estimate.readings.jumps import JumpWatch
from onboard.flight.estimate.readings.roles import roles_of

SIGNAL = roles_of(config.load(config.packaged("rocksat"))).signals["joint_1"]


@pytest.fixture
def rows():
    made = np.zeros(400, SCALAR)
    made["sequence"] = made["tick"] = np.arange(400)
    made["value_raw"] = np.rint(4000.0 * np.sin(0.02 * np.arange(400)))
    made["scale"], made["unit"] = 1e-4, b"rad"
    made["host_ns"] = 5_000_000 * made["tick"]
    return made


def watched(watch, rows, in_use=True, batch=10, times_ns=lambda rows: 5_000_000 * rows["tick"].astype(np.int64)):
    """Which rows may not be used, by how much they are too large, and what is said."""
    refused, off, said = np.zeros(len(rows), bool), np.zeros(len(rows)), []
    for first in range(0, len(rows), batch):
        part = rows[first : first + batch]
        seen = watch.watch(part, 1e-4 * part["value_raw"], times_ns(part), in_use)
        before = slice(max(first + seen.before.start, 0), first + seen.before.stop)
        refused[before] |= seen.before_off == 0.0
        off[before] += seen.before_off
        refused[first : first + len(part)] |= seen.wrong
        off[first : first + len(part)] += seen.off
        said += seen.said
    return refused, off, said


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_no_row_from_the_jump_on_is_used(rows, batch):
    rows["value_raw"][150:] += 900
    watch = JumpWatch(SIGNAL)
    refused, _, [said] = watched(watch, rows, batch=batch)
    assert np.flatnonzero(refused)[0] == 150
    assert refused[150:].all()
    assert watch.jumped
    assert (said.severity, said.code) == (Severity.ERROR, "angle_jumped")
    assert "+5.15 deg" in said.text


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_a_jump_before_anything_was_used_costs_only_what_came_before(rows, batch):
    rows["value_raw"][150:] += 900
    watch = JumpWatch(SIGNAL)
    refused, _, [said] = watched(watch, rows, in_use=False, batch=batch)
    assert refused[:150].all()
    assert not refused[150:].any()
    assert not watch.jumped
    assert said.severity is Severity.WARNING


def test_a_lost_row_or_a_restart_is_no_jump(rows):
    rows["value_raw"][150:] += 900
    lost, again = rows.copy(), rows.copy()
    lost["sequence"][150:] += 1
    again["status"][150] = SampleStatus.AFTER_RESET
    for one in (lost, again):
        refused, _, said = watched(JumpWatch(SIGNAL), one)
        assert not refused.any()
        assert not said


def test_two_recordings_in_one_log_and_rows_without_a_time_are_not_judged(rows):
    rows["value_raw"][150:] += 900

    def pause(rows):
        return np.where(rows["sequence"] < 150, 0, 2_000_000_000) + 5_000_000 * rows["tick"].astype(np.int64)

    for times_ns in (pause, lambda _: None):
        refused, _, said = watched(JumpWatch(SIGNAL), rows, times_ns=times_ns)
        assert not refused.any()
        assert not said


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_rows_are_used_again_from_where_the_encoder_reads_as_before(rows, batch):
    rows["value_raw"][150:230] += 900
    watch = JumpWatch(SIGNAL)
    refused, _, [_, said] = watched(watch, rows, batch=batch)
    assert refused[150:230].all()
    assert not refused[:150].any()
    assert not refused[233:].any()  # a jump is seen three samples later
    assert watch.jumped
    assert (said.severity, said.code) == (Severity.INFO, "angle_jumped_back")


def test_an_encoder_that_changes_once_more_stays_out(rows):
    rows["value_raw"][150:] += 900
    rows["value_raw"][230:] += 500
    refused, _, [_] = watched(JumpWatch(SIGNAL), rows)
    assert refused[150:].all()


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_an_angle_that_is_followed_goes_on_smoothly(rows, batch):
    smooth = 1e-4 * rows["value_raw"]
    rows["value_raw"][150:] += 900
    rows["value_raw"][230:] -= 400
    watch = JumpWatch(SIGNAL, follows=True)
    refused, off, said = watched(watch, rows, batch=batch)
    assert not refused.any()
    np.testing.assert_allclose(1e-4 * rows["value_raw"] - off, smooth, atol=2e-4)
    assert np.flatnonzero(np.diff(off)).tolist() == [149, 229]
    assert [one.severity for one in said] == [Severity.WARNING] * 2
    assert said[0].text.endswith("has changed; the angle goes on without it")
    first, second = watch.new
    assert (first.vehicle_ns, second.vehicle_ns) == (750_000_000, 1_150_000_000)
    assert (first.size, second.size) == (pytest.approx(0.09, abs=2e-4), pytest.approx(-0.04, abs=2e-4))
    np.testing.assert_allclose([first.angle, second.angle], smooth[[150, 230]], atol=3e-4)  # as it was read before
    np.testing.assert_allclose([first.rate, second.rate], np.gradient(smooth, 0.005)[[150, 230]], atol=0.02)


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_an_encoder_that_reads_as_before_has_the_angle_and_the_errors_that_it_had(rows, batch):
    """By a scale of 5 %: of what goes back only the scale is another one, as it was where the first jump was."""
    true = rows["value_raw"].copy()
    rows["value_raw"][100:230] = np.rint(1.05 * true[100:230])
    watch = JumpWatch(SIGNAL, follows=True)
    _, off, said = watched(watch, rows, batch=batch)
    assert not off[:100].any()
    np.testing.assert_allclose(off[230:], 0.0, atol=1e-12)
    np.testing.assert_allclose(off[100:230], 1e-4 * 0.05 * true[100], atol=2e-4)
    first, back = watch.new
    assert back[1:] == (-first.size, *first[2:])
    assert "its angle jumps back" in said[1].text


def test_what_came_before_anything_was_used_is_not_followed(rows):
    rows["value_raw"][150:] += 900
    watch = JumpWatch(SIGNAL, follows=True)
    refused, off, _ = watched(watch, rows, in_use=False)
    assert refused[:150].all()
    assert not off.any()
    assert not watch.new
