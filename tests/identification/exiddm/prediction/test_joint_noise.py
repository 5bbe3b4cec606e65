"""Noise of the joints in derivatives: what it adds to a gradient, and an estimate that is corrected for it."""

import numpy as np
import pytest

from onboard.dynamics.free_flight import predict_base
from onboard.dynamics.kinematics import link_motions
from onboard.identification.exiddm.prediction.further import CellPrior, FurtherCell
from onboard.identification.exiddm.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.exiddm.prediction.joint_noise import correction_of
from onboard.identification.exiddm.prediction.parameters import GeometryPrior
from tests.identification.exiddm.recorded_flights import PRIOR, online, ticks_of


@pytest.fixture(scope="module")
def predictor(held):
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.03, 1e-4, 0.0025, 2e-4))
    known = {"imu_prior": PRIOR, "links": ["link_4", "base"], "geometry": GeometryPrior(3e-3, {}), "further": [cell]}
    return online(held, **known).predictor


@pytest.fixture
def ticks(held):
    some = ticks_of(held).part(slice(300, 702))
    return some._replace(sample_sigma=np.full(some.sample_sigma.shape, 0.02) * [[1.0], [5.0]])


@pytest.fixture
def state(predictor, ticks):
    """Without momentum, as the effect of the joints' noise on a prediction is computed."""
    x = np.zeros(len(predictor.names))
    x[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    links = link_motions(predictor.vehicle, ticks.q[:4], ticks.dq[:4], ticks.ddq[:4])
    x[RATE] = predict_base(links, predictor.period_s, predictor.chi(x), np.zeros(3), ()).rate[0]
    return x


SIGMA, USE = np.tile([*[0.05] * 3, *[0.1] * 3, 1.0], (400, 1)), np.ones((400, 7), np.bool_)


def test_what_is_added_to_a_gradient_is_half_the_derivative_of_the_variance(predictor, ticks, state):
    def half_of_the_variance(at):
        noise = predictor.joint_noise(ticks.q, ticks.sample_sigma, at)[1:-1] / SIGMA
        return 0.5 * float((noise[:, 3:] ** 2).sum())  # without the gyro's lines

    ticks = ticks._replace(sample_sigma=ticks.sample_sigma * [[0.0], [1.0]])  # products of rates are neglected
    added = predictor.noise_added(ticks, SIGMA, USE, state)
    bodies = [k for k, name in enumerate(predictor.names) if name.endswith("_payload") or "inertial" in name]
    size = np.where(np.isfinite(predictor.sigma), predictor.sigma, 0.05)[bodies]
    steps = 1e-4 * np.eye(len(state))[bodies]
    slopes = [(half_of_the_variance(state + one) - half_of_the_variance(state - one)) / 2e-4 for one in steps]
    expected = size * slopes
    np.testing.assert_allclose(added[bodies] * size, expected, atol=0.1 * np.abs(expected).max())
    scales = [k for k, name in enumerate(predictor.names) if "scale" in name and "gyro" not in name]
    assert (added[scales] > 0.0).all()  # of noise a scale of zero is the best
    assert not added[[k for k, name in enumerate(predictor.names) if "delay" in name]].any()


def test_noise_of_less_than_a_thousandth_of_every_line_is_left_out(predictor, ticks, state):
    share = ((predictor.joint_noise(ticks.q, ticks.sample_sigma, state)[1:-1] / SIGMA) ** 2).max()
    for part, counts in ((0.9e-3, False), (1.5e-3, True)):
        quiet = ticks._replace(sample_sigma=ticks.sample_sigma * np.sqrt(part / share))
        assert predictor.noise_added(quiet, SIGMA, USE, state).any() == counts


def test_an_estimate_is_corrected_for_noise_with_doubt_in_its_power():
    covariance, added = np.array([[4.0, 1.0], [1.0, 2.0], [0.0, 1.0]]), np.array([0.5, -0.2])
    correction = correction_of(covariance, added)
    np.testing.assert_allclose(correction.shift, covariance @ added)
    np.testing.assert_allclose(correction.sigma, 0.2 * correction.shift)
    np.testing.assert_allclose(correction.covariance, 0.04 * np.outer(correction.shift, correction.shift))
