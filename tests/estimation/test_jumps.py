"""Jumps of an encoder's angle: those that last, and everything else that a step between two samples may be."""

import numpy as np
import pytest

from onboard.estimation.jumps import SCATTERS, TRAVELS, AngleJumps, Jump

SIGMA = 1e-4  # rad
PERIOD_s = 0.005
BATCHES = pytest.mark.parametrize("batch", [1, 3, 10, 1000])


def jumps(angle, batch=1000, sigma=SIGMA, times=None, arrived=None):
    """Each jump, fed ``batch`` at a time."""
    watch, every = AngleJumps(sigma), []
    times = np.arange(len(angle), dtype=np.float64) if times is None else times.astype(np.float64)
    arrived = times if arrived is None else arrived
    for first in range(0, len(angle), batch):
        part = slice(first, first + batch)
        each = watch.watch(angle[part], times[part], arrived[part])
        every += [one._replace(at=first + one.at) for one in each]
    return every


def found(*args, **more):
    """Index and size of each."""
    return [(one.at, one.size) for one in jumps(*args, **more)]


@pytest.fixture
def sweep(rng):
    time_s = np.arange(2000) * PERIOD_s
    return 0.5 * np.sin(2.0 * np.pi * 0.4 * time_s) + SIGMA * rng.normal(size=len(time_s))


@BATCHES
def test_a_zero_that_changes_in_motion_is_found_once(sweep, batch):
    sweep[700:] += 0.05
    [(at, size)] = found(sweep, batch)
    assert (at, size) == (700, pytest.approx(0.05, abs=8.0 * SIGMA))


def test_a_scale_and_a_delay_that_change_are_found_and_so_is_their_end(sweep):
    scaled, late = sweep.copy(), sweep.copy()
    scaled[700:900] *= 1.1
    late[700:900] = sweep[680:880]
    assert [at for at, _ in found(scaled)] == [700, 900]
    assert [at for at, _ in found(late)] == [700, 900]


def test_a_slip_at_rest_is_found_where_the_readings_are_not_all_equal(rng):
    angle = SIGMA * np.rint(rng.normal(size=400))
    angle[200:] += 0.01
    assert [at for at, _ in found(angle)] == [200]


@pytest.mark.parametrize("sigma", [SIGMA, 1e-2 * SIGMA])
def test_a_sweep_and_its_noise_are_no_jump_whatever_noise_is_stated(rng, sigma):
    time_s = np.arange(200_000) * PERIOD_s
    angle = np.sin(2.0 * np.pi * 0.7 * time_s) + SIGMA * rng.normal(size=len(time_s))
    assert not found(angle, sigma=sigma)


@pytest.mark.parametrize(
    "kind", ["wrong once", "wrong twice", "left out", "late by two", "stopped", "held", "repeated"]
)
def test_what_does_not_last_or_is_an_error_of_time_is_no_jump(sweep, kind):
    angle = sweep.copy()
    match kind:
        case "wrong once":
            angle[700] += 0.3
        case "wrong twice":
            angle[700] += 0.3
            angle[702] -= 0.2
        case "left out":
            angle = np.delete(angle, 700)
        case "late by two":
            angle[700:] = sweep[698:-2]
        case "stopped":  # an end stop
            angle[700:] = sweep[700] + SIGMA * np.random.default_rng(1).normal(size=1300)
        case "held":
            angle[700:760] = angle[699]
        case "repeated":
            angle = np.repeat(angle, 5)
    assert not found(angle)


def test_a_gap_or_an_unusable_reading_is_not_bridged(sweep):
    late = sweep.copy()
    late[700:] += 0.3
    ticks = np.arange(len(late))
    ticks[700:] += 1
    assert not found(late, times=ticks)
    late[700] = np.nan
    assert not found(late)
    watch = AngleJumps(SIGMA)
    watch.watch(sweep[:700], np.arange(700.0), np.arange(700.0))
    watch.forget()
    assert not watch.watch(sweep[900:], *[np.arange(900.0, 2000.0)] * 2)


