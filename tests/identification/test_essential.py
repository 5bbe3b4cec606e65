"""Essential parameters: those at nothing leave, one by one, the others estimated again without them."""

import numpy as np

from onboard.estimation.policy import HALF
from onboard.identification.observability import essential


def estimate(rng, truth, noise):
    W = rng.normal(size=(400, truth.size)) @ (np.eye(truth.size) + 0.3 * rng.normal(size=(truth.size, truth.size)))
    y = W @ truth + noise * rng.normal(size=len(W))
    covariance = noise**2 * np.linalg.inv(W.T @ W)
    return W, y, covariance @ W.T @ y / noise**2, covariance


def left_by_fits(W, y, noise):
    """Those left when each fit of the others leaves out the worst known of them."""
    kept = np.arange(W.shape[1])
    while kept.size:
        own = W[:, kept]
        away = np.abs(np.linalg.lstsq(own, y)[0]) / (noise * np.sqrt(np.diag(np.linalg.inv(own.T @ own))))
        if away.min() >= HALF:
            break
        kept = np.delete(kept, away.argmin())
    return np.isin(np.arange(W.shape[1]), kept)


def test_what_is_nothing_leaves_and_the_rest_is_estimated_again(rng):
    truth = np.array([3.0, 0.0, -1.0, 0.0, 0.5, 0.0])
    W, y, mean, covariance = estimate(rng, truth, 0.1)
    kept = essential(mean, covariance)
    assert kept[truth != 0.0].all()
    assert np.count_nonzero(kept) < truth.size
    np.testing.assert_array_equal(kept, left_by_fits(W, y, 0.1))


def test_hardly_known_ones_are_left_out_as_fits_without_them_say(rng):
    """Parameters of a few sigmas each, correlated: whether one stays depends on which are left out before it."""
    fewer = 0
    for _ in range(100):
        W, y, mean, covariance = estimate(rng, 0.01 * rng.normal(size=6), 0.1)
        kept = essential(mean, covariance)
        np.testing.assert_array_equal(kept, left_by_fits(W, y, 0.1))
        fewer += int((kept != (np.abs(mean) >= HALF * np.sqrt(np.diag(covariance)))).any())
    assert fewer > 20  # in so many a test of each one alone says otherwise


def test_five_in_a_hundred_stay_that_are_nothing(rng):
    stayed = 0
    for _ in range(200):
        _, _, mean, covariance = estimate(rng, np.array([1.0, 0.0]), 0.1)
        stayed += int(essential(mean, covariance)[1])
    assert 2 <= stayed <= 20
