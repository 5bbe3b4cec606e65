"""Noise that lines of a tick have in common: whitened they have none, and a gradient scatters as is stated."""

import numpy as np
import pytest

from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, sigma_of

TICKS, JOINTS, LINES, PARAMETERS = 20, 3, 7, 4


@pytest.fixture
def noise(rng: np.random.Generator) -> LineNoise:
    """That of the joints is larger than that of the lines, as with encoders of 12 bits, and most of it is of one."""
    by_joint = rng.standard_normal((TICKS, 2 * JOINTS, LINES)) * np.geomspace(0.1, 3.0, LINES)
    by_joint *= np.geomspace(1.0, 0.1, 2 * JOINTS)[:, None]
    return LineNoise.of(rng.uniform(0.3, 0.6, (TICKS, LINES)) * np.geomspace(0.1, 3.0, LINES), by_joint)


@pytest.fixture
def use(rng: np.random.Generator) -> np.ndarray:
    """Some lines of some ticks are not in use, of one tick none."""
    some = rng.random((TICKS, LINES)) < 0.8
    some[3] = False
    return some


def covariance_of(noise: LineNoise) -> np.ndarray:
    """Of the lines of each tick, (n, m, m)."""
    own = noise.sigma**2 - sigma_of(noise.by_joint) ** 2
    return noise.by_joint.swapaxes(1, 2) @ noise.by_joint + own[:, :, None] * np.eye(LINES)


def test_whitened_lines_have_unit_covariance_and_those_not_in_use_are_zero(noise: LineNoise, use: np.ndarray) -> None:
    W = noise.whitening(use)
    whitened = W @ covariance_of(noise) @ W.swapaxes(1, 2)
    np.testing.assert_allclose(whitened, use[:, :, None] * np.eye(LINES), atol=1e-12)
    assert not W[~use].any()
    assert not W.swapaxes(1, 2)[~use].any()  # what is not in use is in no line


def test_lines_are_whitened_by_those_in_use_alone(noise: LineNoise, use: np.ndarray) -> None:
    """As if there were no others, and each is taken off the later ones: the first is as it is but for its size."""
    W = noise.whitening(use)
    for tick, used in enumerate(use):
        alone = LineNoise(noise.sigma[tick : tick + 1, used], noise.by_joint[tick : tick + 1][:, :, used])
        every = np.ones((1, int(used.sum())), np.bool_)
        np.testing.assert_allclose(W[tick][np.ix_(used, used)], alone.whitening(every)[0], atol=1e-12)
    np.testing.assert_allclose(W, np.tril(W), atol=1e-12)
    first = np.argmax(use, axis=1)
    for tick in np.flatnonzero(use.any(axis=1)):
        assert W[tick, first[tick], first[tick]] == pytest.approx(1.0 / noise.sigma[tick, first[tick]])


def test_lines_that_have_nothing_in_common_are_divided_by_their_sigmas(noise: LineNoise, use: np.ndarray) -> None:
    one = LineNoise.alone(noise.sigma)
    np.testing.assert_allclose(one.whitening(use), use[:, :, None] * np.eye(LINES) / noise.sigma[:, :, None])
    np.testing.assert_array_equal(one.part(slice(2, 5)).sigma, noise.sigma[2:5])
    np.testing.assert_array_equal(noise.part(slice(2, 5)).by_joint, noise.by_joint[2:5])


def scatter_over_stated(noise: LineNoise, use: np.ndarray, errors: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Of a gradient ``J' r`` by its covariance over many errors of the lines, (draws, n, m), over ``J' J``, (p,).

    Of the directions along which it is least and most.
    """
    W = noise.whitening(use)
    slopes, residuals = (W @ J).reshape(-1, PARAMETERS), (W @ errors[..., None]).reshape(len(errors), -1)
    root = np.linalg.cholesky(slopes.T @ slopes)
    return np.linalg.eigvalsh(np.cov(np.linalg.solve(root, slopes.T @ residuals.T)))


def test_a_gradient_scatters_as_is_stated_along_every_direction(
    rng: np.random.Generator, noise: LineNoise, use: np.ndarray
) -> None:
    """Drawn errors of joints, each in all lines of a tick; taken for independent, some direction has twice as much."""
    draws = 4000
    of_joints = np.einsum("dnj,njm->dnm", rng.standard_normal((draws, TICKS, 2 * JOINTS)), noise.by_joint)
    own = np.sqrt(noise.sigma**2 - sigma_of(noise.by_joint) ** 2)
    errors = of_joints + own * rng.standard_normal((draws, TICKS, LINES))
    J = noise.by_joint[:, 0, :, None] * rng.uniform(0.5, 1.5, (TICKS, LINES, PARAMETERS))  # what moves with that joint
    found = scatter_over_stated(noise, use, errors, J)
    assert found.shape == (PARAMETERS,)
    np.testing.assert_allclose(found, 1.0, atol=0.1)
    assert scatter_over_stated(LineNoise.alone(noise.sigma), use, errors, J).max() > 2.0
