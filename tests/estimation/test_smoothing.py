"""The kernel's laws: exact on low polynomials, one filter for both sides of a row, right noise gain, gaps refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline
from scipy.signal import butter, lfilter

from onboard.estimation.errors import RowError
from onboard.estimation.smoothing import (
    ORDER,
    SPLINE,
    Response,
    SmoothingWindow,
    alike_in_products,
    correlation_inflation,
    filtered_inflation,
    smooth,
)

WIDTH = 0.1
A_BILLIONTH = 1e-9


def uneven(rng, duration=1.0, period=0.005, jitter=0.3):
    t = np.arange(0, duration, period)
    return t + rng.uniform(-jitter, jitter, t.size) * period


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_the_kernel_is_the_b_spline_less_half_its_second_moment_times_its_curvature(derivative):
    element = BSpline.basis_element(np.linspace(-0.5, 0.5, ORDER + 1))
    u = np.linspace(-0.499, 0.499, 997)
    second_moment = 1.0 / (12.0 * ORDER)
    truth = ORDER * (element.derivative(derivative)(u) - 0.5 * second_moment * element.derivative(derivative + 2)(u))
    np.testing.assert_allclose(SPLINE.parts[derivative](u), truth, atol=A_BILLIONTH * np.abs(truth).max())
    assert (SPLINE.parts[derivative](np.array([-0.6, 0.51, 3.0])) == 0.0).all()


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_exact_on_quadratics_at_uneven_times(rng, derivative, degree):
    t = uneven(rng)
    polynomial = Polynomial(rng.normal(size=degree + 1))
    at = np.array([0.2, 0.31234, 0.5, 0.77])
    truth = polynomial.deriv(derivative)(at) if derivative else polynomial(at)
    found = smooth(t, polynomial(t), at, WIDTH, derivative)
    assert found.valid.all()
    np.testing.assert_allclose(found.values[:, 0], truth, atol=A_BILLIONTH * found.noise_gain.max())


@given(
    seed=st.integers(0, 2**32 - 1),
    period=st.floats(0.001, 0.01),
    coefficients=st.lists(st.floats(-10, 10), min_size=3, max_size=3),
)
@settings(max_examples=50, deadline=None)
def test_exact_on_any_quadratic_whatever_the_times(seed, period, coefficients):
    t = uneven(np.random.default_rng(seed), 0.4, period)
    polynomial = Polynomial(coefficients)
    for derivative in range(3):
        found = SmoothingWindow(t, [0.2], WIDTH, max_gap_s=0.05).apply(polynomial(t), derivative)
        truth = polynomial.deriv(derivative)(0.2) if derivative else polynomial(0.2)
        assert found.values[0, 0] == pytest.approx(truth, abs=1e-7 * max(1.0, found.noise_gain[0]))


def test_cubics_pass_because_the_second_moment_is_zero():
    t = np.arange(0, 1, 0.001)
    found = smooth(t, (t - 0.4) ** 3, [0.5], WIDTH)
    assert found.values[0, 0] == pytest.approx(0.001, abs=1e-9)


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("frequency_hz", [0.0, 3.0, 12.0, 25.0])
def test_what_a_kernel_lets_through_is_what_becomes_of_a_sine(derivative, frequency_hz):
    t = np.arange(0, 2, 0.0005)
    omega = 2 * np.pi * frequency_hz
    at = np.linspace(0.5, 1.5, 1001)
    found = smooth(t, np.cos(omega * t), at, WIDTH, derivative).values[:, 0]
    told = Response(WIDTH).gain(np.array([-omega]), derivative)[0]
    assert np.abs(found).max() == pytest.approx(told, rel=1e-3, abs=1e-4 * max(1.0, omega**derivative))


@pytest.mark.parametrize("derivative", [1, 2])
@pytest.mark.parametrize("frequency_hz", [3.0, 12.0, 25.0, 40.0])
def test_both_sides_of_a_row_go_through_the_same_filter(derivative, frequency_hz):
    """(h * q)^(d), which we compute from q, equals h * (q^(d)), which the other side of the row went through."""
    t = np.arange(0, 1, 0.0005)
    at = np.linspace(0.3, 0.7, 23)
    omega = 2 * np.pi * frequency_hz
    q, q_d = np.sin(omega * t), omega**derivative * np.sin(omega * t + derivative * np.pi / 2)
    one = smooth(t, q, at, WIDTH, derivative).values
    other = smooth(t, q_d, at, WIDTH, 0).values
    np.testing.assert_allclose(one, other, atol=1e-6 * omega**derivative)


def test_low_pass():
    t = np.arange(0, 1, 0.0005)
    gain = [smooth(t, np.cos(2 * np.pi * f * (t - 0.5)), [0.5], WIDTH).values[0, 0] for f in (5.0, 22.0, 52.0, 80.0)]
    assert gain[0] == pytest.approx(1.0, abs=0.002)
    assert gain[1] == pytest.approx(np.sqrt(0.5), abs=0.02)
    assert abs(gain[2]) < 0.01
    assert abs(gain[3]) < 1e-4


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_noise_gain_is_the_spread_of_smoothed_white_noise(rng, derivative):
    t = uneven(rng, 0.2)
    noise = rng.normal(size=(t.size, 4000))
    found = smooth(t, noise, [0.1], WIDTH, derivative)
    assert found.values[0].std() == pytest.approx(found.noise_gain[0], rel=0.04)


def test_a_batch_gives_what_ticks_one_by_one_give(rng):
    t, at = uneven(rng), rng.uniform(0.1, 0.9, 40)
    values = rng.normal(size=(t.size, 3))
    batch = smooth(t, values, at, WIDTH, 1)
    for i, tick in enumerate(at):
        one = smooth(t, values, [tick], WIDTH, 1)
        np.testing.assert_allclose(batch.values[i], one.values[0], rtol=1e-9, atol=1e-9)


def test_many_ticks_are_done_in_pieces_with_the_same_result(rng, monkeypatch):
    t, at = uneven(rng, 4.0), np.linspace(0.1, 3.9, 301)
    values = rng.normal(size=t.size)
    whole = smooth(t, values, at, WIDTH, 2)
    monkeypatch.setattr("onboard.estimation.smoothing._CHUNK_CELLS", 200)
    pieces = smooth(t, values, at, WIDTH, 2)
    np.testing.assert_allclose(pieces.values, whole.values, rtol=1e-9)
    np.testing.assert_array_equal(pieces.valid, whole.valid)
    np.testing.assert_allclose(pieces.noise_gain, whole.noise_gain, rtol=1e-9)


def test_a_gap_invalidates_the_ticks_whose_window_it_is_in():
    t = np.arange(0, 1, 0.005)
    t = t[(t < 0.5) | (t > 0.53)]
    at = np.arange(0.1, 0.9, 0.01)
    found = SmoothingWindow(t, at, WIDTH, max_gap_s=0.012).apply(np.ones(t.size))
    touched = (at + WIDTH / 2 > 0.495 + 0.012) & (at - WIDTH / 2 < 0.535 - 0.012)
    np.testing.assert_array_equal(found.valid, ~touched)
    assert np.isnan(found.values[touched]).all()
    assert np.isnan(found.noise_gain[touched]).all()
    np.testing.assert_allclose(found.values[~touched], 1.0, atol=1e-12)


def test_ticks_beyond_the_data_are_invalid():
    t = np.arange(0, 1, 0.005)
    found = smooth(t, t, [-1.0, 0.02, 0.5, 0.99, 2.0], WIDTH)
    assert found.valid.tolist() == [False, False, True, False, False]


def test_no_samples_and_no_valid_tick():
    assert not smooth([], np.zeros((0, 2)), [0.1], WIDTH).valid.any()
    empty = SmoothingWindow(np.zeros(0), [0.1], WIDTH)
    assert empty.weights[0].shape[0] == 1
    assert np.isnan(empty.apply(np.zeros((0, 2))).values).all()
    sparse = SmoothingWindow(np.arange(0, 1, 0.015), [0.5], WIDTH, max_gap_s=0.001)
    assert not sparse.valid.any()
    assert not sparse.weights[0].any()


@pytest.mark.parametrize(
    ("times", "values", "at", "width"),
    [
        ([0.0, 0.1, 0.1], [1, 2, 3], [0.1], 1.0),
        ([0.0, 0.2, 0.1], [1, 2, 3], [0.1], 1.0),
        ([0.0, np.nan, 0.2], [1, 2, 3], [0.1], 1.0),
        ([0.0, 0.1, 0.2], [1, np.inf, 3], [0.1], 1.0),
        ([0.0, 0.1, 0.2], [1, 2], [0.1], 1.0),
        ([0.0, 0.1, 0.2], [1, 2, 3], [np.nan], 1.0),
        ([0.0, 0.1, 0.2], [1, 2, 3], [0.1], 0.0),
    ],
)
def test_bad_signals_are_named(times, values, at, width):
    with pytest.raises(RowError, match=r"\w+"):
        smooth(times, values, at, width)


def test_no_third_derivative():
    with pytest.raises(RowError, match="not 0, 1 or 2"):
        smooth(np.arange(0, 1, 0.005), np.zeros(200), [0.5], WIDTH, 3)


def test_inflation_makes_correlated_rows_weigh_what_they_are_worth(rng):
    """The mean of N smoothed rows has the variance that N independent rows of the inflated sigma would give."""
    t = np.arange(0, 20, 0.005)
    at = np.arange(0.5, 19.5, 0.01)
    noise = rng.normal(size=(t.size, 300))
    smoothed = smooth(t, noise, at, WIDTH)
    claimed = smoothed.noise_gain[0] * correlation_inflation(WIDTH, 0.01) / np.sqrt(at.size)
    assert smoothed.values.mean(axis=0).std() == pytest.approx(claimed, rel=0.1)


@pytest.mark.parametrize("width_s", [0.1, 0.25])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_products_of_two_errors_are_alike_over_so_many_rows(width_s, derivative):
    """The sum of squares of the correlations of one row with all, by the weights of white samples."""
    t, period_s = np.arange(0, 2, 0.001), 0.01
    weights = SmoothingWindow(t, np.arange(0.5, 1.5, period_s), width_s).apply(np.eye(t.size), derivative).values
    rho = weights @ weights[50] / (weights[50] @ weights[50])
    found = alike_in_products(correlation_inflation(width_s, period_s))
    assert found == pytest.approx(rho @ rho, rel=0.05)
    assert alike_in_products(1.0) == 1.0


def test_accelerations_are_less_alike_than_ticks_by_themselves(rng):
    """By sums with a slow motion, 0.1 to 0.6 Hz: of white samples, and of a gear's ripple in swings of 0.1 rad."""
    t, at = np.arange(0, 20, 0.002), np.arange(0.5, 19.5, 0.01)
    window, slow = SmoothingWindow(t, at, 0.25), np.sin(2.0 * np.pi * np.outer([0.1, 0.3, 0.6], at))
    noise = window.apply(rng.normal(size=(t.size, 100)), 2)
    swing, turns = 2.0 * np.pi * 0.3, 200.0
    ripple = window.apply(np.sin(turns * 0.1 * np.sin(swing * t)[:, None] + rng.uniform(0.0, 2.0 * np.pi, 100)), 2)
    passed = 0.5**0.5 * Response(0.25).gain(turns * 0.1 * swing * np.abs(np.cos(swing * at)), 2)
    for values, sigma in ((noise.values, noise.noise_gain), (ripple.values, passed)):
        variance, alone = ((slow @ values) ** 2).mean(axis=1), ((slow * sigma) ** 2).sum(axis=1)
        assert (variance < alone).all()
        assert (variance > 0.0).all()


