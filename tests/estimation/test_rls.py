"""RLS laws: equals batch least squares and other people's Kalman filters, never loses definiteness, never is silent."""

from itertools import pairwise

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.estimation.errors import EstimationError, RowError, SingularError
from onboard.estimation.recursive.rls import SquareRootRls


def problem(rng, p=5, n=60):
    truth = rng.normal(size=p)
    Y = rng.normal(size=(n, p))
    sigma = rng.uniform(0.1, 1.0, n)
    return truth, Y, Y @ truth + sigma * rng.normal(size=n), sigma


@given(
    seed=st.integers(0, 2**32 - 1),
    p=st.integers(1, 12),
    cuts=st.lists(st.integers(0, 60), max_size=8),
)
@settings(max_examples=60, deadline=None)
def test_any_batching_equals_weighted_least_squares(seed, p, cuts):
    rng = np.random.default_rng(seed)
    _, Y, y, sigma = problem(rng, p)
    rls = SquareRootRls(p)
    edges = sorted({0, 60, *cuts})
    for a, b in pairwise(edges):
        rls.update(Y[a:b], y[a:b], sigma[a:b])
    W = Y / sigma[:, None]
    mean, residual, *_ = np.linalg.lstsq(W, y / sigma, rcond=None)
    found = rls.solve()
    np.testing.assert_allclose(found.mean, mean, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(W.T @ W), rtol=1e-7, atol=1e-12)
    assert found.residual_sum == pytest.approx(residual[0], rel=1e-8)
    assert found.rows == 60


def test_prior_is_what_a_row_of_its_own_would_be(rng):
    _, Y, y, sigma = problem(rng, 3)
    center, spread = np.array([1.0, -2.0, 3.0]), np.array([0.3, np.inf, 0.1])
    rls = SquareRootRls(3)
    rls.prior(center, spread)
    rls.update(Y, y, sigma)
    rows = np.vstack([Y / sigma[:, None], np.diag(1 / spread)[[0, 2]]])
    right = np.concatenate([y / sigma, (center / spread)[[0, 2]]])
    np.testing.assert_allclose(rls.solve().mean, np.linalg.lstsq(rows, right, rcond=None)[0], rtol=1e-10)


def test_full_prior_covariance_comes_back_before_any_row(rng):
    root = rng.normal(size=(4, 4)) * [1e-3, 1.0, 1e3, 1.0]
    covariance = root.T @ root
    rls = SquareRootRls(4)
    rls.prior(np.arange(4.0), covariance)
    found = rls.solve()
    np.testing.assert_allclose(found.mean, np.arange(4.0), atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-8)
    information, right = rls.prior_equations()
    np.testing.assert_allclose(information, np.linalg.inv(covariance), rtol=1e-8)
    np.testing.assert_allclose(right, information @ np.arange(4.0), rtol=1e-8)
    np.testing.assert_allclose(rls.information_root.T @ rls.information_root, information, rtol=1e-8)


def test_equals_filterpy_kalman_filter(rng):
    p = 4
    _, Y, y, sigma = problem(rng, p)
    kalman = KalmanFilter(dim_x=p, dim_z=1)
    kalman.F, kalman.Q, kalman.P = np.eye(p), np.zeros((p, p)), np.eye(p) * 9.0
    rls = SquareRootRls(p)
    rls.prior(np.zeros(p), np.full(p, 3.0))
    for k in range(y.size):
        kalman.update(y[k : k + 1], R=sigma[k] ** 2, H=Y[k : k + 1])
        rls.update(Y[k : k + 1], y[k : k + 1], sigma[k : k + 1])
    found = rls.solve()
    np.testing.assert_allclose(found.mean, kalman.x[:, 0], rtol=1e-7)
    np.testing.assert_allclose(found.covariance, kalman.P, rtol=1e-6, atol=1e-12)


def test_lapack_refusing_is_not_passed_over(monkeypatch):
    monkeypatch.setattr("onboard.estimation.recursive.rls.lapack.dtpqrt", lambda *a, **k: (a[2], a[3], None, -4))
    with pytest.raises(AssertionError, match="argument 4"):
        SquareRootRls(1).update(np.ones((1, 1)), np.ones(1), np.ones(1))


