"""An estimate that is corrected for noise of the joints, and the errors by whose products that is computed."""

import numpy as np
import pytest

from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.free_flyer.prediction import joint_noise
from onboard.identification.free_flyer.prediction.joint_noise import (
    PRODUCT,
    NoiseAdded,
    at_once,
    correction_of,
    root_of,
)


def corrected(x, P, added, sigma, released=None):
    """Mean, (p,), and covariance, (p, p)."""
    by = correction_of((x, P), added, sigma, released)
    return x + by.shift, P + by.root @ by.root.T


def test_an_estimate_is_corrected_for_noise_with_doubt_in_its_power():
    covariance, gradient = np.array([[4.0, 1.0], [1.0, 2.0]]), np.array([0.5, -0.2])
    added = NoiseAdded(gradient, np.zeros((2, 2)))  # nothing in the information
    correction = correction_of((np.ones(2), covariance), added, np.full(2, np.nan))
    np.testing.assert_allclose(correction.shift, covariance @ gradient)
    np.testing.assert_allclose(correction.sigma, 0.2 * correction.shift)
    np.testing.assert_allclose(correction.covariance, 0.04 * np.outer(correction.shift, correction.shift))
    part = correction.part(slice(1, 2))
    assert (part.shift, part.sigma) == (correction.shift[1:], correction.sigma[1:])


