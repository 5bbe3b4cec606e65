"""The filter's prediction errors as reported: as wide as is said, in order of time, outliers marked."""

from types import SimpleNamespace

import numpy as np
import pytest

from onboard.identification.free_flyer.online import MotionIdentifier
from tests.dynamics.free_flyer_twin import twin
from tests.identification.free_flyer.recorded_flights import online, recorded, ticks_of

STEP, OUTLIER = 20, 901


@pytest.fixture(scope="module")
def ticks():
    """Of a flight that is longer than the window that the filter begins with."""
    return ticks_of(recorded(twin(12.0).flight, np.random.default_rng(3)))


def told_of(ticks):
    """All errors of a flight whose ticks come as on board: time, (n,); error and sigma, (n, 6); used, (n,)."""
    found, ekf = [], online(SimpleNamespace(period_s=np.diff(ticks.time_s)[0], samples=5))
    for first in range(0, len(ticks.time_s), STEP):
        ekf.take(type(ticks)(*(part[first : first + STEP] for part in ticks)))
        ekf.finish()
        found += MotionIdentifier.prediction_errors(SimpleNamespace(ekf=ekf))
    assert not ekf.innovations.told
    return [np.concatenate(parts) for parts in zip(*found, strict=True)]


@pytest.fixture(scope="module")
def told(ticks):
    return told_of(ticks)


def test_errors_are_as_wide_as_is_said(ticks, told) -> None:
    time_s, error, sigma, used = told
    assert len(time_s) > 200
    assert (np.diff(time_s) > 0).all()
    assert used.all()
    assert np.sqrt(((error / sigma) ** 2).mean(axis=0)) == pytest.approx(np.ones(6), abs=0.15)
    assert (sigma >= ticks.sigma[0]).all()


def test_an_outlier_is_told_as_it_was_measured_and_as_left_out(ticks, told) -> None:
    before_s, before, sigma, _ = told
    measured = ticks.measured.copy()
    measured[OUTLIER, 4] += 40.0 * ticks.sigma[0, 4]
    time_s, error, _, used = told_of(ticks._replace(measured=measured))
    assert (time_s == before_s).all()
    [at] = np.flatnonzero(time_s == ticks.time_s[OUTLIER])
    assert np.flatnonzero(~used).tolist() == [at]
    assert error[at, 4] - before[at, 4] == pytest.approx(40.0 * ticks.sigma[0, 4])
    assert error[at, 4] / sigma[at, 4] > 20.0
