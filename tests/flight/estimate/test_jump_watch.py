"""What a jump of an angle does to the rows of its channel, before and after rows of the estimator were used."""

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
    """Which rows may not be used, and what is said."""
    refused, said = np.zeros(len(rows), bool), []
    for first in range(0, len(rows), batch):
        part = rows[first : first + batch]
        wrong, before, told = watch.watch(part, 1e-4 * part["value_raw"], times_ns(part), in_use)
        refused[max(first + before.start, 0) : first + before.stop] = True
        refused[first : first + len(part)] |= wrong
        said += told
    return refused, said


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_no_row_from_the_jump_on_is_used(rows, batch):
    rows["value_raw"][150:] += 900
    watch = JumpWatch(SIGNAL)
    refused, [said] = watched(watch, rows, batch=batch)
    assert np.flatnonzero(refused)[0] == 150
    assert refused[150:].all()
    assert watch.jumped
    assert (said.severity, said.code) == (Severity.ERROR, "angle_jumped")
    assert "+5.15 deg" in said.text


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_a_jump_before_anything_was_used_costs_only_what_came_before(rows, batch):
    rows["value_raw"][150:] += 900
    watch = JumpWatch(SIGNAL)
    refused, [said] = watched(watch, rows, in_use=False, batch=batch)
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
        refused, said = watched(JumpWatch(SIGNAL), one)
        assert not refused.any()
        assert not said


def test_two_recordings_in_one_log_and_rows_without_a_time_are_not_judged(rows):
    rows["value_raw"][150:] += 900

    def pause(rows):
        return np.where(rows["sequence"] < 150, 0, 2_000_000_000) + 5_000_000 * rows["tick"].astype(np.int64)

    for times_ns in (pause, lambda _: None):
        refused, said = watched(JumpWatch(SIGNAL), rows, times_ns=times_ns)
        assert not refused.any()
        assert not said


@pytest.mark.parametrize("batch", [1, 7, 400])
def test_rows_are_used_again_from_where_the_encoder_reads_as_before(rows, batch):
    rows["value_raw"][150:230] += 900
    watch = JumpWatch(SIGNAL)
    refused, [_, said] = watched(watch, rows, batch=batch)
    assert refused[150:230].all()
    assert not refused[:150].any()
    assert not refused[233:].any()  # a jump is seen three samples later
    assert watch.jumped
    assert (said.severity, said.code) == (Severity.INFO, "angle_jumped_back")


def test_an_encoder_that_changes_once_more_stays_out(rows):
    rows["value_raw"][150:] += 900
    rows["value_raw"][230:] += 500
    refused, [_] = watched(JumpWatch(SIGNAL), rows)
    assert refused[150:].all()
