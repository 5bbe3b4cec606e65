"""The world made from a URDF: against MuJoCo's own integrator, and by conservation laws."""

import mujoco
import numpy as np
import pytest

from bench.true_flights import free_flyer
from hil_sim.plants import urdf_drawing
from hil_sim.plants.parts.exchange import Released
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from onboard import config
from tests.dynamics.mechanics import mujoco_flights

DYMAFLEX = urdf_drawing.read(config.packaged("dymaflex").with_name("dymaflex.urdf").read_text(), "dymaflex.urdf")
BOX = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
RATE = (0.03, -0.02, 0.04)
PLACES = Places(("imu_base",), ("link_5",))
STEP_s = 2e-3


def flight(motion, base="free", gravity=(0.0, 0.0, 0.0), held=None):
    model = UrdfModel(DYMAFLEX, base, gravity, PLACES)
    if held is not None:
        model.hold("payload", held)
    velocity = np.array([0.0, 0.0, 0.0, *RATE]) if base == "free" else np.zeros(0)
    return VehicleFlight(model, motion, PLACES, "payload", STEP_s, velocity)


def columns(flown, rows):
    find = flown.vehicle.sensor
    return (
        rows.sensors[:, find("gyro", "imu_base")],
        rows.sensors[:, find("accelerometer", "imu_base")],
        rows.sensors[:, find("force", "link_5")],
        rows.sensors[:, find("torque", "link_5")],
    )


@pytest.fixture
def motion(rng):
    return free_flyer.JointMotion.draw(rng)


def test_it_flies_as_mujoco_s_integrator_moves_it(motion):
    """By torques of the joints from a control callback, in place of inverse dynamics: 2e-6 of a radian after 0.8 s."""
    ours = flight(motion)
    ours.advance(400), ours.show()
    theirs = mujoco_flights.fly(lambda t: [part[0] for part in motion.at(np.array([t]))], 0.8, rate=RATE)
    np.testing.assert_allclose(ours.data.body("l.base").xmat.reshape(3, 3), theirs.R_WB[-1], atol=2e-6)
    np.testing.assert_allclose(ours.data.body("l.link_5").xpos, theirs.tip[-1], atol=2e-6)


def grip(flown):
    """Axes of the gripper in those of the base, (3, 3)."""
    flown.show()
    data, body = flown.data, flown.vehicle.body
    R_WB, R_WG = (data.xmat[body(link)].reshape(3, 3) for link in ("base", "payload"))
    return R_WB.T @ R_WG


def test_mujoco_does_not_time_the_parts_of_its_steps(motion):
    model = flight(motion).vehicle.model
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    assert [timer.duration for timer in data.timer] == [0.0] * len(data.timer)


def test_what_was_caught_can_be_let_go_again(motion):
    """Let go without a push it leaves no trace: the momentum that remains is that of the vehicle alone."""
    ours = flight(motion, held=BOX)
    before = ours.advance(100)
    jolt = ours.exchange(None, Released(BOX, np.zeros(3), np.zeros(3)))
    np.testing.assert_allclose(jolt.sensors, 0.0, atol=1e-9)
    np.testing.assert_allclose(jolt.torques, 0.0, atol=1e-9)
    after = ours.advance(1)
    find = ours.vehicle.sensor("gyro", "imu_base")
    np.testing.assert_allclose(after.sensors[0, find], before.sensors[-1, find], atol=2e-3)


def test_a_push_on_what_leaves_is_felt_by_the_vehicle(motion):
    """What leaves takes its momentum along; the flange of the wrist gives it all but what the last link loses."""
    ours = flight(motion, held=BOX)
    ours.advance(100)
    ours.show()
    link = ours.data.body("l.payload")
    R, at = link.xmat.reshape(3, 3).copy(), link.xpos.copy()
    twist, before = np.zeros(6), momentum(ours)
    mujoco.mj_objectVelocity(ours.model, ours.data, mujoco.mjtObj.mjOBJ_XBODY, link.id, twist, 0)
    arm = ours.data.body("l.payload").xipos - at
    jolt = ours.exchange(None, Released(BOX, np.array([0.0, 0.0, 0.4]), np.zeros(3)))
    taken = 5.0 * (twist[3:] + np.cross(twist[:3], arm) + 0.4 * R[:, 2])
    np.testing.assert_allclose(before - momentum(ours), taken, atol=1e-9)
    assert 0.8 * 2.0 < jolt.sensors[ours.vehicle.sensor("force", "link_5")][2] < 2.0


