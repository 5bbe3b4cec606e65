"""Errors that repeat with the motion: intervals hold the truth however often the motion is repeated."""

import numpy as np
import pytest

from onboard.estimation.recursive.consistency import BlockScores, JackknifeEstimate, phases
from onboard.estimation.recursive.rls import SquareRootRls

RATE_Hz, BLOCK_s, PARAMETERS = 50.0, 0.5, 4


def harmonics(rng: np.random.Generator, at_s: np.ndarray, period_s: float, columns: int) -> np.ndarray:
    """Random series of 1 / period_s and its multiples up to 3 Hz."""
    turns = np.outer(at_s, np.arange(1, int(3 * period_s))) * 2 * np.pi / period_s
    waves = np.hstack([np.cos(turns), np.sin(turns)])
    return waves @ rng.normal(size=(waves.shape[1], columns)) / np.sqrt(0.5 * waves.shape[1])


def recorded(rng: np.random.Generator, period_s: float, repeats: int, noise: float) -> JackknifeEstimate:
    """Readings of zero parameters: an error of the model, a function of the phase, of rms 1, and white noise."""
    t = np.arange(0.0, repeats * period_s, 1.0 / RATE_Hz)
    Y, error = harmonics(rng, t, period_s, PARAMETERS), harmonics(rng, t, period_s, 1)[:, 0]
    y, sigma = error + noise * rng.normal(size=t.size), np.full(t.size, 0.1)
    rls, blocks = SquareRootRls(PARAMETERS), BlockScores(PARAMETERS, BLOCK_s)
    rls.prior(np.zeros(PARAMETERS), np.full(PARAMETERS, 100.0))
    rls.update(Y, y, sigma)
    blocks.add(t, Y, y, sigma)
    return JackknifeEstimate(rls, blocks)


@pytest.mark.parametrize(
    ("period_s", "repeats", "least"),
    [(15.0, 1, 0.9), pytest.param(10.0, 3, 0.9, marks=pytest.mark.campaign), (7.5, 4, 0.9), (8.2, 3, 0.82)],
)  # as four
def test_intervals_hold_the_truth_however_often_a_motion_is_repeated(rng, period_s, repeats, least):
    """With each repetition taken for a witness, 95 % intervals of four of them hold it in two of three cases.

    A period that is no whole number of blocks has no blocks of the same phase: what they share is counted in part.
    """
    holds = []
    for _ in range(150):
        found = recorded(rng, period_s, repeats, noise=0.1).combination(np.eye(PARAMETERS))
        holds.append((found.low < 0.0) & (found.high > 0.0))
    assert least <= np.mean(holds) <= 0.99


def test_repetitions_of_noise_do_count(rng):
    """The motion is repeated, what is left over of it is not: three periods are as good as three others."""
    spread = {
        repeats: np.mean(
            [recorded(rng, 10.0, repeats, noise=10.0).combination(np.eye(PARAMETERS)).sigma for _ in range(40)]
        )
        for repeats in (1, 4)
    }
    assert spread[4] == pytest.approx(0.5 * spread[1], rel=0.15)


def test_what_does_not_repeat_is_not_added_up(rng):
    """A hundred recordings with nothing in common: as rarely as the policy doubts, a repetition is found."""
    found = [len(np.unique(phases(np.arange(60.0), rng.normal(size=(60, 12))))) for _ in range(100)]
    assert sum(groups < 60 for groups in found) <= 2
    assert len(phases(np.arange(4.0), rng.normal(size=(4, 3)))) == 4
    assert (phases(np.arange(40.0), np.zeros((40, 3))) == np.arange(40)).all()


def test_recordings_have_phases_of_their_own(rng):
    """Two of them, of the same period, far apart: no phase holds blocks of both."""
    one, two = rng.normal(size=(2, 10, 12))
    numbers = np.r_[np.arange(30.0), 1e6 + np.arange(30.0)]
    group = phases(numbers, np.vstack([one] * 3 + [two] * 3))
    assert len(np.unique(group)) == 20
    assert not set(group[:30]) & set(group[30:])
    assert (group[:10] == group[10:20]).all()


def test_the_shortest_period_has_three_blocks(rng):
    """One of two leaves two groups, which have no scatter; its multiple of four is found."""
    groups = [len(np.unique(phases(np.arange(60.0), np.tile(rng.normal(size=(k, 12)), (60 // k, 1))))) for k in (2, 3)]
    assert groups == [4, 3]
