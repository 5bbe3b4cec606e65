"""Errors of bodies as logarithms of factors: near the drawing as they are stated, and all masses in one direction."""

import numpy as np
import pytest

from onboard.identification.free_flyer.prediction.scaled import Scaled
from tests.native.oracle.errors import derived

DRAWN = np.zeros((3, 10))  # the last without mass
DRAWN[:2, :5] = [[100.0, 3.0, 0.0, -2.0, 5.0], [30.0, 0.0, 1.0, 0.0, 2.0]]
AT = np.arange(2, 32)


@pytest.fixture
def scaled():
    return Scaled(AT, DRAWN)


@pytest.fixture
def state(rng):
    return np.concatenate([[7.0, 8.0], 3.0 * rng.normal(size=30), [9.0]])


def bodies(scaled, state):
    return DRAWN + scaled.linear(state)[AT].reshape(DRAWN.shape)


def test_small_errors_are_as_they_are_stated(scaled, state):
    small = 1e-6 * state
    np.testing.assert_allclose(scaled.linear(small), small, atol=1e-10)


def test_all_masses_grow_along_one_direction_wherever_the_state_is(scaled, state):
    along = np.zeros(33)
    along[AT] = DRAWN.ravel()
    for factor in (0.5, 0.9, 1.1, 2.0):
        heavier = bodies(scaled, state + np.log(factor) * along)
        np.testing.assert_allclose(heavier[:2], factor * bodies(scaled, state)[:2], rtol=1e-12)


def test_derivatives_are_finite_differences(scaled, state, rng):
    by_linear = rng.normal(size=(4, 33))
    found = derived(AT, DRAWN, by_linear, state)  # of the oracle, which the compiled core's prediction is held against
    step = 1e-6
    eye = step * np.eye(33)
    expected = np.stack([by_linear @ (scaled.linear(state + e) - scaled.linear(state - e)) for e in eye], axis=1)
    np.testing.assert_allclose(found, expected / (2.0 * step), rtol=1e-7, atol=1e-7)


def test_without_bodies_nothing_changes():
    none, state = Scaled(np.zeros(0, np.intp), np.zeros((0, 10))), np.ones(4)
    np.testing.assert_array_equal(none.linear(state), state)