def test_after_many_rows_alike_it_is_positive_definite():
    rls = SquareRootRls(3)
    rls.prior(np.zeros(3), np.array([1.0, 1e-3, 1e3]))
    row, y, one = np.array([[1.0, 1e-3, 1e3]]), np.array([2.0]), np.ones(1)
    for k in range(20_000):
        rls.update(row, y, one)
        if k % 2_000 == 0:
            assert np.linalg.eigvalsh(rls.solve().covariance).min() > 0.0
    found = rls.solve()
    scale = np.sqrt(np.diag(found.covariance))
    assert np.linalg.eigvalsh(found.covariance / np.outer(scale, scale)).min() > 0.0
    assert (scale <= np.array([1.0, 1e-3, 1e3]) * (1 + 1e-9)).all()
    assert (row @ found.mean)[0] == pytest.approx(2.0, rel=1e-2)


def test_innovations_are_standard_normal_under_the_model(rng):
    p = 4
    rls = SquareRootRls(p)
    spread = np.array([1.0, 0.1, 10.0, 1.0])
    normalised = []
    for _ in range(200):
        rls = SquareRootRls(p)
        rls.prior(np.zeros(p), spread)
        truth = spread * rng.normal(size=p)
        for _ in range(5):
            Y = rng.normal(size=(2, p))
            y = Y @ truth + 0.3 * rng.normal(size=2)
            innovation, sigma = rls.innovation(Y, y, np.full(2, 0.3))
            normalised += list(innovation / sigma)
            rls.update(Y, y, np.full(2, 0.3))
    assert np.std(normalised) == pytest.approx(1.0, abs=0.05)


def test_sensitivity_is_the_change_of_the_mean(rng):
    p, k = 3, 2
    _, Y, y, sigma = problem(rng, p)
    C = rng.normal(size=(60, k))

    def solve(right):
        rls = SquareRootRls(p, considered=k)
        rls.prior(np.zeros(p), np.ones(p))
        rls.update(Y, right, sigma, C)
        return rls.solve()

    plain = solve(y)
    for column in range(k):
        moved = solve(y + 0.01 * C[:, column])
        np.testing.assert_allclose((moved.mean - plain.mean) / 0.01, plain.sensitivity[:, column], rtol=1e-8)
    without = SquareRootRls(p)
    without.prior(np.zeros(p), np.ones(p))
    without.update(Y, y, sigma)
    np.testing.assert_allclose(plain.mean, without.solve().mean, rtol=1e-10)
    assert plain.residual_sum == pytest.approx(without.solve().residual_sum, rel=1e-10)


def test_observability_names_the_direction_the_data_have_seen():
    rls = SquareRootRls(3)
    rls.prior(np.zeros(3), np.array([1.0, 2.0, 0.5]))
    seen = np.array([[1.0, 1.0, 0.0]])
    rls.update(np.repeat(seen, 50, axis=0), np.zeros(50), np.full(50, 0.1))
    found = rls.observability()
    assert (found.gain[:2] < 1e-6).all()
    # information 50 / 0.01 along (1, 1, 0), whose prior variance is 1 + 4
    assert found.gain[2] == pytest.approx(5000 * 5, rel=1e-6)
    direction = found.directions[:, 2] * np.sign(found.directions[0, 2])
    np.testing.assert_allclose(direction / np.linalg.norm(direction), np.array([1, 4, 0]) / np.sqrt(17), atol=1e-6)
    assert found.shrinkage[2] == pytest.approx(1.0)
    expected = np.sqrt(np.diag(rls.solve().covariance)) / np.array([1.0, 2.0, 0.5])
    np.testing.assert_allclose(found.shrinkage, expected, rtol=1e-9)


def test_observability_needs_a_full_prior():
    rls = SquareRootRls(2)
    rls.prior(np.zeros(2), np.array([1.0, np.inf]))
    with pytest.raises(SingularError, match="prior"):
        rls.observability()


def test_checkpoint_goes_on_bit_for_bit(rng):
    _, Y, y, sigma = problem(rng, 4)
    whole, first, second = (SquareRootRls(4) for _ in range(3))
    for rls in (whole, first):
        rls.prior(np.zeros(4), np.ones(4))
        rls.update(Y[:30], y[:30], sigma[:30])
    second.restore(first.state())
    first.update(Y[:1], y[:1], sigma[:1])  # the state is a copy: this must not reach the second
    for rls in (whole, second):
        rls.update(Y[30:], y[30:], sigma[30:])
    np.testing.assert_array_equal(whole.solve().mean, second.solve().mean)
    np.testing.assert_array_equal(whole.solve().covariance, second.solve().covariance)
    assert whole.rows == second.rows


