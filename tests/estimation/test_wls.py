"""Batch least squares with the sensors' noise told from their residuals."""

import numpy as np
import pytest

from onboard.estimation.errors import RowError, SingularError
from onboard.estimation.wls import Group, least_squares

SIGMA = np.array([0.5, 1.0, 2.0])
UNEQUAL = np.array([0.1, 1.0, 5.0])


def groups(rng, truth, rows=400, sigmas=SIGMA):
    made = []
    for sigma in sigmas:
        Y = rng.normal(size=(rows, truth.size))
        made.append(Group(Y, Y @ truth + sigma * rng.normal(size=rows)))
    return made


def test_ordinary_is_lstsq(rng):
    parts = groups(rng, rng.normal(size=6))
    found = least_squares(parts, weighted=False, chunk=70)
    Y, y = np.vstack([part.Y for part in parts]), np.concatenate([part.y for part in parts])
    mean, total = np.linalg.lstsq(Y, y)[:2]
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, total / (y.size - 6) * np.linalg.inv(Y.T @ Y), rtol=1e-9)


def test_weights_are_the_sensors_own_noise(rng):
    truth = rng.normal(size=6)
    found = least_squares(groups(rng, truth, 4000), weighted=True)
    np.testing.assert_allclose(found.sigma, SIGMA, rtol=0.1)
    error = found.mean - truth
    assert error @ np.linalg.solve(found.covariance, error) < 22.5  # 99.9 % of chi-squared with six degrees
    np.testing.assert_allclose(
        found.relative_percent, 100 * np.sqrt(np.diag(found.covariance)) / np.abs(found.mean), rtol=1e-12
    )


def test_the_good_sensor_decides(rng):
    truth = rng.normal(size=6)
    parts = groups(rng, truth, sigmas=UNEQUAL)
    weighted, ordinary = (least_squares(parts, weighted=flag) for flag in (True, False))
    assert np.linalg.norm(weighted.mean - truth) < 0.2 * np.linalg.norm(ordinary.mean - truth)


def test_too_few_rows_and_dependent_columns_are_refused(rng):
    Y = rng.normal(size=(5, 6))
    with pytest.raises(RowError, match="give more rows"):
        least_squares([Group(Y, Y[:, 0])], weighted=False)
    Y = np.repeat(rng.normal(size=(40, 3)), 2, axis=1)
    with pytest.raises(SingularError):
        least_squares([Group(Y, Y[:, 0])], weighted=False)
