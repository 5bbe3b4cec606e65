"""Which unknowns are estimated and where they stand, and the IMU's error model against its equation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.identification.free_flyer.prediction import imu_errors
from onboard.identification.free_flyer.prediction.parameters import UnknownLayout, Unknowns


def test_what_is_certain_is_left_out_and_stays_zero():
    layout = UnknownLayout(
        {
            "start": Unknowns(("a", "b"), np.array([np.nan, 0.0])),
            **imu_errors.imu_blocks(imu_errors.CERTAIN._replace(gyro_scale=0.1, delay_s=1e-3)),
            "links": Unknowns(("c",), np.ones(1)),
        }
    )
    assert layout.names == ("a", "gyro_scale_x", "gyro_scale_y", "gyro_scale_z", "delay_s", "c")
    assert layout.size == 2 + imu_errors.SIZE + 1
    np.testing.assert_array_equal(layout.estimated("start", "links"), [0, 5])
    np.testing.assert_array_equal(layout.estimated("gyro_bias_rad_s"), [])
    every = layout.whole(np.arange(1.0, 7.0))
    assert np.count_nonzero(every) == 6
    np.testing.assert_array_equal(every[layout["gyro_scale"]], [2.0, 3.0, 4.0])
    np.testing.assert_array_equal(every[layout.kept], np.arange(1.0, 7.0))


def test_a_reading_is_late_by_a_slow_clock_scaled_turned_biased():
    assert len(imu_errors.ImuPrior._fields) == 13
    time_s = np.linspace(-2.0, 2.0, 401)
    true, change = np.zeros((401, 6)), np.zeros((401, 6))
    true[:, 2], change[:, 2] = np.cos(time_s), -np.sin(time_s)
    true[:, 3], change[:, 3] = -np.sin(time_s), -np.cos(time_s)
    delay_s, rate_error = 2e-4, 3e-4
    by_its_clock = np.asarray((time_s - delay_s) / (1.0 + rate_error))  # when what it shows now was
    errors = np.zeros(imu_errors.SIZE)
    errors[24:26] = delay_s, rate_error
    found = imu_errors.imu_reading(true, change, time_s, errors).values
    second_order = 2e-6
    np.testing.assert_allclose(found[:, 2], np.cos(by_its_clock) / (1.0 + rate_error), atol=second_order)
    np.testing.assert_allclose(found[:, 3], -np.sin(by_its_clock) / (1.0 + rate_error) ** 2, atol=second_order)
    assert np.abs(found[:, 2] - np.cos(time_s)).max() > 100 * second_order
    errors[:12] = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.01, 0.0]  # bias, drift, scale, misalignment
    errors[24:26] = 0.0
    found = imu_errors.imu_reading(true, change, time_s, errors).values
    wz = np.cos(time_s)
    turned = -np.sin(0.01) * wz, (0.5 + np.cos(0.01)) * wz  # as the axes turn by m, a vector turns by -m
    expected = np.stack([0.1 + time_s + turned[0], np.full(401, 0.2), 0.3 + turned[1]], axis=1)
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-12)


@pytest.mark.parametrize("turned_rad", [1e-6, 5e-3, 0.2, 2.0])  # series and closed form
def test_axes_that_are_not_orthogonal_and_a_sensor_that_is_turned(rng, turned_rad):
    true, still = rng.standard_normal((20, 6)), np.zeros((20, 6))
    M = 0.01 * rng.standard_normal((3, 3))
    off, turn = 0.5 * (M + M.T), rng.standard_normal(3)
    turn *= turned_rad / np.linalg.norm(turn)
    errors = np.zeros(imu_errors.SIZE)
    errors[18:21] = M.diagonal()  # of the accelerometer
    errors[21:24], errors[32:35] = 0.75 * turn, 0.25 * turn  # the sensor's own, and its housing's
    errors[9:12] = -0.25 * turn  # of the gyro, which is not turned
    errors[29:32] = off[1, 2], off[0, 2], off[0, 1]
    M = off + Rotation.from_rotvec(-turn).as_matrix()
    found = imu_errors.imu_reading(true, still, np.zeros(20), errors)
    np.testing.assert_allclose(found.values[:, 3:], true[:, 3:] @ M.T, atol=1e-14)
    np.testing.assert_array_equal(found.values[:, :3], true[:, :3])
    for k in range(imu_errors.SIZE):
        if k not in (24, 25):  # without a change in time these two have no effect, or one by the power of time
            step = 1e-5 * (np.arange(imu_errors.SIZE) == k)
            there, back = (imu_errors.imu_reading(true, still, np.zeros(20), errors + d).values for d in (step, -step))
            np.testing.assert_allclose(found.d_errors[:, :, k], (there - back) / 2e-5, atol=1e-9)


def test_the_sigma_of_six_elements_off_the_diagonal_is_split_into_two_parts(rng):
    prior = imu_errors.CERTAIN._replace(gyro_misalignment_rad=0.003).with_cross_axis(0.01, 0.02)
    M = 0.01 * rng.standard_normal((200_000, 3, 3))
    symmetric, rotation = 0.5 * (M[:, 0, 1] + M[:, 1, 0]), 0.5 * (M[:, 0, 1] - M[:, 1, 0])
    rotation += 0.003 * rng.standard_normal(len(M))
    assert prior.gyro_cross_axis == pytest.approx(symmetric.std(), rel=0.01)
    assert prior.gyro_misalignment_rad == pytest.approx(rotation.std(), rel=0.01)
    assert prior.accelerometer_cross_axis == pytest.approx(0.02 * 0.5**0.5)


@pytest.mark.parametrize("samples", [1, 5, 9])
def test_a_mean_over_a_tick(samples):
    period_s, middle = 0.02, 0.02 * np.arange(50)
    offsets = period_s * (np.arange(samples) - (samples - 1) / 2.0) / samples
    means = np.sin(20.0 * (middle[:, None] + offsets)).mean(axis=1)
    found = imu_errors.tick_mean(np.sin(20.0 * middle), samples)
    fourth_order = 1e-4
    np.testing.assert_allclose(found[1:-1], means[1:-1], atol=fourth_order)
    if samples > 1:
        assert np.abs(np.sin(20.0 * middle) - means)[1:-1].max() > 20 * fourth_order