@pytest.mark.parametrize(("times", "count"), [(0.7, 0), (1.5, 1)])
@pytest.mark.parametrize("limit", ["scatter", "travel"])
def test_how_far_a_step_is_from_its_neighbours_decides(limit, times, count):
    """The limits lie where they are said to: at twice of either, the second of the cases is not found."""
    at = np.arange(40.0)
    step = np.full(39, 1e-2) if limit == "travel" else np.where(at[:39] % 2, 1e-4, -1e-4)
    step[20] = times * (TRAVELS * 1e-2 if limit == "travel" else SCATTERS * 1.1e-4)
    assert (TRAVELS, SCATTERS) == (3.0, 10.0)
    assert len(found(np.append(0.0, np.cumsum(step)), sigma=1e-6)) == count


@pytest.mark.parametrize(("larger", "count"), [(12, 0), (30, 0), (45, 1)])
def test_an_encoder_that_makes_such_steps_again_and_again_has_not_jumped(larger, count):
    """As joint 6 of the TX40 does, whose angle is computed from two motors' counts."""
    step = np.full(400, 3.0)
    step[::20] += 12.0
    step[200] = 3.0 + larger
    assert [at > 100 for at, _ in found(np.append(0.0, np.cumsum(step)), sigma=0.3)].count(True) == count


def changed(sweep, kind, first, last):
    """The angle with a fault of an encoder in between."""
    angle = sweep.copy()
    part = slice(first, last)
    match kind:
        case "zero":
            angle[part] += 0.04
        case "scale":
            angle[part] *= 1.3
        case "delay":
            angle[part] = sweep[first - 10 : last - 10]
    return angle


@pytest.mark.parametrize("kind", ["zero", "scale", "delay"])
@pytest.mark.parametrize("last", [815, 900, 1020])
def test_an_encoder_that_is_again_as_before_is_told_from_one_that_changes_once_more(sweep, kind, last):
    first, second = jumps(changed(sweep, kind, 700, last))
    assert (first.at, second.at) == (700, last)
    assert second.undoes(first)
    angle = changed(sweep, kind, 700, last)
    angle[last:] += 2.0 * second.size
    first, second = jumps(angle)
    assert not second.undoes(first)


def test_a_joint_that_moved_while_no_sample_came_has_not_jumped(sweep):
    """A sync box that pauses: samples are numbered on, and a clock that does not know it yet has them evenly apart."""
    angle = np.delete(sweep, np.arange(700, 720))
    arrived = np.delete(np.arange(len(sweep), dtype=np.float64), np.arange(700, 720))
    assert not found(angle, arrived=arrived)
    [(at, _)] = found(angle)
    assert at == 700


def test_an_encoder_that_jumps_to_zero_or_at_rest_is_compared_too():
    to_zero, at_rest = Jump(10, -0.3, 0.3, 0.01), Jump(10, 0.2, 0.0, 0.0)
    back = Jump(90, 0.3, 0.0, 0.01)
    assert back.undoes(to_zero)
    assert not back.undoes(at_rest)
    assert Jump(90, -0.2, 0.2, 0.01).undoes(at_rest)


@pytest.mark.parametrize(("off", "same"), [(0.15, True), (0.3, False), (-0.15, True), (-0.3, False)])
def test_a_jump_back_is_as_large_to_a_fifth(off, same):
    assert Jump(90, -0.2 * (1.0 + off), 0.0, 0.0).undoes(Jump(10, 0.2, 0.0, 0.0)) is same


@pytest.mark.parametrize(("before", "is_found"), [(50, False), (70, True)])
def test_what_64_steps_before_did_is_remembered(before, is_found):
    step = np.full(300, 3.0)
    step[200 - before] += 12.0
    step[200] += 30.0
    assert (201 in [at for at, _ in found(np.append(0.0, np.cumsum(step)), sigma=0.3)]) is is_found


@pytest.mark.parametrize(("pause", "is_found"), [(4.0, True), (6.0, False)])
def test_a_step_of_which_half_was_made_in_a_pause_is_no_jump(pause, is_found):
    step, arrived = np.ones(100), np.arange(101.0)
    step[50] += 10.0
    arrived[51:] += pause
    assert bool(found(np.append(0.0, np.cumsum(step)), arrived=arrived, sigma=0.1)) is is_found
