"""A vehicle that its drives' torques move: momentum, friction, brake, and the one-joint plant as a second opinion."""

import mujoco
import numpy as np
import pytest

from bench.true_flights import free_flyer
from hil_sim.plants.body import Solid
from hil_sim.plants.drives.driven_vehicle import Drivable, DrivenVehicle, Losses
from hil_sim.plants.drives.servo_axis import ServoAxis

ONE = (
    '<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" type="hinge" axis="0 0 1"/>'
    '<inertial pos="0.5 0 0" mass="{mass}" diaginertia="0.05 0.05 0.05"/></body></worldbody></mujoco>'
)


def one(drive=Losses(0.3, 0.5, 0.2), noise_rad=0.0, effort=30.0):  # noqa: B008
    """One joint that stands: 0.25 mass + 0.05 + rotor kg m^2."""
    models = (mujoco.MjModel.from_xml_string(ONE.format(mass=mass)) for mass in (1.0, 3.0))
    return DrivenVehicle(Drivable(*models, ("j",), {"j": drive}, {"j": effort}, np.zeros(1), np.zeros(0)), noise_rad)


@pytest.fixture
def drivable():
    """DYMAFLEX, which turns."""
    box = Solid.box(5.0, (0.2, 0.16, 0.14), (0.03, -0.02, 0.08))
    joints = tuple(f"joint_{k}" for k in range(1, 6))
    drives, efforts = dict.fromkeys(joints, Losses(0.2, 0.3, 0.01)), dict.fromkeys(joints, 20.0)
    velocity = np.array([0.0, 0.0, 0.0, 0.03, -0.02, 0.05])
    worlds = (free_flyer.world(held).model for held in (None, box))
    return Drivable(*worlds, joints, drives, efforts, np.full(5, 0.4), velocity)


def momentum(vehicle):
    mujoco.mj_subtreeVel(vehicle.model, vehicle.data)
    return np.concatenate([vehicle.data.subtree_linvel[0], vehicle.data.subtree_angmom[0]])


def test_torques_of_the_joints_leave_the_momentum_and_move_the_base(drivable):
    vehicle = DrivenVehicle(drivable)
    for place, axis in enumerate(vehicle.axes.values()):
        axis.controller = lambda t, rate, place=place: 0.5 * np.sin(3.0 * t + place)
    before, pose = momentum(vehicle), vehicle.data.qpos[:7].copy()
    vehicle.advance(1.0)
    assert np.abs(before[3:]).max() > 1e-3
    assert momentum(vehicle) == pytest.approx(before, abs=1e-7)
    assert np.abs(vehicle.data.qpos[:7] - pose).max() > 1e-3
    assert max(axis.fastest_rad_s for axis in vehicle.axes.values()) > 0.1


def test_one_joint_moves_as_the_rigid_axis_does():
    vehicle = one()
    plain = ServoAxis(inertia_kg_m2=0.5, torque_n_m=30.0, coulomb_n_m=0.3, viscous_n_m_s=0.5)
    for axis in (vehicle.axes["j"], plain):
        axis.controller = lambda t, rate: 2.0 * np.cos(2.0 * t)
        axis.advance(2.0)
    moved = [axis.angle_rad(2.0 - 0.1 * k) for axis in (vehicle.axes["j"], plain) for k in range(4)]
    assert moved[:4] == pytest.approx(moved[4:], abs=2e-3)
    assert vehicle.axes["j"].highest_rad > 0.3


def test_dry_friction_holds_what_stands_and_the_brake_holds_more():
    vehicle = one()
    axis = vehicle.axes["j"]
    axis.controller = lambda t, rate: 0.29
    axis.advance(1.0)
    assert abs(axis.angle_rad(1.0)) < 1e-3
    axis.controller = lambda t, rate: 3.0
    axis.advance(1.5)
    assert axis.rate_rad_s > 1.0
    axis.controller = None
    axis.advance(1.7)
    assert abs(axis.rate_rad_s) < 1e-3
    assert axis.torque_n_m == 0.0


def test_a_motor_gives_no_more_than_its_effort():
    vehicle = one(Losses(0.0, 0.0, 0.2), effort=1.0)
    axis = vehicle.axes["j"]
    axis.controller = lambda t, rate: -50.0
    axis.advance(0.5)
    assert axis.torque_n_m == -1.0
    assert axis.rate_rad_s == pytest.approx(-axis.newest_s / 0.5, rel=1e-6)


def test_a_captured_payload_moves_with_the_gripper_and_is_heavier_to_turn():
    vehicle = one(Losses(0.0, 0.0, 0.0))
    axis = vehicle.axes["j"]
    axis.controller = lambda t, rate: 0.3
    axis.advance(0.5)
    rate, angle = axis.rate_rad_s, axis.angle_rad(0.5)
    vehicle.capture()
    assert (axis.rate_rad_s, axis.angle_rad(0.5)) == (rate, angle)
    since_s = axis.newest_s
    axis.advance(1.0)
    assert axis.rate_rad_s - rate == pytest.approx(0.3 * (axis.newest_s - since_s) / 0.8, rel=1e-6)


def test_encoders_are_noisy_and_joints_are_not():
    vehicle = one(noise_rad=1e-3)
    axis = vehicle.axes["j"]
    axis.advance(1.0)
    read = np.array([axis.angle_rad(0.6 + 0.001 * k) for k in range(400)])
    assert read.std() == pytest.approx(1e-3, rel=0.15)
    assert read[3] == axis.angle_rad(0.603)
    assert vehicle.angles_rad == [0.0]
