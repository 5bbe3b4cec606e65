"""Essential parameters: those at nothing leave, the others come out as if they had never been in the model."""

import numpy as np

from onboard.identification.essential import essential


def estimate(rng, truth, noise):
    W = rng.normal(size=(400, truth.size)) @ (np.eye(truth.size) + 0.3 * rng.normal(size=(truth.size, truth.size)))
    y = W @ truth + noise * rng.normal(size=len(W))
    covariance = noise**2 * np.linalg.inv(W.T @ W)
    return W, y, covariance @ W.T @ y / noise**2, covariance


def test_what_is_nothing_leaves_and_the_rest_is_estimated_again(rng):
    truth = np.array([3.0, 0.0, -1.0, 0.0, 0.5, 0.0])
    W, y, mean, covariance = estimate(rng, truth, 0.1)
    found = essential(mean, covariance)
    assert found.kept[truth != 0.0].all()
    assert np.count_nonzero(found.kept) < truth.size
    again = np.linalg.lstsq(W[:, found.kept], y)[0]
    np.testing.assert_allclose(found.mean[found.kept], again, rtol=1e-9)
    sigma = 0.1 * np.sqrt(np.diag(np.linalg.inv(W[:, found.kept].T @ W[:, found.kept])))
    np.testing.assert_allclose(found.sigma[found.kept], sigma, rtol=1e-9)
    assert (found.mean[~found.kept] == 0.0).all()


def test_five_in_a_hundred_stay_that_are_nothing(rng):
    stayed = 0
    for _ in range(200):
        _, _, mean, covariance = estimate(rng, np.array([1.0, 0.0]), 0.1)
        stayed += int(essential(mean, covariance).kept[1])
    assert 2 <= stayed <= 20


def test_the_worst_known_goes_first():
    mean, covariance = np.array([1.0, 0.1, 0.01]), np.diag([0.01, 0.01, 0.01]) ** 2 * 100.0
    found = essential(mean, covariance)
    assert (found.kept.tolist(), found.order) == ([True, False, False], (2, 1))
