"""Priors that devices state: biases of an IMU, delays of encoders; and what is taken where none is stated."""

import math

import pytest

from onboard import cli, config
from onboard.devices.roles import TorqueKeys
from onboard.flight.estimate.problem.considered import weighs_suspects
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.problem.priors import biases, geometry_prior
from onboard.flight.estimate.readings.roles import roles_of

STATED = "gyro_bias_rad_s = 2e-3\naccelerometer_bias_m_s2 = 0.03 # which is estimated\n"


def vehicle(directory, keys, also=""):
    """The packaged device of the throws, with other keys of its IMU's biases."""
    packaged = config.named("tudelft")
    assert packaged.text.count(STATED) == 1
    text = packaged.text.replace(STATED, keys).replace("block_ms = 50", f"{also}block_ms = 50")
    (directory / "vehicle.toml").write_text(text)
    (directory / "tudelft.urdf").write_text(packaged.urdf_text)
    return config.load(directory / "vehicle.toml")


@pytest.mark.parametrize(
    ("keys", "also", "expected"),
    [
        ("", "", (0.1, 8.7e-3)),
        (STATED, "", (0.03, 2e-3)),
        ("accelerometer_bias_m_s2 = 0\ngyro_bias_rad_s = 0\n", "", (None, 0.0)),
        ("accelerometer_bias_m_s2 = 0.03\n", "zero_force_sigma_m_s2 = 0.2\n", (0.2, 8.7e-3)),
    ],
)
def test_a_silent_file_has_biases_of_what_a_calibration_leaves(tmp_path, keys, also, expected):
    asked = vehicle(tmp_path, keys, also)
    assert biases(asked) == expected
    who, _ = build_identifier(asked)
    assert ("zero_force_x" in who.base.names) == (expected[0] is not None)
    kinds = {one.effect: one.sigma for one in who.considered if one.effect.endswith("bias")}
    assert kinds == ({"gyro_bias": expected[1]} if expected[1] else {})


def test_rows_of_an_arm_have_none_but_what_is_stated():
    assert biases(config.named("student_arm")) == (None, 2e-3)


def test_a_device_that_states_its_delay_adds_it_to_the_joints_of_a_free_base():
    """A servo's reading is 0.45 ms old, give or take; the joint's own key, silent here, has 0.2 ms by itself."""
    servos = config.named("student_arm")
    geometry = geometry_prior(servos, build_model(servos))
    assert geometry.joints["joint_1"].delay_s == pytest.approx(math.hypot(0.45e-3, config.JointKeys().delay_s))
    encoders = config.named("dymaflex")
    assert geometry_prior(encoders, build_model(encoders)).joints["joint_1"].delay_s == config.JointKeys().delay_s


@pytest.mark.parametrize(
    ("kinds", "joint_s", "cell_s"),
    [
        (("cia406", "bota_ft"), 0.0, 0.926e-3),  # a pulse marks the joints, not the sensor's packages
        (("odrive", "cia404"), 0.655e-3, 0.05e-3),  # each encoder by its own arrivals, which wait for those of another
        (("ur_joint", "ur_wrench"), 0.0, 0.05e-3),  # all in one package: late together
        (("ur_joint", "bota_ft"), 0.0, 2.54e-3),  # against the joints, which are late too
    ],
)
def test_what_arrives_by_itself_is_late_against_the_joints_by_its_wait(tmp_path, kinds, joint_s, cell_s):
    encoder, cell = kinds
    base = [
        "--base",
        "fixed" if encoder == "ur_joint" else "free",
        *([] if encoder == "ur_joint" else ["--imu", "bmi088"]),
    ]
    assert cli.main(["init", str(tmp_path / "it"), *base, "--encoder", encoder, "--load-cell", cell]) == cli.OK
    roles = roles_of(config.load(tmp_path / "it" / "vehicle.toml"))
    assert [one.delay_sigma_s for one in roles.joints] == pytest.approx([joint_s] * len(roles.joints), rel=0.02)
    cells = [one.delay_sigma_s for one in roles.cells if not isinstance(one.keys, TorqueKeys)]
    assert cells == pytest.approx([cell_s] * len(cells), rel=0.02)


def test_a_cell_drifts_as_stated_or_as_a_silent_file_has_it(tmp_path):
    """In what rows consider, as in the filter of a free base."""
    arm = ["init", str(tmp_path / "it"), "--base", "fixed", "--joints", "2", "--load-cell", "net_ft"]
    assert cli.main(arm) == cli.OK
    path = tmp_path / "it" / "vehicle.toml"
    text = path.read_text()
    path.write_text(text.replace("capacity_N = 50.0", "capacity_N = 50.0\nzero_drift_N_s = 0.02", 1))
    considered = build_identifier(config.load(path))[0].considered
    sigma = [one.sigma for one in considered if one.effect == "drift"]
    assert sigma == pytest.approx([0.02, 5e-4, 5e-4, 1e-4, 1e-4, 1e-4])


@pytest.mark.parametrize(("name", "expected"), [("fixed_arm", True), ("workshop", True), ("rocksat", False)])
def test_faults_of_an_arm_that_weighs_by_its_motors_compete(name, expected):
    """As those of one with a wrist sensor do; an arm on a base that moves has parallel identifiers."""
    vehicle = config.named(name)
    assert weighs_suspects(vehicle, build_identifier(vehicle)[0].model) is expected


def test_faults_of_an_arm_that_was_recorded_do_not_where_its_friction_changes_in_between(tmp_path):
    assert cli.main(["init", str(tmp_path / "v"), "--base", "fixed", "--encoder", "recorded"]) == cli.OK
    vehicle = config.load(tmp_path / "v" / "vehicle.toml")
    model = build_identifier(vehicle)[0].model
    assert model.motors
    assert not weighs_suspects(vehicle, model)
