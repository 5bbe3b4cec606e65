"""The keys that ``heft calibrate`` writes: they are taken off every reading, on board and in tables."""

import numpy as np
import pytest

from drivers.records import IMU, SCALAR
from onboard import config
from onboard.devices import si
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import values_of
from onboard.ground.log.tables.columns import columns
from onboard.ground.log.tables.meaning import ChannelMeaning

PATH = config.packaged("dymaflex")
TEXT = PATH.read_text(encoding="utf-8")
E = np.array([[1.02, 0.01, -0.02], [0.0, 0.97, 0.005], [-0.01, 0.02, 1.01]])


def test_the_delay_of_a_recorded_rate_is_a_delay():
    (wheel,) = roles_of(config.load(config.packaged("tudelft"))).joints
    assert (wheel.is_rate, wheel.zero_sigma_rad, wheel.delay_sigma_s) == (True, 0.0, 1e-3)


def with_keys(table, keys):
    return config.parse(TEXT.replace(f"[{table}]", f"[{table}]\n{keys}", 1), PATH)


def imu_rows(rng, vehicle):
    true = rng.normal(size=(50, 6))
    rows = np.zeros(50, IMU)
    rows["gyro_scale_rad_s"] = rows["accel_scale_m_s2"] = np.float32(1e-4)
    one = float(np.float32(1e-4))
    rows["gyro_raw"] = np.rint((true[:, :3] @ E.T + [0.1, 0.2, -0.1]) / one)
    rows["accel_raw"] = np.rint((true[:, 3:] @ E.T + [0.3, 0.0, 0.5]) / one)
    return true, rows


def test_an_imu_is_corrected_on_board_and_in_tables(rng):
    matrix = E.tolist()
    vehicle = with_keys(
        "device.imu_base",
        f"gyro_matrix = {matrix}\ngyro_bias_rad_s = [0.1, 0.2, -0.1]\naccel_matrix = {matrix}\n"
        "accel_bias_m_s2 = [0.3, 0.0, 0.5]\ncalibrated = '2026-11-20'",
    )
    true, rows = imu_rows(rng, vehicle)
    signal = roles_of(vehicle).signals["imu_base"]
    on_board, usable = values_of(signal, rows)
    np.testing.assert_allclose(on_board, true, atol=2e-4)
    assert usable.all()
    shown = {c.name: c.values(rows) for c in columns(IMU, {}, rows, ChannelMeaning(frame="imu_base", signal=signal))}
    for number, axis in enumerate("xyz"):
        np.testing.assert_array_equal(shown[f"gyro_imu_base_{axis}"], on_board[:, number])
        np.testing.assert_array_equal(shown[f"accel_imu_base_{axis}"], on_board[:, 3 + number])
    assert roles_of(vehicle).signals["imu_2"].corrections == ()
    plain, _ = values_of(roles_of(vehicle).signals["imu_2"], rows)
    assert np.abs(plain - true).max() > 0.1


def test_a_cell_and_a_joint_are_corrected_and_judged_by_what_they_read():
    vehicle = with_keys("device.load_cell", "gain = 1.25\noffset_N = 0.5\n")
    rows = np.zeros(3, SCALAR)
    rows["value_raw"], rows["scale"], rows["unit"] = [500, 3000, 51_000], 1e-3, b"N"
    values, usable = values_of(roles_of(vehicle).signals["load_cell"], rows)
    np.testing.assert_allclose(values[:, 0], [0.0, 2.0, 40.4])
    assert usable.tolist() == [True, True, False]  # 51 N is read where the capacity is 50 N
    np.testing.assert_allclose(si.scalar(rows, roles_of(vehicle).signals["load_cell"]), values[:, 0])
    joint = with_keys("device.joint_2", "gain = -1.01\n")
    rows["value_raw"], rows["scale"], rows["unit"] = [1_000_000, 1_000_101, 999_899], 1e-3, b"rad"
    values, _ = values_of(roles_of(joint).signals["joint_2"], rows)
    np.testing.assert_allclose(values[:, 0], [0.0, -0.1, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("table", "keys", "why"),
    [
        ("device.imu_base", "gyro_matrix = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]", "near those of the unit matrix"),
        ("device.imu_base", "accel_matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]]", "3 values at the most"),
        ("device.joint_1", "gain = 0.0", "near 1 or -1"),
        ("device.load_cell", "gain = -1.0", "1e-12 or more"),
        ("device.load_cell", "offset_n = 1.0", "did you mean 'offset_N'"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(table, keys, why):
    with pytest.raises(config.ConfigError, match=why):
        with_keys(table, keys)


def test_a_weighed_link_stands_in_for_the_drawing():
    drawn = build_model(config.load(PATH))
    at = 10 * drawn.links.index("base")
    text = TEXT + "\n[link.base]\nmass_kg = 24.0\ncentre_of_mass_m = [0.01, 0.0, 0.0]\n"
    vehicle = config.parse(text, PATH)
    found = build_model(vehicle)
    np.testing.assert_allclose(found.chi[at : at + 4], [24.0, 0.24, 0.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(np.delete(found.chi, range(at, at + 10)), np.delete(drawn.chi, range(at, at + 10)))
    with pytest.raises(Exception, match=r"the URDF has no link .bass"):
        build_model(config.parse(TEXT + "\n[link.bass]\nmass_kg = 24.0\n", PATH))
