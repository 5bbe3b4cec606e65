"""Alarms on innovations: as rare as stated while nothing changes, there when something does, never for one glitch."""

import numpy as np
import pytest

from onboard.estimation.change import ChangeDetector

TICKS = 10


def squares(rng, batches, scale=1.0):
    return (scale * rng.normal(size=(batches, TICKS, 6)) ** 2).sum(axis=2)


def test_alarms_without_a_change_are_as_rare_as_stated(rng):
    stated = 60.0
    detector = ChangeDetector(stated, 36_000.0, 6)
    hours = 1.0
    alarms = sum(detector.check(batch).alarm for batch in squares(rng, round(hours * 36_000)))
    assert 0 < alarms <= stated * hours + 4.0 * np.sqrt(stated * hours)


@pytest.mark.parametrize(("scale", "batches"), [(10.0, 1), (2.5, 2), (1.6, 8)])
def test_a_change_is_found_the_sooner_the_larger_it_is(rng, scale, batches):
    detector = ChangeDetector(0.1, 36_000.0, 6)
    assert not any(detector.check(batch).alarm for batch in squares(rng, 100))
    verdicts = [detector.check(batch) for batch in squares(rng, batches, scale)]
    assert verdicts[-1].alarm
    assert verdicts[-1].score > 1.3


@pytest.mark.parametrize("ticks", [10, 5])
def test_one_glitch_is_named_and_is_no_alarm(rng, ticks):
    detector = ChangeDetector(0.1, 36_000.0, 6)
    for batch in squares(rng, 30):
        detector.check(batch)
    batch = squares(rng, 1)[0, :ticks]
    batch[4] = 1e6
    verdict = detector.check(batch)
    assert verdict.glitches.tolist() == [k == 4 for k in range(ticks)]
    assert not verdict.alarm
    assert not verdict.suspect
    assert not any(detector.check(batch).alarm for batch in squares(rng, 10))


def test_not_even_when_it_is_all_there_is():
    verdict = ChangeDetector(0.1, 36_000.0, 6).check(np.array([1e6]))
    assert verdict.glitches.all()
    assert not verdict.alarm
    assert not verdict.suspect


def test_two_such_ticks_are_not_taken_in_and_four_are_an_alarm(rng):
    detector = ChangeDetector(0.1, 36_000.0, 6)
    batch = squares(rng, 1)[0]
    batch[4:6] = 1e6
    assert detector.check(batch).suspect
    detector.forget()
    batch[6:8] = 1e6
    assert detector.check(batch).alarm


def test_what_was_before_a_new_beginning_does_not_count(rng):
    detector = ChangeDetector(0.1, 36_000.0, 6)
    for batch in squares(rng, 3, 1.4):
        detector.check(batch)
    detector.forget()
    assert detector.check(squares(rng, 1)[0]).batches == 1
