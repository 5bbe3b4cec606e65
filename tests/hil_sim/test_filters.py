"""Recursive filters of the simulator against those of ``scipy.signal``."""

import numpy as np
import pytest
from scipy import signal

from hil_sim import filters

_ROUNDING = 1e-12
_RATE_HZ = 1000.0


def test_design_is_that_of_scipy() -> None:
    """Bilinear transform with and without a zero, the peak, and the band-pass as two sections in either order."""
    for b, a in (([0.002, 1.0], [1e-5, 3e-3, 1.0]), ([0.0, 1.0], [1e-6, 1e-3, 1.0]), ([2.0], [1e-4, 0.1, 3.0])):
        expected = signal.bilinear(b, a, fs=_RATE_HZ)
        np.testing.assert_allclose(filters.bilinear(b, a, _RATE_HZ), expected, rtol=_ROUNDING, atol=1e-15)
    np.testing.assert_allclose(filters.peak(23.0, 25.0, _RATE_HZ), signal.iirpeak(23.0, 25.0, fs=_RATE_HZ), _ROUNDING)
    for band in ((20.0, 200.0), (5.0, 40.0), (0.2, 1.5)):
        sections = filters.band_pass(band, _RATE_HZ)
        b, a = signal.butter(2, band, "bandpass", fs=_RATE_HZ)
        np.testing.assert_allclose(np.convolve(*(b for b, _ in sections)), b, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(np.convolve(*(a for _, a in sections)), a, rtol=1e-9)


@pytest.mark.parametrize("cuts", [(), (1,), (7, 8, 400), tuple(range(50, 600, 50))])
def test_output_is_that_of_scipy_and_the_same_to_the_bit_however_it_is_cut(
    cuts: tuple[int, ...], rng: np.random.Generator
) -> None:
    """Settled on the first sample, two poles; and the recursion of one pole."""
    samples = rng.standard_normal((600, 3))
    b, a = signal.bilinear([0.002, 1.0], [1e-5, 3e-3, 1.0], fs=_RATE_HZ)
    expected, _ = signal.lfilter(b, a, samples, axis=0, zi=signal.lfilter_zi(b, a)[:, None] * samples[0])
    state, whole = np.tile(filters.settled((b, a))[:, None] * samples[0], (2, 1, 1))
    made = np.concatenate([filters.filtered((b, a), part, state) for part in np.split(samples, cuts)])
    np.testing.assert_allclose(made, expected, atol=_ROUNDING)
    np.testing.assert_array_equal(made, filters.filtered((b, a), samples, whole))
    np.testing.assert_array_equal(state, whole)
    before = rng.standard_normal(3)
    expected, _ = signal.lfilter([1.0], [1.0, -0.99], samples, axis=0, zi=0.99 * before[None])
    rows, at = [], before
    for part in np.split(samples, cuts):
        rows.append(filters.remembered(0.99, part, at))
        at = rows[-1][-1]
    np.testing.assert_array_equal(np.concatenate(rows), expected)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 5000])
def test_all_at_once_is_that_of_scipy(count: int, rng: np.random.Generator) -> None:
    """A sharp resonance after a band-pass, from rest; and the gain for white noise."""
    samples = rng.standard_normal((count, 3))
    sections = (*filters.band_pass((20.0, 200.0), _RATE_HZ), filters.peak(23.0, 25.0, _RATE_HZ))
    sos = np.array([np.concatenate(section) for section in sections])
    np.testing.assert_allclose(filters.passed(sections, samples), signal.sosfilt(sos, samples, axis=0), atol=1e-13)
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    gain = np.linalg.norm(signal.sosfilt(sos, impulse))
    assert filters.rms_gain(sections, 4000) == pytest.approx(gain, rel=1e-9)
