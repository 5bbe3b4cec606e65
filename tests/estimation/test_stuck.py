"""Runs of equal readings: those that noise, quantisation or rest make, and those that only a held value makes."""

import math

import numpy as np
import pytest

from onboard.estimation.policy import READING
from onboard.estimation.stuck import StuckReadings, longest_run


def judged(readings, longest, batch, usable=None, travels=False):
    """Which readings are found stuck in the end, fed ``batch`` at a time."""
    readings = np.asarray(readings, np.float64).reshape(len(readings), -1)
    usable = np.ones(len(readings), bool) if usable is None else usable
    watch, found = StuckReadings(readings.shape[1], longest, travels=travels), np.zeros(len(readings), bool)
    for first in range(0, len(readings), batch):
        part = slice(first, first + batch)
        found[part], before = watch.watch(readings[part], usable[part])
        found[first + before.start : first + before.stop] = True
    return found


BATCHES = pytest.mark.parametrize(
    "batch", [1, pytest.param(3, marks=pytest.mark.campaign), 10, 1000]
)  # one by one, few, many, all


@pytest.mark.parametrize("sigma", [1.5, 12.0, 200.0])
def test_the_longest_run_is_as_rare_as_it_says(rng, sigma):
    """Half the noise is taken, so a run of half as many is rarer than the square root of the chance, and counted."""
    longest = longest_run([sigma], 0.0)
    runs = np.diff(np.flatnonzero(np.diff(np.rint(sigma * rng.normal(size=400_000)))))
    assert runs.size > 100_000
    assert runs.max() < longest
    chance_of_two = np.mean(runs >= 2)
    assert chance_of_two ** (longest - 1) < READING


def test_noise_below_a_count_tells_nothing():
    assert longest_run([0.29], 0.0) == np.inf
    assert longest_run([5.0], 0.999) == np.inf  # a filter that remembers
    assert longest_run([np.inf], 0.0) == np.inf


@BATCHES
def test_a_held_cell_is_stuck_from_its_first_held_reading_to_its_last(rng, batch):
    readings = np.rint(25.0 * rng.normal(size=400))
    readings[100:112] = readings[99]
    readings[300:] = readings[299]
    found = judged(readings, longest_run([25.0], 0.1), batch)
    expected = np.zeros(400, bool)
    expected[99:112] = expected[299:] = True
    np.testing.assert_array_equal(found, expected)


@BATCHES
def test_saturated_readings_are_no_run(rng, batch):
    readings = np.rint(25.0 * rng.normal(size=200))
    readings[50:150] = 500_000
    usable = np.abs(readings) < 500_000
    assert not judged(readings, longest_run([25.0], 0.0), batch, usable).any()


def sweep(samples=2000, counts=15_000.0):
    t = np.linspace(0.0, 1.0, samples)
    return np.rint(counts * (10 * t**3 - 15 * t**4 + 6 * t**5))  # from rest to rest


@BATCHES
def test_a_moving_joint_whose_encoder_freezes_is_stuck(batch):
    angle = np.concatenate([np.zeros(50), sweep(400), np.full(50, 15_000.0)])
    frozen = angle.copy()
    frozen[200:210] = angle[200]
    found = judged(frozen, math.inf, batch, travels=True)
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(200, 210))


@BATCHES
def test_an_encoder_that_freezes_at_rest_is_found_out_when_it_jumps(batch):
    angle = np.concatenate([np.zeros(50), sweep(400)])
    angle[40:200] = 0.0
    found = judged(angle, math.inf, batch, travels=True)
    assert found[10:200].all()
    assert not found[200:].any()


LONG = pytest.mark.parametrize(
    "batch", [pytest.param(1, marks=pytest.mark.campaign), 10, 1000]
)  # one by one: shorter ones, above


@LONG
def test_a_joint_at_rest_or_slow_or_starting_is_not_stuck(batch):
    assert not judged(
        np.concatenate([np.zeros(500), sweep(), np.full(500, 15_000.0)]), math.inf, batch, travels=True
    ).any()
    assert not judged(sweep(20_000), math.inf, batch, travels=True).any()  # a count every few samples


@LONG
def test_noise_of_an_angle_that_repeats_by_chance_after_a_large_difference_is_not_stuck(rng, batch):
    """An AS5048A's noise of 2.7 counts: of 40 s at 200 Hz of four joints some runs of four begin with eight counts."""
    angle = np.rint(1000.0 * np.sin(0.003 * np.arange(32_000)) + 2.7 * rng.normal(size=32_000))
    longest = longest_run([2.7], 0.0)
    assert judged(angle, math.inf, batch, travels=True).any()
    assert not judged(angle, longest, batch, travels=True).any()
    frozen = angle.copy()
    frozen[20_500:20_600] = angle[20_500]
    found = judged(frozen, longest, batch, travels=True)
    assert found[20_500:20_600].all()
    assert found.sum() < 105