def test_wrong_checkpoints_are_refused():
    rls = SquareRootRls(3)
    with pytest.raises(RowError, match="shape"):
        rls.restore(SquareRootRls(4).state())
    state = rls.state()
    state.triangle[0, 0] = np.nan
    with pytest.raises(RowError, match="not finite"):
        rls.restore(state)


def test_singular_without_prior_is_an_error_that_names_the_parameter(rng):
    rls = SquareRootRls(3)
    with pytest.raises(SingularError, match="0, 1, 2"):
        rls.solve()
    Y = rng.normal(size=(50, 3))
    Y[:, 2] = 2.0 * Y[:, 0]
    rls.update(Y, np.zeros(50), np.ones(50))
    for ask in (rls.solve, lambda: rls.innovation(Y[:1], np.zeros(1), np.ones(1))):
        with pytest.raises(SingularError, match="parameter 2"):
            ask()
    assert isinstance(SingularError("x"), EstimationError)
    assert isinstance(SingularError("x"), np.linalg.LinAlgError)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda Y, y, s: (np.where(Y > 1, np.nan, Y), y, s),
        lambda Y, y, s: (Y, np.where(y == y[0], np.inf, y), s),
        lambda Y, y, s: (np.where(Y.max() - 1e-9 < Y, np.inf, Y), np.where(y == y[0], -np.inf, y), s),
        lambda Y, y, s: (Y, y, 0.0 * s),
        lambda Y, y, s: (Y, y, -s),
        lambda Y, y, s: (Y, y, np.where(s == s[0], np.nan, s)),
        lambda Y, y, s: (Y[:, :2], y, s),
        lambda Y, y, s: (Y, y, s[:-1]),
    ],
)
def test_bad_rows_are_named_and_leave_the_estimate_alone(rng, spoil):
    _, Y, y, sigma = problem(rng, 3)
    rls = SquareRootRls(3)
    rls.update(Y, y, sigma)
    before = rls.solve()
    with pytest.raises(RowError):
        rls.update(*spoil(Y, y, sigma))
    np.testing.assert_array_equal(rls.solve().mean, before.mean)
    assert rls.rows == before.rows


def test_no_rows_are_no_change():
    rls = SquareRootRls(2)
    rls.update(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert rls.rows == 0


@pytest.mark.parametrize(
    ("mean", "sigma"),
    [
        (np.zeros(3), np.ones(2)),
        (np.zeros(2), np.array([1.0, 0.0])),
        (np.zeros(2), np.array([1.0, -1.0])),
        (np.array([0.0, np.nan]), np.ones(2)),
        (np.zeros(2), np.ones((2, 2))),
        (np.zeros(2), np.array([[1.0, np.nan], [np.nan, 1.0]])),
        (np.zeros(2), np.zeros((2, 2))),
        (np.zeros(2), np.ones(3)),
    ],
)
def test_impossible_priors_are_refused(mean, sigma):
    with pytest.raises(RowError):
        SquareRootRls(2).prior(mean, sigma)


@pytest.mark.parametrize("arguments", [(0,), (2, -1)])
def test_impossible_estimators_are_refused(arguments):
    with pytest.raises(RowError):
        SquareRootRls(*arguments)


def test_considered_columns_must_come_when_declared(rng):
    _, Y, y, sigma = problem(rng, 3)
    with pytest.raises(RowError):
        SquareRootRls(3, considered=1).update(Y, y, sigma)
    with pytest.raises(RowError):
        SquareRootRls(3).update(Y, y, sigma, np.ones((60, 1)))


def test_another_prior_is_as_if_it_had_been_given_at_first(rng):
    Y, y, sigma, C = rng.normal(size=(30, 4)), rng.normal(size=30), rng.uniform(0.5, 2.0, 30), rng.normal(size=(30, 2))
    Y[:, 3] = Y[:, 2]  # the rows do not tell these two apart
    root = rng.normal(size=(4, 4)) * [1e-3, 1.0, 10.0, 1e-2]
    priors = [(rng.normal(size=4), root.T @ root), (np.ones(4), 1e4 * root.T @ root)]
    first, wanted = (SquareRootRls(4, 2) for _ in priors)
    for rls, prior in zip((first, wanted), priors, strict=True):
        rls.prior(*prior)
        rls.update(Y, y, sigma, C)
    made = first.with_prior(*priors[1])
    for one, other in zip(made.solve(), wanted.solve(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(made.prior_equations()[0], wanted.prior_equations()[0])
    made.update(Y, y, sigma, C)
    wanted.update(Y, y, sigma, C)
    np.testing.assert_allclose(made.solve().mean, wanted.solve().mean, rtol=1e-6, atol=1e-9)
