"""Non-linear least squares with a prior."""

import numpy as np
import pytest

from onboard.estimation.errors import ConvergenceError, RowError, SingularError
from onboard.estimation.maximum_likelihood import Descent, Normal, covariance_of, fit


def exponential(t, y, sigma):
    def predict(x):
        decay = np.exp(-x[1] * t)
        return (x[0] * decay - y) / sigma, np.stack([decay, -x[0] * t * decay], axis=1) / sigma

    return predict


def test_linear_problem_is_the_weighted_least_squares(rng):
    A, y, x0 = rng.normal(size=(30, 4)), rng.normal(size=30), rng.normal(size=4)
    information = np.diag([0.0, 2.0, 0.0, 5.0])
    found = fit(lambda x: (A @ x - y, A), np.zeros(4), x0, information)
    normal = A.T @ A + information
    np.testing.assert_allclose(found.x, np.linalg.solve(normal, A.T @ y + information @ x0), atol=1e-6)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-9)


def test_from_a_far_start_the_minimum_is_found(rng):
    t, truth = np.linspace(0.0, 3.0, 400), np.array([2.0, 1.5])
    y = truth[0] * np.exp(-truth[1] * t) + 0.01 * rng.normal(size=400)
    found = fit(exponential(t, y, 0.01), np.array([0.1, 6.0]), np.zeros(2), np.zeros((2, 2)))
    error = found.x - truth
    assert error @ np.linalg.solve(found.covariance, error) < 13.8  # 99.9 % of chi-squared with two degrees
    assert found.residual_sum / 398 == pytest.approx(1.0, abs=0.2)


def test_covariance_covers(rng):
    t, truth, inside = np.linspace(0.0, 3.0, 50), np.array([2.0, 1.5]), 0
    for _ in range(400):
        y = truth[0] * np.exp(-truth[1] * t) + 0.05 * rng.normal(size=50)
        found = fit(exponential(t, y, 0.05), np.array([1.0, 1.0]), np.zeros(2), np.zeros((2, 2)))
        inside += abs(found.x[1] - truth[1]) < 1.96 * np.sqrt(found.covariance[1, 1])
    assert 366 <= inside <= 393  # three binomial sigmas about 95 %


def test_what_nothing_determines_is_named(rng):
    A = rng.normal(size=(20, 3))
    A[:, 1] = 0.0
    with pytest.raises(SingularError, match="parameter"):
        fit(lambda x: (A @ x, A), np.zeros(3), np.zeros(3), np.zeros((3, 3)))
    A[:, 1] = A[:, 0]
    with pytest.raises(SingularError, match="do not determine"):
        covariance_of(A, np.zeros((3, 3)))


def test_a_valley_without_an_end_does_not_converge():
    with pytest.raises(ConvergenceError, match="not converged"):
        fit(lambda x: (np.exp(-x) * 1e3, -np.diag(np.exp(-x)) * 1e3), np.zeros(1), np.zeros(1), np.zeros((1, 1)), 5)


def run(descent, predict):
    while descent.found is None:
        descent.take(predict(descent.at))


@pytest.mark.parametrize("damping", [1e-12, 1e-9, 1e-5])
def test_a_narrow_bent_valley_is_followed_to_its_end(damping):
    """A damped step promises little there long before the end, and one without damping ends on the wall."""
    predictions = []

    def predict(x):
        predictions.append(x)
        return (
            np.array([x[0], 1e5 * (x[1] - np.sin(x[0]))]),
            np.array([[1.0, 0.0], [-1e5 * np.cos(x[0]), 1e5]]),
        )

    start = np.array([2.5, np.sin(2.5)])
    descent = Descent(start, np.zeros(2), np.zeros((2, 2)), 60, 1e-2, damping)
    run(descent, lambda x: Normal.of(*predict(x)))
    np.testing.assert_allclose(descent.found.x, 0.0, atol=0.1)  # of its sigma, 1
    assert len(predictions) < 40


def test_what_is_short_of_the_minimum_is_as_uncertain_as_the_step_that_is_left_is_long():
    """From (2, 8 / 3), one more prediction at most, in a valley along y = x^3 / 3 that falls towards (0, 0)."""

    def predict(x):
        residual = np.array([10.0 * x[0], 100.0 * (x[1] - x[0] ** 3 / 3.0)])
        return Normal.of(residual, np.array([[10.0, 0.0], [-100.0 * x[0] ** 2, 100.0]]))

    descent = Descent(np.array([2.0, 8.0 / 3.0]), np.zeros(2), np.zeros((2, 2)), 1)
    with pytest.raises(ConvergenceError, match="not converged"):
        run(descent, predict)
    short = descent.short_of_the_minimum()
    np.testing.assert_array_equal(short.x, descent.best)
    there = predict(short.x)
    step = -np.linalg.solve(there.information, there.gradient)  # without damping
    assert np.abs(step).max() > 1.0
    np.testing.assert_allclose(short.covariance, np.linalg.inv(there.information) + np.outer(step, step), rtol=1e-6)
    assert short.residual_sum == pytest.approx(predict(short.x).squares)


def test_a_start_that_predicts_nothing_is_refused():
    with pytest.raises(RowError, match="not finite"):
        fit(lambda x: (x * np.nan, np.eye(1)), np.ones(1), np.zeros(1), np.zeros((1, 1)))


def test_a_derivative_that_is_not_finite_ends_the_iteration():
    with np.errstate(invalid="ignore"), pytest.raises(ConvergenceError, match="derivative"):
        fit(lambda x: (x + 1.0, np.full((1, 1), np.inf)), np.ones(1), np.zeros(1), np.zeros((1, 1)))
