"""What a loss leaves: never more than there was, nothing without a row or a motion, and the bound of a batch fit."""

import json

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.planned import default_plan
from onboard import config
from onboard.cli import main
from onboard.estimation.smoothing import SmoothingWindow
from onboard.flight.estimate.problem.identification import build_exiddm
from onboard.flight.estimate.readings.cyclic import cyclic_functions
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.ground.before.foresee.contingency import foresee_without
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.plan import MotionNoise, plan_of
from onboard.identification.standing import Level
from tests.ground.before.foresee.test_foresee import EXACT, by_batch, made

FREE = ("--base", "free", "--joints", "2")
EXACT_GEAR = {"eccentricity_rad": 0.0, "transmission_error_rad": 0.0}


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return made(tmp_path_factory.mktemp("free"), *FREE)


def test_a_lost_joint_costs_as_much_as_a_batch_fit_of_the_parked_motion_says(tmp_path):
    """The filter's bound without joint_2 against the information of all ticks at once, joints and place exact."""
    vehicle, plan = made(tmp_path, *FREE, edits=EXACT)
    found = foresee_without(vehicle, plan, ["joint_2"])
    names, batch_sigma = by_batch(vehicle, plan, parked="joint_2")
    left = {one.name: one for one in found.left.quantities}
    sigma = np.array([left[name].sigma for name in names])
    whole = np.array([one.sigma for one, _ in found.pairs()])
    assert (sigma / whole).max() > 1.5  # it is a loss
    np.testing.assert_allclose(sigma, batch_sigma, rtol=0.03)


@pytest.mark.parametrize("lost", ["joint_1", "joint_2", "pulse"])
def test_nothing_is_known_better_without(free, lost):
    pairs = foresee_without(*free, [lost]).pairs()
    assert len(pairs) == 10
    ratios = np.array([left.sigma / whole.sigma for whole, left in pairs])
    assert ratios.min() > 1.0 - 1e-6
    assert (ratios.max() > 1.05) == lost.startswith("joint")


def test_a_free_flyer_knows_less_without_what_its_filter_fuses():
    """DYMAFLEX: a wrist cell, a second IMU, and cyclic errors of the gears as unknowns."""
    vehicle = config.load(config.packaged("dymaflex"))
    plan = plan_of(vehicle, default_plan(scenario_of(vehicle.path), 1.0 / vehicle.file.estimation.row_rate_hz))
    plan = plan.part(slice(0, round(plan.held.argmax() + 4.0 * vehicle.file.estimation.row_rate_hz)))
    of_cell, of_imu = (foresee_without(vehicle, plan, [lost]).pairs() for lost in ("load_cell", "imu_2"))
    wider = np.array([[left.sigma / whole.sigma for whole, left in pairs] for pairs in (of_cell, of_imu)])
    assert wider.min() > 1.0
    assert wider[0, 0] > 1.3
    assert wider[1].max() > 1.03
    exact = {
        name: device.model_copy(update=EXACT_GEAR) for name, device in vehicle.file.device.items() if "joint" in name
    }
    other = vehicle.model_copy(
        update={"file": vehicle.file.model_copy(update={"device": {**vehicle.file.device, **exact}})}
    )
    known = [one.sigma for one in foresee(other, plan).quantities]
    assert np.max([whole.sigma / own for (whole, _), own in zip(of_cell, known, strict=True)]) > 1.02


def test_without_any_joint_only_the_spin_is_left_and_nothing_is_good(free):
    found = foresee_without(*free, ["joint_1", "joint_2"])
    assert found.words[1].startswith("joint_2 is parked at")
    assert all(left.level is not Level.GOOD for _, left in found.pairs() if left.name.startswith(("m_", "I_")))


def test_without_what_measures_the_base_there_is_nothing(free):
    found = foresee_without(*free, ["imu_base"])
    assert found.left is None
    assert "no IMU is left, and the base moves" in found.why
    assert not found.useful


def test_the_command_says_what_is_left_and_fails_where_nothing_is(tmp_path, capsys):
    assert main(["checkout", "rocksat", "--without", "load_cell"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "nothing can be determined: no load cell, torque or base wrench is left to make a row of" in said
    report = tmp_path / "left.json"
    assert main(["checkout", "rocksat", "--without", "pulse", "--json", str(report)]) == 0
    assert "no pulse: times by arrival, 1 sigma imu_base 2.9 ms" in " ".join(capsys.readouterr().out.split())
    read = {one["name"]: one for one in json.loads(report.read_text())["quantities"]}
    assert read["m_tip_mass"]["level_without"] == "good"
    assert read["XX_arm_R"]["sigma"] is None
    assert main(["checkout", "rocksat", "--without", "joint_9"]) == 2
    assert "name one of joint_1, imu_base" in capsys.readouterr().err


def test_cyclic_errors_of_a_plan_are_smoothed_as_in_flight():
    """Of a joint at a steady rate: the flight's kernel over its samples against its frequency response."""
    vehicle = config.load(config.packaged("dymaflex"))
    _, model = build_exiddm(vehicle)
    role = next(joint for joint in roles_of(vehicle).joints if joint.joint == "joint_2")
    signal = roles_of(vehicle).signals[role.channel]
    width_s, rate_rad_s = vehicle.file.estimation.smoothing_ms * 1e-3, -0.13
    times_s = np.arange(-200, 201) * signal.period_s
    window = SmoothingWindow(times_s, [0.0], width_s, 3.5 * signal.period_s, kernel_of(vehicle))
    functions = cyclic_functions(np.outer(0.4 + rate_rad_s * times_s, [periods for periods, _ in signal.ripple]))
    wanted = np.stack([window.apply(functions, order).values[0] for order in range(3)])
    at = [joint.name for joint in model.joints].index("joint_2")
    q, dq = np.zeros((2, 1, len(model.joints)))
    q[0, at], dq[0, at] = 0.4, rate_rad_s
    width = wanted.shape[1]
    found = MotionNoise(vehicle, model).cyclic(q, dq)[0, :, width * at : width * at + width]
    assert np.abs(wanted).max(axis=1).min() > 0.05
    assert (np.abs(found - wanted).max(axis=1) < 0.01 * np.abs(wanted).max(axis=1)).all()
