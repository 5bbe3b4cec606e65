"""Noise of the motion in rows of kept ticks: what it adds is taken off; errors that make less of it are not found."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.estimation.smoothing import SPLINE, SmoothingWindow, jerk_factor
from onboard.identification.rows.checks.remade import SmoothedTicks
from onboard.identification.rows.stated_errors.regressor_noise import told
from tests.identification.rows import test_grasped as bench
from tests.identification.rows.checks.arm_on_bench import geared, identifier, run

NOISE_rad_s2 = 0.8  # of accelerations of 1.9 rad/s^2, as encoders of 12 bits have it


def noisy(seed, joints=range(5)):
    """Accelerations of some joints with noise, each tick alone."""
    given, rng = run(), np.random.default_rng(seed)
    sigma = np.zeros_like(given.ddq)
    sigma[:, list(joints)] = NOISE_rad_s2
    noise = given.noise._replace(ddq=np.hypot(given.noise.ddq, sigma), inflation=1.0)
    return given._replace(ddq=given.ddq + sigma * rng.standard_normal(sigma.shape), noise=noise)


def weighed(given):
    """The hypotheses, all by kept ticks."""
    who = identifier()
    bench.feed(who, given)
    who._bank._weigh(who._bank._kept.ticks, who.rls.solve().mean, 1.0)
    return who._bank


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_accelerations_is_no_error_of_encoders(seed):
    assert weighed(noisy(seed)).weighed.names == ()


@pytest.mark.parametrize("seed", [0, 2])
def test_without_it_taken_off_encoders_are_blamed(monkeypatch, seed):
    monkeypatch.setattr(SmoothedTicks, "noisier", property(lambda ticks: ticks))
    assert any("joint" in name for name in weighed(noisy(seed)).weighed.names)


def test_an_encoder_whose_scale_is_wrong_is_found_in_the_noise():
    bank = weighed(geared(2, 0.9)(noisy(1)))
    assert "scale" in bank.weighed.names[0]
    assert any("scale_joint_2" in name for name in bank.weighed.names)


def test_of_neighbouring_ticks_the_noise_of_no_two_signals_is_alike(rng):
    joints, count = 5, 64
    zeros, noise = np.zeros((count, joints)), np.tile(rng.uniform(0.5, 2.0, 3 * joints + 3), (count, 1))
    still = np.zeros((count, 1))
    ticks = SmoothedTicks(still[:, 0], *[zeros] * 4, still, still, np.zeros((count, 3)), *[still] * 4, noise)
    made = ticks.noisier
    all_of = np.hstack([made.q, made.dq, made.ddq, made.force])
    np.testing.assert_allclose(all_of.T @ all_of / count, np.diag(noise[0] ** 2), atol=1e-12)
    rate, acceleration = (noise[0, k * joints : (k + 1) * joints] for k in (1, 2))
    np.testing.assert_allclose((made.jerk * made.dq).mean(axis=0), -(acceleration**2))
    np.testing.assert_allclose((made.jerk**2).mean(axis=0), jerk_factor() * acceleration**4 / rate**2)


def test_the_jerk_of_smoothed_noise_is_as_large_as_its_factor_says(rng):
    """Samples each millisecond, smoothed over 0.2 s; its jerk by a spline through its accelerations."""
    t = 1e-3 * np.arange(200_000)
    at = t[200:-200:4]
    window = SmoothingWindow(t, at, 0.2, 0.01, SPLINE)
    sample = rng.standard_normal((len(t), 1))
    dq, ddq = (window.apply(sample, order).values[:, 0] for order in (1, 2))
    jerk = make_interp_spline(at, ddq, 5).derivative()(at)
    assert np.var(jerk) * np.var(dq) / np.var(ddq) ** 2 == pytest.approx(jerk_factor(), rel=0.05)
    assert np.mean(jerk * dq) == pytest.approx(-np.var(ddq), rel=0.05)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_information_of_a_noisy_regressor_is_what_its_estimates_scatter_by(rng, share):
    """y = a x + b, x read with noise of ``share`` times its own size: mean and scatter of 3,000 estimates."""
    rows, true, own = 200, np.array([1.5, -0.5]), 0.4
    estimates, variances = [], []
    x = rng.standard_normal(rows)
    sigma = np.hypot(own, share * true[0])
    for _ in range(3000):
        read = x + share * rng.standard_normal(rows)
        J = np.column_stack([read, np.ones(rows)]) / sigma
        r = (true[0] * x + true[1] + own * rng.standard_normal(rows)) / sigma
        dJ = np.tile([share / sigma, 0.0], (rows, 1))  # of one sigma
        dr = -dJ @ true
        N, each = dJ.T @ dJ, dJ * dr[:, None]
        A, gain = told(J.T @ J - N, J.T @ J + each.T @ each, 0.0 * true, np.ones(2))
        estimates.append(np.linalg.solve(A, gain @ (J.T @ r)))
        variances.append(np.linalg.inv(A)[0, 0])
    estimates = np.array(estimates)
    assert np.median(estimates[:, 0]) == pytest.approx(true[0], rel=0.02)
    spread = (np.quantile(estimates[:, 0], 0.84) - np.quantile(estimates[:, 0], 0.16)) / 2.0
    assert np.sqrt(np.median(variances)) == pytest.approx(spread, rel=0.1)


def test_where_there_is_no_noise_nothing_is_taken_off(rng):
    J = rng.standard_normal((50, 4)) * [1.0, 1e3, 1e-6, 0.0]
    A = J.T @ J
    np.testing.assert_allclose(told(A, A, np.zeros(4), np.sqrt(np.diag(A)))[0], A, rtol=1e-9)


def test_how_much_noise_there_is_is_not_known_better_than_stated():
    A, d = np.diag([100.0, 100.0]), np.array([400.0, 0.0])
    np.testing.assert_allclose(
        np.diag(told(A, A, d, np.ones(2))[0]), [100.0**2 / (100.0 + (NOISE_SIGMA * 400.0) ** 2), 100.0]
    )
