"""When steps since a window are solved as a window again."""

from types import SimpleNamespace

import numpy as np
import pytest

from onboard.identification.free_flyer.recursion import stepped as module
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.free_flyer.recursion.stepped import SteppedTicks
from tests.identification.free_flyer.recorded_flights import PRIOR, online, ticks_of

BATCH, LENGTH_s = 10, 4.0


@pytest.fixture
def ekf(held) -> MotionFilter:
    return online(held, imu_prior=PRIOR)


def ticks_until_due(held, ekf, *, apart: bool) -> int:
    """Ticks of all steps that follow a window of 200."""
    every, at = ticks_of(held), 200
    stepped = SteppedTicks(every.part(slice(0, at)), LENGTH_s, held=True, first=True)
    known = ekf.initial
    while not stepped.due(apart=apart):
        stepped.add(every.part(slice(at - 2, at + BATCH)), ekf.predictor, known)
        at += BATCH
    assert len(stepped.ticks.time_s) == at
    return at


def test_steps_linearised_about_different_states_are_solved_again_a_fifth_later(held, ekf, monkeypatch) -> None:
    length = round(LENGTH_s / ekf.predictor.period_s)
    assert ticks_until_due(held, ekf, apart=False) == pytest.approx(length, abs=BATCH)
    assert ticks_until_due(held, ekf, apart=True) == pytest.approx(240, abs=BATCH)
    monkeypatch.setattr(module, "AGAIN", 2.0 * module.AGAIN)
    assert ticks_until_due(held, ekf, apart=True) > 300


def test_what_is_linearised_well_enough_is_kept_as_long_but_not_solved_again_by_itself(held, ekf) -> None:
    every = ticks_of(held)
    kept = SteppedTicks(every.part(slice(0, 200)), LENGTH_s, held=True, first=True, well=True)
    assert not kept.first
    for at in range(200, 390, BATCH):
        assert not kept.over
        kept.add(every.part(slice(at - 2, at + BATCH)), ekf.predictor, ekf.initial)
        assert not kept.due(apart=True)
    kept.add(every.part(slice(388, 410)), ekf.predictor, ekf.initial)
    assert kept.over
    assert not kept.due(apart=True)


@pytest.mark.parametrize(("mass_sigma", "again"), [(0.02, False), (0.045, True)])
def test_steps_about_a_mass_known_to_a_few_percent_are_not_solved_again(held, ekf, mass_sigma, again) -> None:
    every, solved = ticks_of(held), SimpleNamespace(mass_sigma=mass_sigma, covariance=np.eye(13))
    kept = SteppedTicks(every.part(slice(0, 200)), LENGTH_s, held=True, first=True).after(solved)
    kept.add(every.part(slice(198, 410)), ekf.predictor, ekf.initial)
    assert kept.due(apart=False) is again
