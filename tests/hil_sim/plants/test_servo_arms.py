"""Servos of an arm of many joints on a bench, and a base that sways and cones without one."""

import mujoco
import numpy as np
import pytest

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.plants.motions.carrier import attitudes
from hil_sim.plants.vehicle_plant import VehiclePlant
from onboard import config
from tests.hil_sim.plants.rocket import AS_DRAWN

MOVE = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {"phase": 1, "action": "swing", "duration_s": 5.0, "ramp_s": 1.0},
    {"phase": 2, "action": "hold", "duration_s": 2.0},
]


def plant(vehicle, seed=3, **tables):
    flown = VehiclePlant(rehearsal(config.packaged(vehicle), {"sequence": MOVE} | tables), np.random.default_rng(seed))
    flown.advance(1e9)
    return flown


@pytest.fixture(scope="module")
def arm():
    return plant("fixed_arm", servo={"default": {}}, payload={"mass_kg": [0.5, 0.5]}, capture=False)


def test_servos_of_an_arm_in_gravity_follow_the_command(arm) -> None:
    time_s = arm.step_s * np.arange(arm.rows)
    commanded = arm.program.at(time_s)[0]
    moved = np.ptp(commanded, axis=0)
    away = np.abs(arm.rows_true.joints - commanded)
    assert (moved > 0.1).all()
    assert (away.max(axis=0) < 0.1 * moved).all()
    assert away.max() > 1e-5  # it is no longer as commanded
    assert away[:, 1].max() < 1e-3  # its weight, 29 N m there, is fed forward: 5 mrad without


def test_the_torques_of_servos_explain_the_motion_with_friction_and_rotors(arm) -> None:
    """MuJoCo's inverse dynamics of what was flown asks each servo for its torque, but for what friction takes."""
    model, data = arm.flight.model, mujoco.MjData(arm.flight.model)
    q, h = arm.rows_true.joints, arm.step_s
    half = np.diff(q, axis=0) / h
    dry, viscous = np.array([(one.coulomb_n_m, one.viscous_n_m_s) for one in arm.drives.values()]).T
    model.dof_frictionloss[:] = model.dof_damping[:] = 0.0
    left = []
    for row in range(200, len(q) - 50, 500):
        data.qpos[:], data.qvel[:] = q[row], half[row - 1]
        data.qacc[:] = (half[row] - half[row - 1]) / h
        mujoco.mj_inverse(model, data)
        left.append(arm.rows_true.torques[row] - data.qfrc_inverse - viscous * half[row - 1])
    assert len(left) > 20
    assert (np.abs(left) <= 1.02 * dry + 1e-6).all()
    assert (np.abs(left).max(axis=0) > 0.5 * dry).all()


def test_a_servo_at_its_limit_does_not_hold_the_arm() -> None:
    limit_n_m = 0.05
    weak = plant("fixed_arm", servo={"default": {"torque_limit_N_m": limit_n_m}})
    assert np.abs(weak.rows_true.torques).max() == pytest.approx(limit_n_m)
    assert np.abs(weak.rows_true.joints - weak.program.at(weak.step_s * np.arange(weak.rows))[0]).max() > 0.3


def test_a_torque_limit_may_be_beyond_the_effort_of_the_urdf() -> None:
    heavy = {"payload": {"mass_kg": [10.0, 10.0]}, "capture": False}
    strong = plant("fixed_arm", servo={"default": {"torque_limit_N_m": 200.0}}, **heavy)
    most = np.abs(strong.rows_true.torques).max(axis=0)
    assert strong.efforts_n_m["a2"] == 60.0
    assert 80.0 < most[1] < 120.0
    assert np.abs(strong.rows_true.joints - strong.program.at(strong.step_s * np.arange(strong.rows))[0]).max() < 2e-3


def test_drives_are_those_that_the_scenario_gives_and_else_drawn(arm) -> None:
    given = plant("fixed_arm", servo={"default": {}, "a2": {"coulomb_N_m": 0.7, "rotor_kg_m2": 0.03}})
    told = given.truth()["drives"]
    assert told["a2"]["coulomb_n_m"] == 0.7
    assert told["a2"]["rotor_kg_m2"] == 0.03
    assert told["a2"]["viscous_n_m_s"] == arm.truth()["drives"]["a2"]["viscous_n_m_s"]
    assert told["a1"]["rotor_kg_m2"] == arm.truth()["drives"]["a1"]["rotor_kg_m2"]


def test_a_payload_that_comes_in_with_a_speed_turns_joints_that_give_way() -> None:
    """At a grip that closes at once the joints take what momentum about them came in."""
    payload = {"payload": {"mass_kg": [1.0, 1.0]}, "servo": {"default": {}}}
    tables = payload | {"capture": {"earliest_s": 0.5, "latest_s": 0.5, "velocity_sigma_m_s": 0.3}}
    caught = plant("fixed_arm", **tables)
    row = round(caught.events_s["capture"] / caught.step_s)
    jump = caught.rows_true.joints[row + 1] - caught.rows_true.joints[row]
    before = caught.rows_true.joints[row] - caught.rows_true.joints[row - 1]
    assert np.abs(jump - before).max() / caught.step_s > 0.02


def test_a_base_cones_and_shakes_under_joints_that_move_as_told() -> None:
    """Sway of none: the gyro shows spin and cone, the accelerometer their centripetal and the shaking."""
    shaken = {"broadband_mg": [5.0, 5.0, 5.0], "broadband_band_Hz": [5.0, 50.0]}
    cone = {"spin_rad_s": 0.25, "nutation_rate_rad_s": 0.04, "centre_of_mass_to_base_m": [0.0, 0.0, 1.4]}
    quiet = {"rate_rad_s": 0.0, "acceleration_m_s2": 0.0}
    tables = AS_DRAWN | {"base_motion": quiet, "coning": cone, "physics": {"integration_steps": 2}}
    still, moved = plant("rocksat", **tables), plant("rocksat", **tables, vibration=shaken)
    rate = still.inertial("imu_base").rate_rad_s  # its y is the base's z
    np.testing.assert_allclose(rate[:, 1], 0.25, atol=1e-9)
    np.testing.assert_allclose(np.hypot(rate[:, 0], rate[:, 2]), 0.04, atol=1e-6)
    extra = moved.inertial("imu_base").specific_force_m_s2 - still.inertial("imu_base").specific_force_m_s2
    np.testing.assert_allclose(extra.std(axis=0), 5e-3 * 9.80665, rtol=0.1)


def test_attitudes_are_those_of_one_turn_after_the_other(rng) -> None:
    turns = 0.1 * rng.standard_normal((500, 3))
    turns[0] = 0.0
    found, at = attitudes(turns, np.array([1.0, 0.0, 0.0, 0.0])), np.array([1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(found[0], at)
    for k in range(1, 500):
        mujoco.mju_quatIntegrate(at, turns[k], 1.0)
        np.testing.assert_allclose(found[k], at, atol=1e-12)
