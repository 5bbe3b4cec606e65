"""What is left of a considered error that rows tell, and of one that they do not."""

import numpy as np
import pytest

from onboard.identification.rows.considered import Considered
from onboard.identification.rows.fitted_corrections import FittedCorrections

TOLD = Considered("scale of a", "cell", "scale", 0.1)
HIDDEN = Considered("scale of b", "cell", "scale", 0.1)  # its effect is the first parameter's
PRIOR = 1e-6 * np.eye(2), np.zeros(2)


def fitted(rng, size, ticks=400):
    """The errors after rows of y = Y chi + C c, with c = (size, 0.05), in blocks of ten rows."""
    time_s = 0.01 * np.arange(ticks)
    Y, chi = rng.normal(size=(ticks, 2)), np.array([2.0, -1.0])
    C = np.column_stack([np.sin(3.0 * time_s), Y[:, 0]])
    y = Y @ chi + C @ [size, 0.05] + 0.05 * rng.normal(size=ticks)
    one = FittedCorrections(2, (TOLD, HIDDEN), 0.1)
    one.add(time_s, Y, y, np.full(ticks, 0.05), C, None, chi)
    return one.fitted(*PRIOR, 0.02)


@pytest.mark.parametrize("size", [0.0, 0.1, -0.3])
def test_an_error_that_rows_tell_is_as_large_as_it_is(rng, size):
    found = fitted(rng, size)
    rms = np.sqrt(np.diag(found.root @ found.root.T))
    of_40_blocks = 2.0227 / 1.96  # Student's t
    assert rms[0] == pytest.approx(of_40_blocks * np.hypot(size, 0.006), abs=0.006)  # of its fit: 0.05 / sqrt(400 / 2)
    assert set(found.in_sigmas) == {TOLD.name}


def test_one_that_the_parameters_reproduce_stays_as_stated(rng):
    found = fitted(rng, 0.1)
    assert found.root[1] == pytest.approx([0.0, HIDDEN.sigma], abs=1e-12)


def test_what_is_left_of_it_covers_it_as_often_as_it_should():
    """Over errors drawn from the stated sigma, squares of error over rms are about one in the mean."""
    squares = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        size = 0.1 * rng.normal()
        squares.append(size**2 / (fitted(rng, size, 60).root ** 2)[0].sum())
    assert 0.4 < np.mean(squares) < 1.05
