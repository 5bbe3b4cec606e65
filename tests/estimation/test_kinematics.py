"""The kernel is filterpy's Kalman smoother in the steady state; one operator for all derivatives."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm

from onboard.estimation.errors import RowError
from onboard.estimation.kinematics import ORDER, SMOOTHER_BAND, smoother_kernel, steady_gain
from onboard.estimation.smoothing import SPLINE, SmoothingWindow, correlation_inflation

PERIOD_S, WIDTH_S = 0.001, 0.4


def filterpys(band):
    """The same Kalman filter, sample by sample: edge of the band at band / width."""
    kalman = KalmanFilter(dim_x=ORDER, dim_z=1)
    kalman.F = expm(PERIOD_S * np.eye(ORDER, k=1))
    kalman.H = np.eye(1, ORDER)
    kalman.R = np.eye(1) / PERIOD_S
    kalman.Q = Q_continuous_white_noise(ORDER, PERIOD_S, (band / WIDTH_S) ** (2 * ORDER))
    kalman.P = np.diag([1.0, 1e2, 1e6, 1e10])
    return kalman


@pytest.fixture(scope="module")
def angle():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 2.5, PERIOD_S)
    return t, np.sin(4.0 * t) + 0.3 * np.cos(9.0 * t + 1.0) + 1e-5 * rng.normal(size=t.size)


def test_the_gain_is_filterpys_in_the_steady_state():
    kalman = filterpys(SMOOTHER_BAND)
    for _ in range(1500):
        kalman.predict()
        kalman.update(np.zeros(1))
    np.testing.assert_allclose(steady_gain(PERIOD_S, SMOOTHER_BAND / WIDTH_S), kalman.K[:, 0], rtol=1e-6)


def test_the_smoother_is_rauch_tung_striebels(angle):
    t, q = angle
    kalman = filterpys(SMOOTHER_BAND)
    means, covariances, *_ = kalman.batch_filter(q)
    smoothed, *_ = kalman.rts_smoother(means, covariances)
    some = np.arange(600, 1900)
    window = SmoothingWindow(t, t[some], WIDTH_S, kernel=smoother_kernel())
    for state, close in enumerate((3e-4, 1e-3, 1e-2)):
        theirs = smoothed[some, state, 0]
        assert np.abs(window.apply(q, state).values[:, 0] - theirs).max() < close * np.abs(theirs).max()


@pytest.mark.parametrize("kernel", [SPLINE, smoother_kernel()])
def test_one_operator_for_a_signal_and_its_derivatives(rng, kernel):
    """Filtering q and differentiating is filtering dq and ddq; at uneven times."""
    t = np.arange(0.0, 3.0, 0.001) + rng.uniform(0.0, 3e-5, 3000)
    at = np.arange(0.5, 2.5, 0.05)
    w = 7.0
    q, dq, ddq = np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)
    window = SmoothingWindow(t, at, WIDTH_S, kernel=kernel)
    for derivative, signal, close in ((1, dq, 2e-4), (2, ddq, 4e-3)):
        np.testing.assert_allclose(
            window.apply(q, derivative).values, window.apply(signal).values, atol=close * w**derivative
        )
    line = window.apply(2.0 + 3.0 * t).values[:, 0]
    np.testing.assert_allclose(line, 2.0 + 3.0 * at, atol=1e-9)


def test_covariance_is_that_of_the_noise(rng):
    t, at = np.arange(0.0, 1.0, PERIOD_S), np.array([0.5])
    draws = rng.normal(size=(t.size, 3000))
    for kernel in (SPLINE, smoother_kernel()):
        window = SmoothingWindow(t, at, WIDTH_S, kernel=kernel)
        sample = np.cov(np.stack([window.apply(draws, derivative).values[0] for derivative in range(3)]))
        weights = window.weights[0][0]
        scale = np.outer(*[np.sqrt(np.diag(sample))] * 2)
        np.testing.assert_allclose(weights @ weights.T / scale, sample / scale, atol=0.1)
    assert not SmoothingWindow(np.delete(t, slice(400, 600)), at, WIDTH_S, kernel=smoother_kernel()).valid.any()


def test_a_wider_band_correlates_neighbouring_rows_less():
    inflation = [correlation_inflation(0.1, 0.005, kernel) for kernel in (SPLINE, smoother_kernel())]
    assert inflation[0] > inflation[1] > 1.0


@pytest.mark.parametrize(("period", "frequency"), [(0.0, 1.0), (0.01, -1.0), (0.01, 101.0), (0.01, np.nan)])
def test_impossible_filters_are_refused(period, frequency):
    with pytest.raises(RowError, match="samples"):
        steady_gain(period, frequency)