@pytest.mark.parametrize("lost_kg", [0.8, -0.3])
def test_a_part_that_comes_off_takes_its_momentum_along_and_one_that_is_added_brings_it(motion, lost_kg):
    ours, at_m = flight(motion, held=BOX), np.array([0.05, -0.04, 0.1])
    before_s = ours.advance(100)
    ours.show()
    before, link, twist = momentum(ours), ours.data.body("l.payload"), np.zeros(6)
    mujoco.mj_objectVelocity(ours.model, ours.data, mujoco.mjtObj.mjOBJ_XBODY, link.id, twist, 0)
    moves = twist[3:] + np.cross(twist[:3], link.xmat.reshape(3, 3) @ at_m)
    ours.alter(BOX.without(lost_kg, at_m))
    np.testing.assert_allclose(before - momentum(ours), lost_kg * moves, atol=1e-9)
    find = ours.vehicle.sensor("gyro", "imu_base")
    np.testing.assert_allclose(ours.advance(1).sensors[0, find], before_s.sensors[-1, find], atol=2e-3)
    assert ours.caught.mass_kg == 5.0 - lost_kg


def test_a_body_without_a_part_has_its_moments_about_any_point_less_those_of_the_part():
    left, at = BOX.without(0.8, (0.05, -0.04, 0.1)), np.array([0.05, -0.04, 0.1])

    def about_origin(mass_kg, centre_m, inertia):
        return inertia + mass_kg * ((centre_m @ centre_m) * np.eye(3) - np.outer(centre_m, centre_m))

    whole = about_origin(BOX.mass_kg, BOX.centre_of_mass_m, BOX.inertia_kg_m2)
    rest = about_origin(left.mass_kg, left.centre_of_mass_m, left.inertia_kg_m2)
    np.testing.assert_allclose(whole - rest, about_origin(0.8, at, np.zeros((3, 3))), atol=1e-12)
    np.testing.assert_allclose(
        BOX.mass_kg * BOX.centre_of_mass_m, left.mass_kg * left.centre_of_mass_m + 0.8 * at, atol=1e-12
    )
    again = left.without(-0.8, at)
    np.testing.assert_allclose(again.inertia_kg_m2, BOX.inertia_kg_m2, atol=1e-12)


def momentum(flown):
    """Linear, of the vehicle, (3,), world axes."""
    mujoco.mj_forward(flown.model, flown.data)
    total, twist = np.zeros(3), np.zeros(6)
    for body in range(1, flown.model.nbody):
        mujoco.mj_objectVelocity(flown.model, flown.data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)
        total += flown.model.body_mass[body] * twist[3:]
    return total


def test_a_fixed_base_bears_what_gravity_asks(motion):
    """At rest the wrist carries link and payload: their weight, whatever the posture."""
    still = free_flyer.JointMotion(np.full(5, 0.4), *(np.zeros((5, 1)) for _ in range(3)))
    ours = flight(still, "fixed", (0.0, 0.0, -9.81), BOX)
    _, _, force, _ = columns(ours, ours.advance(1))
    assert np.linalg.norm(force[0]) == pytest.approx(9.81 * (5.0 + 0.399), rel=1e-9)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("<robot", "no XML"),
        ("<sdf/>", "no URDF"),
        ('<robot><link name="a"/><link name="b"/></robot>', "a single root"),
        (
            '<robot><link name="a"/><link name="b"/><joint name="j" type="floating"><parent link="a"/>'
            '<child link="b"/></joint></robot>',
            "floating",
        ),
        (
            '<robot><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
            '<child link="b"/></joint></robot>',
            "no <limit>",
        ),
        (
            '<robot><link name="a"/><joint name="j" type="fixed"><parent link="a"/><child link="c"/></joint></robot>',
            "no link 'c'",
        ),
    ],
)
def test_a_urdf_that_cannot_be_moved_is_refused_with_the_reason(text, wrong):
    with pytest.raises(ValueError, match=wrong):
        urdf_drawing.read(text, "x.urdf")


def test_a_link_that_moves_needs_a_mass():
    text = config.packaged("dymaflex").with_name("dymaflex.urdf").read_text()
    text = text.replace('mass value="0.9"', 'mass value="0"')
    with pytest.raises(ValueError, match="MuJoCo cannot simulate the URDF"):
        UrdfModel(urdf_drawing.read(text, "x"), "free", (0.0, 0.0, 0.0), PLACES)


def test_meshes_and_a_root_called_world_do_not_matter():
    text = config.packaged("dymaflex").with_name("dymaflex.urdf").read_text()
    mesh = '<visual><geometry><mesh filename="package://not/there.stl"/></geometry></visual>'
    text = text.replace('<link name="base">', f'<link name="base">{mesh}').replace('"base"', '"world"')
    model = UrdfModel(urdf_drawing.read(text, "x"), "free", (0.0, 0.0, 0.0), PLACES)
    assert model.drawn["world"].mass_kg == 23.1