@pytest.mark.parametrize("rank", [1, 2, 4])
@pytest.mark.parametrize("wider", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_the_pair_is_that_of_the_prior_and_of_the_godambe_information(seed, wider, rank, monkeypatch):
    """Mean and covariance of a Gaussian prior with the estimating equation ``K (t - y) = 0`` of covariance V.

    Of noise in some directions only as in all of them: one that is known by the prior seemed to be known by less.
    """
    monkeypatch.setattr(joint_noise, "NOISELESS", 0.0)
    rng, p, sigma = np.random.default_rng(seed), 4, np.array([0.7, np.nan, 1.5, 0.9])
    A, B = rng.normal(size=(9, p)), 0.6 * rng.normal(size=(p, rank))
    H, N, x = 3.0 * A.T @ A, B @ B.T, rng.normal(size=p)
    g, released = N @ rng.normal(size=p), np.eye(p)[:, :1] * 0.8 / sigma[0]  # a constant that may be far off
    prior = np.diag(np.nan_to_num(1.0 / sigma**2)) - wider * released @ released.T
    P = np.linalg.inv(prior + H)
    mean, covariance = corrected(x, P, NoiseAdded(g, N, 6.0, 10), sigma, released if wider else None)
    K, V = H - N, H + 0.6 * N + NOISE_SIGMA**2 * np.outer(g, g)
    assert np.linalg.eigvalsh(K).min() > 0.0
    known = np.linalg.inv(prior + K @ np.linalg.solve(V, K))
    np.testing.assert_allclose(covariance, known, rtol=1e-6, atol=1e-9)
    by_gradient = np.linalg.solve(P, x) + g - N @ x  # of the readings, at zero
    np.testing.assert_allclose(mean, known @ K @ np.linalg.solve(V, by_gradient), rtol=1e-6, atol=1e-8)


def test_the_doubt_is_what_another_power_of_the_noise_would_have_changed():
    """Of the estimating equation: how much it tells is as it is."""
    P, sigma, x = np.diag([1e-2, 4e-2]), np.array([0.5, np.nan]), np.array([0.1, -0.3])
    N, g = np.diag([30.0, 2.0]), np.array([0.4, 0.1])
    doubt = correction_of((x, P), NoiseAdded(g, N), sigma).sigma
    prior = np.diag([4.0, 0.0])
    K = np.linalg.inv(P) - prior - N
    told = K @ np.linalg.inv(K + N + NOISE_SIGMA**2 * np.outer(g, g))
    mean = corrected(x, P, NoiseAdded(g, N), sigma)[0]
    moved = np.linalg.solve(prior + told @ K, told @ (g + N @ (mean - x)))  # K falls by N, the gradient rises by g
    np.testing.assert_allclose(doubt, NOISE_SIGMA * moved, rtol=1e-9)


def test_at_the_root_gradients_without_noise_and_that_of_the_prior_sum_to_nothing(rng):
    sigma, A, B = np.array([0.7, np.nan, 1.5, 0.9]), rng.normal(size=(9, 4)), 0.6 * rng.normal(size=(4, 2))
    P, N, g = np.linalg.inv(np.diag(np.nan_to_num(1.0 / sigma**2)) + 3.0 * A.T @ A), B @ B.T, B @ rng.normal(size=2)
    found = root_of(P, NoiseAdded(g, N, 6.0, 10), sigma)
    slopes, scores = np.linalg.inv(P) - N, np.linalg.inv(P) + 0.6 * N  # of the sum, and what it scatters by
    np.testing.assert_allclose(slopes @ found.shift, g, atol=1e-12)
    np.testing.assert_allclose(slopes @ (P + found.root @ found.root.T) @ slopes, scores, atol=1e-9)
    doubt = np.linalg.solve(slopes, g + N @ found.shift)  # more noise: a larger gradient, less information
    np.testing.assert_allclose(found.sigma, NOISE_SIGMA * doubt, atol=1e-12)


def test_a_direction_of_which_all_is_noise_is_as_wide_as_stated_at_the_root():
    found = root_of(np.diag([1e-4, 1e-4]), NoiseAdded(np.zeros(2), np.diag([0.93e4, 0.0])), np.array([0.5, 3.0]))
    assert np.sqrt(1e-4 + np.square(found.root).sum(axis=1)) == pytest.approx([0.5, 0.01], rel=1e-3)


def test_noise_that_is_a_third_of_the_information_is_taken_out_of_it():
    """A regression on columns read with noise of a power that is known to a fifth.

    Answers of many data have the mean and the scatter that are said, products of noise counted.
    """
    rng, rows, true, noise = np.random.default_rng(3), 200, np.array([2.0, -1.0, 0.5]), np.array([0.6, 0.0, 0.3])
    columns = rng.standard_normal((rows, 3)) @ [[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.8, 0.6]]
    R = np.sqrt(1.0 + (true**2 @ np.square(noise)))  # of a row: its reading, and what noise of the columns makes of it
    plain, apart, squares = list[np.ndarray](), list[np.ndarray](), list[float]()
    for _ in range(1000):
        power = 1.0 + NOISE_SIGMA * rng.standard_normal()
        read = columns + np.sqrt(power) * noise * rng.standard_normal(columns.shape)
        P = np.linalg.inv(read.T @ read / R**2)
        x = P @ (read.T @ (columns @ true + rng.standard_normal(rows))) / R**2
        N, products = rows * np.diag(np.square(noise)) / R**2, PRODUCT * rows * (noise**2 @ x**2) / R**2
        mean, spread = corrected(x, P, NoiseAdded(N @ x, N, products, rows), np.full(3, np.nan))
        plain.append((x - true) / np.sqrt(np.diag(P)))
        apart.append((mean - true) / np.sqrt(np.diag(spread)))
        squares.append((mean - true) @ np.linalg.solve(spread, mean - true))
    assert np.abs(np.mean(plain, axis=0)).max() > 3.0
    assert np.abs(np.mean(apart, axis=0)).max() < 0.3
    rms = np.sqrt(np.mean(np.square(apart), axis=0))
    assert (rms > 0.85).all()
    assert (rms < 1.15).all()
    assert np.mean(squares) / 3.0 == pytest.approx(1.0, abs=0.1)  # along every direction


def test_what_is_nearly_all_noise_is_known_by_what_is_stated():
    """The more of the information is noise, the nearer mean and covariance are to the prior's, and never beyond."""
    x, P, sigma = np.array([0.3, 1.0]), np.diag([1e-4, 1e-4]), np.array([0.5, 3.0])
    means, sigmas = list[float](), list[float]()
    for share in (0.5, 0.9, 0.99, 0.999, 1.0, 1.1):
        N = np.diag([share / 1e-4, 0.0])
        mean, covariance = corrected(x, P, NoiseAdded(N @ x, N), sigma)
        means.append(mean[0])
        sigmas.append(np.sqrt(covariance[0, 0]))
        assert (mean[1], covariance[1, 1]) == (x[1], P[1, 1])
        assert covariance[0, 1] == 0.0
    assert np.diff(sigmas[:5]).min() > 0.0
    assert max(sigmas) <= 0.5 + 1e-9
    assert sigmas[-2:] == pytest.approx([0.5, 0.5], rel=1e-6)  # nothing is told
    assert means[-2:] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert sigmas[0] < 0.1  # by the readings


def test_what_noise_has_added_is_summed_with_its_scatter_and_is_nothing_to_what_is_another_one():
    one, other = (NoiseAdded(np.full(3, k), np.full((3, 3), k), 4.0 * k, 10) for k in (1.0, 2.0))
    both = one.plus(other)
    assert both.scattering == pytest.approx(1.0 + 12.0 / 20)
    np.testing.assert_array_equal(both.gradient, 3.0)
    for some in (one.plus(NoiseAdded.none(3)), NoiseAdded.none(3).plus(one)):
        assert some is one
    assert NoiseAdded.none(3).scattering == 1.0
    np.testing.assert_array_equal(both.moved(np.array([1.0, 0.0, 2.0])).gradient, 12.0)  # to first order
    assert NoiseAdded.none(3).moved(np.ones(3)).information.size == 0
    left = both.but_for(slice(0, 2), np.array([1.0, 1.0, 7.0]))  # where they were is still in the others
    assert left.gradient.tolist() == [0.0, 0.0, 9.0]
    assert left.information.nonzero() == (np.array([2]), np.array([2]))
    assert left.scattering == both.scattering


def test_products_of_the_errors_of_two_joints_sum_to_nothing(rng):
    """Over a cycle of ticks, and each by itself of any two; each has its size at every tick."""
    joints, first = 5, 37
    cycle = 32  # the next power of two beyond twice as many errors
    sigma = np.broadcast_to(rng.uniform(0.5, 2.0, (2, joints)), (cycle, 2, joints))
    for begins in (0, cycle * first):
        errors = at_once(sigma, begins)
        np.testing.assert_array_equal(np.abs(errors), sigma)
        each = errors.reshape(cycle, -1)
        np.testing.assert_array_equal(each[::2], -each[1::2])
        np.testing.assert_allclose(each.T @ each, np.diag(cycle * sigma[0].ravel() ** 2), atol=1e-12)
    whole = at_once(np.tile(sigma, (2, 1, 1)), 0)
    np.testing.assert_array_equal(at_once(sigma, 11), whole[11 : 11 + cycle])  # by the number of the tick