def test_rows_further_apart_than_the_kernel_are_independent():
    assert correlation_inflation(0.1, 0.2) == 1.0
    with pytest.raises(RowError):
        correlation_inflation(0.1, 0.0)


@pytest.mark.parametrize("delay_s", [0.002, 0.01])
def test_samples_behind_a_filter_weigh_what_they_are_worth(rng, delay_s):
    """A mean of samples of SciPy's Butterworth filter; 5 of one tick, as of ticks that a fit takes for independent."""
    step_s, period_s = 1e-4, 0.002
    b, a = butter(2, np.sqrt(2.0) / delay_s, fs=2.0 * np.pi / step_s)
    filtered = lfilter(b, a, rng.normal(size=(40_000, 200)), axis=0)[2000 :: round(period_s / step_s)]
    claimed = filtered.std() * filtered_inflation(delay_s, period_s) / np.sqrt(len(filtered))
    assert filtered.mean(axis=0).std() == pytest.approx(claimed, rel=0.15)


@pytest.mark.parametrize("delay_s", [3e-4, 0.002, 0.05])
def test_what_a_filter_lets_pass_is_the_sum_of_its_correlation_and_costs_no_memory(delay_s):
    x = np.arange(1, 100_000) * (0.002 / delay_s)
    summed = 1.0 + 2.0 * (np.exp(-x) * (np.cos(x) + np.sin(x))).sum()
    assert filtered_inflation(delay_s, 0.002) == pytest.approx(np.sqrt(max(summed, 1.0)), rel=1e-9)
    an_absurd_delay_s = 1e9
    assert filtered_inflation(an_absurd_delay_s, 0.002) == pytest.approx(np.sqrt(2.0 * an_absurd_delay_s / 0.002))


def test_no_filter_makes_no_samples_alike():
    assert filtered_inflation(0.0, 0.002) == 1.0
    assert filtered_inflation(1e-4, 0.002) == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(RowError):
        filtered_inflation(0.001, 0.0)
    with pytest.raises(RowError):
        filtered_inflation(-0.001, 0.002)


@pytest.mark.parametrize("width_s", [0.03, 0.1, 0.6])
def test_samples_scatter_about_the_smoothed_curve_by_their_noise_whatever_the_width(rng, width_s):
    times = uneven(rng, duration=30.0)
    noise = np.array([1e-3, 0.0])
    values = np.sin(2.0 * np.pi * 0.2 * times)[:, None] + noise * rng.standard_normal((len(times), 2))
    window = SmoothingWindow(times, np.arange(-0.5, 30.0, 0.02), width_s, max_gap_s=0.05)
    off = window.residuals(values)
    assert (np.isfinite(off).all(axis=1) == window.valid).all()
    scatter = off[window.valid].std(axis=0)
    assert scatter[0] == pytest.approx(1e-3, rel=0.06)
    assert scatter[1] < 1e-4
