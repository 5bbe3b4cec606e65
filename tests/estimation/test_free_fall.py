"""Free fall is recognised by the size of the specific force and by its roughness."""

import numpy as np
import pytest

from onboard.estimation.free_fall import is_free, roughness

PERIOD_s, SIGMA_m_s2 = 0.01, 0.028
TICKS = 2000
INSIDE = slice(40, -40)


@pytest.fixture
def noise(rng):
    return SIGMA_m_s2 * rng.standard_normal((TICKS, 3))


def wave(hertz, size):
    return size * np.sin(2.0 * np.pi * hertz * PERIOD_s * np.arange(TICKS))[:, None] * [1.0, 0.0, 0.0]


def free(force, limit=0.6):
    return is_free(force, np.full(force.shape, SIGMA_m_s2), PERIOD_s, limit)[INSIDE]


def test_noise_is_as_rough_as_stated(noise):
    rough = roughness(noise, np.full(noise.shape, SIGMA_m_s2), PERIOD_s)
    assert np.nanmean(rough) == pytest.approx(1.0, abs=0.05)


def test_noise_and_an_arm_that_starts_slowly_are_free(noise):
    assert free(noise).all()
    assert free(noise + wave(1.0, 0.3)).all()


def test_hands_that_tremble_are_not(noise):
    assert not free(noise + wave(8.0, 0.15)).any()
    assert not free(noise + wave(0.01, 0.0) + [0.0, 0.0, 0.7]).any()


def test_nothing_is_free_beside_a_gap_or_without_enough_readings(noise):
    noise[1000] = np.nan
    found = is_free(noise, np.full(noise.shape, SIGMA_m_s2), PERIOD_s, 0.6)
    assert found[900]
    assert not found[1000 - 15 : 1000 + 15].any()
    assert not is_free(noise[:30], np.full((30, 3), SIGMA_m_s2), PERIOD_s, 0.6).any()
    assert not is_free(noise[:10], np.full((10, 3), SIGMA_m_s2), PERIOD_s, 0.6).any()


def test_a_cubic_leaves_nothing_and_a_quartic_does():
    t = np.linspace(-1.0, 1.0, TICKS)[:, None]
    sigma = np.full((TICKS, 1), SIGMA_m_s2)
    assert np.nanmax(roughness(3.0 - t + 2.0 * t**2 - 5.0 * t**3, sigma, PERIOD_s)) < 1e-20
    assert np.nanmin(roughness(t**4, sigma, PERIOD_s)) > 1e-16
