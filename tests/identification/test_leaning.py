"""On which keys of the vehicle file an answer leans."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.identification import quantities
from onboard.identification.free_flyer.online import MotionIdentifier, keys_of
from onboard.identification.quantities import Causes

SIGMA = np.array([np.nan, 0.5, 0.5, 2.0, 0.0])
KEYS = ("", "one", "one", "other", "exact")


@pytest.fixture(scope="module")
def identifier() -> MotionIdentifier:
    return build_free_flyer(config.load(config.packaged("dymaflex")))[0]


def test_the_effect_of_a_key_is_what_its_sigma_adds_to_the_variance(rng: np.random.Generator) -> None:
    """``dP / d(ln s) = 2 (P / s)^2``, by a least-squares fit whose prior is a thousandth wider."""
    H = rng.standard_normal((6, 5))
    sigma = np.where(np.isfinite(SIGMA) & (SIGMA > 0.0), SIGMA, 1e3)

    def covariance(wider: float) -> np.ndarray:
        s = sigma * np.array([1.0, wider, wider, 1.0, 1.0])
        return np.linalg.inv(H.T @ H + np.diag(s**-2))

    causes, P = Causes(KEYS, SIGMA), covariance(1.0)
    assert causes.names == ("one", "other")
    effects = causes.effects(P)
    grown = np.diag(covariance(1.001) - covariance(0.999)) / 0.002
    np.testing.assert_allclose(effects[:, 0] ** 2, grown / 2.0, rtol=1e-4)


def test_what_makes_up_a_good_part_of_sigma_is_said() -> None:
    causes, effects = Causes(KEYS, SIGMA), np.array([[0.3, 0.25], [0.1, 0.25], [0.19, 0.0]])
    sizes = np.array([1.0, 2.0, 1.0])
    assert causes.said(effects, np.ones(3), sizes) == ("leans on one (30 %), other (25 %)", "leans on other (12 %)", "")
    assert causes.said(effects[:1], np.ones(1), np.zeros(1)) == ("leans on one, other",)


def test_a_part_that_is_doubled_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    causes = Causes(KEYS, SIGMA)
    monkeypatch.setattr(quantities, "SUPPORTED_SHRINKAGE", 2.0 * quantities.SUPPORTED_SHRINKAGE)
    assert causes.said(np.array([[0.3, 0.25]]), np.ones(1), np.ones(1)) == ("",)


def test_every_stated_constant_of_a_flight_has_its_key(identifier: MotionIdentifier) -> None:
    """What changes in flight has none."""
    predictor = identifier.ekf.predictor
    keys = dict(zip(predictor.names, keys_of(predictor), strict=True))
    for name, key in (
        ("base_inertial_0", "prior.link.base"),
        ("link_3_inertial_9", "prior.link.link_3"),
        ("gyro_scale_x", "imu_prior.gyro_scale"),
        ("accelerometer_cross_axis_z_imu_2", "imu_prior.accelerometer_cross_axis"),
        ("place_y_imu", "imu_prior.position_m"),
        ("zero_joint_2", "prior.joint.joint_2.zero_rad"),
        ("place_x_joint_1", "prior.joint.joint_1.position_m"),
        ("scale_load_cell", "device.load_cell.scale_sigma"),
    ):
        assert keys[name] == key
    assert keys["rate_x"] == keys["MX_payload"] == keys["gyro_bias_rad_s_x"] == ""
