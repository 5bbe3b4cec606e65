"""What is left of a considered error that rows tell, and of one that they do not."""

import numpy as np
import pytest

from onboard.identification.rows.stated_errors import fitted_corrections
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.identification.rows.stated_errors.fitted_corrections import FittedCorrections

TOLD = Considered("scale of a", "cell", "scale", 0.1)
HIDDEN = Considered("scale of b", "cell", "scale", 0.1)  # its effect is the first parameter's
PRIOR = 1e-6 * np.eye(2), np.zeros(2)


def factors(C):
    """Of effects that no parameter changes, (m, k (2 + 1))."""
    return np.stack([np.zeros_like(C), np.zeros_like(C), C], axis=2).reshape(len(C), -1)


def fitted(rng, size, ticks=400):
    """The errors after rows of y = Y chi + C c, with c = (size, 0.05), in blocks of ten rows."""
    time_s = 0.01 * np.arange(ticks)
    Y, chi = rng.normal(size=(ticks, 2)), np.array([2.0, -1.0])
    C = np.column_stack([np.sin(3.0 * time_s), Y[:, 0]])
    y = Y @ chi + C @ [size, 0.05] + 0.05 * rng.normal(size=ticks)
    one = FittedCorrections(2, (TOLD, HIDDEN), 0.1)
    one.add(time_s, Y, y, np.full(ticks, 0.05), factors(C), None, chi)
    return one.fitted(*PRIOR, 0.02, chi)


@pytest.mark.parametrize("size", [0.0, 0.1, -0.3])
def test_an_error_that_rows_tell_is_as_large_as_it_is(rng, size):
    found = fitted(rng, size)
    rms = np.sqrt(np.diag(found.root @ found.root.T))
    assert rms[0] == pytest.approx(np.hypot(size, 0.006), abs=0.006)  # of its fit: 0.05 / sqrt(400 / 2)
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


def test_noise_beyond_what_is_stated_widens_what_is_left():
    """Rows three times as noisy as their sigma: nine times the variance, by the scatter of the blocks."""
    scales = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time_s = 0.01 * np.arange(400)
        Y, C = rng.normal(size=(400, 2)), np.sin(3.0 * time_s)[:, None]
        one = FittedCorrections(2, (TOLD,), 0.1)
        y = Y @ [2.0, -1.0] + 0.15 * rng.normal(size=400)
        one.add(time_s, Y, y, np.full(400, 0.05), factors(C), None, np.ones(2))
        found = one.fitted(*PRIOR, 0.02, np.ones(2))
        assert found.noise is not None
        scales.append(found.noise[0])
        assert 20.0 < found.noise[1] < 120.0  # 40 blocks, three directions
    assert np.mean(scales) == pytest.approx(9.0, rel=0.1)


@pytest.mark.parametrize(("kept", "size"), [(10**6, 0.2), (0, 0.1)])
def test_an_effect_is_taken_at_the_last_estimate_while_its_rows_are_kept(rng, monkeypatch, kept, size):
    """Twice the parameter is half the error: rows were added with the parameter at twice its value."""
    monkeypatch.setattr(fitted_corrections, "_MOST_KEPT", kept)
    time_s, chi = 0.01 * np.arange(400), np.array([2.0, -1.0])
    Y, wave = rng.normal(size=(400, 2)), np.sin(3.0 * time_s)
    D = np.stack([wave, 0.0 * wave, 0.0 * wave], axis=1)  # of one error, on the first parameter
    y = Y @ chi + 0.2 * (D @ [*chi, 1.0]) + 0.001 * rng.normal(size=400)
    one = FittedCorrections(2, (Considered("scale of a", "cell", "scale", 1.0),), 0.1)
    for first in range(0, 400, 100):
        part = slice(first, first + 100)
        one.add(time_s[part], Y[part], y[part], np.full(100, 0.001), D[part], None, 2.0 * chi)
    [[rms]] = one.fitted(*PRIOR, 0.001, chi).root
    assert rms == pytest.approx(size, rel=0.03)


def test_noise_of_the_reading_is_no_scale_of_it():
    """f (1 - c) + w chi = 0, nothing is on the left: with the noise's power not taken off c is found at 2 %."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        time_s, chi, sigma, equation = 0.01 * np.arange(600), 2.0, 0.3, 0.05
        w = rng.normal(size=(600, 2))  # of the rows along x and along y
        f = (
            -chi * w
            + equation * rng.normal(size=(600, 2))
            + np.column_stack([sigma * rng.normal(size=600), np.zeros(600)])
        )
        noise = np.zeros((1200, 9, 2))  # of f along x, which is in the known part: on the left-hand side
        noise[:600, 6, -1] = -sigma
        C = np.concatenate([-f[:, 0], np.zeros(600)])
        one = FittedCorrections(1, (Considered("scale", "imu", "accelerometer_scale", 0.005, axis=0),), 0.1)
        rows = (
            np.tile(time_s, 2),
            w.T.reshape(-1, 1),
            -f.T.ravel(),
            np.repeat([np.hypot(sigma, equation), equation], 600),
        )
        one.add(*rows, np.stack([0.0 * C, C], axis=1), noise, np.array([chi]))
        found += one.fitted(np.array([[1e-6]]), np.zeros(1), 0.15, np.array([chi])).in_sigmas.values()
    assert len(found) == 10
    assert abs(np.mean(found)) < 1.0
    assert np.sqrt(np.mean(np.square(found))) < 1.6


def test_a_sum_of_errors_that_only_noise_tells_stays_as_stated():
    """f (1 - c_k) + w chi = 0 along two axes: a scale of both is the noise of f, half of which is not there."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        n, sigma, equation, chi = 600, 1.0, 0.05, 2.0
        w = rng.normal(size=(n, 2))
        f = -chi * w * [1.02, 0.98] + rng.normal(size=(n, 2)) * np.hypot(0.7 * sigma, equation)
        noise = np.zeros((2 * n, 9, 2))  # of f, which is in the known part
        for axis in range(2):
            noise[axis * n : (axis + 1) * n, 6 + axis, -1] = -sigma
        scales = tuple(Considered(f"scale {k}", "imu", "accelerometer_scale", 0.02, axis=k) for k in range(2))
        C = np.zeros((2, n, 2))
        C[0, :, 0], C[1, :, 1] = -f[:, 0], -f[:, 1]
        D = np.stack([np.zeros((2 * n, 2)), C.reshape(-1, 2)], axis=2)
        one = FittedCorrections(1, scales, 0.1)
        times, row_sigma = np.tile(0.01 * np.arange(n), 2), np.full(2 * n, np.hypot(sigma, equation))
        one.add(times, w.T.reshape(-1, 1), -f.T.ravel(), row_sigma, D.reshape(2 * n, -1), noise, np.array([chi]))
        root = one.fitted(np.array([[1e-6]]), np.zeros(1), 0.15, np.array([chi])).root
        assert np.linalg.norm(root @ np.full(2, 0.5**0.5)) == pytest.approx(0.02, rel=0.1)
