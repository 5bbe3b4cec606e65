"""A grip that holds its payload by a spring first: conservation laws, the plastic capture, a closed form.

Springs in a vehicle: stiff ones change nothing, soft ones swing as stated, and momentum stays what it was.
"""

import mujoco
import numpy as np
import pytest

from bench.true_flights import free_flyer
from hil_sim.plants.body import Solid
from hil_sim.plants.events import events
from hil_sim.plants.parts.contact import Contact
from hil_sim.plants.parts.exchange import Released
from hil_sim.plants.parts.soft_parts import Slosh, SoftParts
from hil_sim.plants.urdf_model import UrdfModel, matrix_of
from hil_sim.plants.vehicle_flight import VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario
from tests.hil_sim.plants.test_vehicle_plant import BOX, DYMAFLEX, PLACES, RATE

FINE_STEP_s = 1e-3
CENTRE_m = np.array([0.004, -0.006, 0.011])


def flown(motion, soft, rows, base="free"):
    model = UrdfModel(DYMAFLEX, base, (0.0, 0.0, -9.8) if base == "fixed" else (0.0, 0.0, 0.0), PLACES)
    model.hold("payload", BOX)
    velocity = np.array([0.01, -0.02, 0.03, *RATE]) if base == "free" else np.zeros(0)
    flight = VehicleFlight(model, motion, PLACES, "payload", FINE_STEP_s, velocity, soft=soft)
    return flight, flight.advance(rows)


def jointed(hertz):
    return SoftParts(np.full(5, hertz), 0.05, None)


def slosh(kg=1.5, hertz=0.5):
    rate = 2.0 * np.pi * hertz
    return SoftParts(np.zeros(0), 0.0, Slosh(kg, kg * rate**2, 0.01 * kg * rate, CENTRE_m))


class Still:
    """An arm that rests."""

    def at(self, time_s):
        q = np.tile([0.0, 0.6, 0.0, 0.8, 0.0], (len(time_s), 1))
        return q, 0.0 * q, 0.0 * q


def test_stiff_springs_are_no_springs(motion):
    _, stiff = flown(motion, None, 400)
    _, sprung = flown(motion, jointed(20.0), 400)
    _, soft = flown(motion, jointed(3.0), 400)
    gyro = slice(0, 3)
    size = np.abs(stiff.sensors[:, gyro]).max()
    near, far = (np.abs(one.sensors[200:, gyro] - stiff.sensors[200:, gyro]).max() for one in (sprung, soft))
    assert near < 0.02 * size
    assert far > 3.0 * near
    np.testing.assert_array_equal(soft.joints, stiff.joints)  # the encoders are on the drives


def test_a_joint_swings_at_its_frequency():
    soft = SoftParts(np.array([20.0, 3.0, 20.0, 20.0, 20.0]), 0.0, None)
    flight, _ = flown(Still(), soft, 1)
    soft.state[1] = 1e-3
    bends = []
    for _ in range(1000):
        flight.advance(1)
        bends.append(soft.state[1])
    crossings = np.flatnonzero(np.diff(np.sign(bends))) * FINE_STEP_s
    assert np.diff(crossings).mean() == pytest.approx(0.5 / 3.0, rel=0.1)  # the stiff joints take a little part


def test_springs_too_fast_for_the_step_are_refused(motion):
    with pytest.raises(ScenarioError, match=r"too fast for steps of 1 ms; give .physics. a smaller integration_steps"):
        flown(motion, jointed(100.0), 1)


class Turned(Still):
    """An arm that rests stretched out and ends folded."""

    def at(self, time_s):
        q, dq, ddq = super().at(time_s)
        q[time_s > 5.0] = [0.0, 0.3, 0.0, 2.4, 0.0]
        return q, dq, ddq


def test_springs_too_fast_in_a_later_pose_are_refused_before_the_flight():
    hertz, of_10_s = np.full(5, 60.0), SoftParts(np.full(5, 60.0), 0.05, None, duration_s=10.0)
    flown(Turned(), SoftParts(hertz, 0.05, None, duration_s=4.0), 1)
    with pytest.raises(ScenarioError, match="too fast for steps of 1 ms"):
        flown(Turned(), of_10_s, 1)


def test_a_standing_arm_sags_by_its_load():
    soft = jointed(5.0)
    flight, rows = flown(Still(), soft, 50, "fixed")
    bend, _ = soft.bend(soft.state)
    np.testing.assert_allclose(-soft.stiffness_N_m_rad * bend, rows.torques[-1], rtol=0.1, atol=0.05)
    assert np.abs(bend).max() > 1e-4
    assert flight.count == 50


def test_what_swings_takes_momentum_from_the_base_and_gives_it_back(motion):
    soft = slosh()
    flight, _ = flown(motion, soft, 1)
    total = []
    for _ in range(4):
        flight.advance(150)
        flight.show()
        mass = float(flight.model.body_mass.sum())
        body = flight.momenta.whole()[:3]
        total.append(body + soft.slosh.mass_kg * soft.state[3:])
    total = np.array(total)
    assert np.abs(total - total[0]).max() < 1e-5
    assert mass > 25.0
    flight.show()
    place, quaternion = flight.data.qpos[:3], flight.data.qpos[3:7]
    assert np.abs(soft.state[:3] - place - matrix_of(quaternion) @ CENTRE_m).max() > 1e-5


def test_within_its_play_a_joint_is_loose_and_the_play_grows():
    gap = np.zeros((2, 5))
    gap[:, 1] = 2e-3, 6e-3
    soft = SoftParts(np.full(5, 25.0), 0.1, None, gap, 10.0)
    soft.start(np.ones(5), np.zeros(5), (np.zeros(3), np.zeros(3)))
    state = np.zeros(10)
    state[1] = 1.5e-3
    assert soft.torque(state, 0.0)[1] == pytest.approx(-soft.stiffness_N_m_rad[1] * 0.5e-3)
    assert soft.torque(state, 10.0)[1] == 0.0
    state[:] = 1e-4
    assert np.flatnonzero(soft.torque(state, 0.0)).tolist() == [0, 2, 3, 4]


STEP_s = 2e-3
SPRING = 6.0, 0.5  # Hz, and damping ratio
VELOCITY_m_s, RATE_rad_s = np.array([0.03, -0.02, -0.05]), np.array([0.12, 0.04, -0.1])
ROWS = round(Contact.lasts_s(*SPRING) / STEP_s)


def started(motion, payload=BOX, *, spring, gravity=(0.0, 0.0, 0.0), soft=None):
    """In flight for 0.2 s, the payload just touched, or caught at once."""
    model = UrdfModel(DYMAFLEX, "free", gravity, PLACES)
    flight = VehicleFlight(model, motion, PLACES, "payload", STEP_s, np.array([0.01, -0.02, 0.03, *RATE]), soft=soft)
    flight.advance(100)
    comes = Released(payload, VELOCITY_m_s, RATE_rad_s)
    jolt = flight.touch(comes, *spring) if spring else flight.exchange(comes, None)
    return flight, jolt


@pytest.fixture
def motion(rng):
    return free_flyer.JointMotion.draw(rng)


def momenta(flight, held):
    """Linear and angular momentum about the world's origin, (6,), of the vehicle and of a payload beside it."""
    flight.show()
    mujoco.mj_forward(flight.model, flight.data)
    mujoco.mj_subtreeVel(flight.model, flight.data)
    mass, data = float(flight.model.body_mass.sum()), flight.data
    linear = mass * data.subtree_linvel[0]
    angular = data.subtree_angmom[0] + np.cross(data.subtree_com[0], linear)
    if held is not None:
        at, attitude, velocity, rate = np.split(held.state, [3, 7, 10])
        R = matrix_of(attitude)
        linear = linear + held.payload.mass_kg * velocity
        angular = angular + R @ held.payload.inertia_kg_m2 @ R.T @ rate
        angular = angular + np.cross(at, held.payload.mass_kg * velocity)
    return np.concatenate([linear, angular])


def test_momentum_and_angular_momentum_are_those_of_vehicle_and_payload_together(motion):
    flight, _ = started(motion, spring=SPRING)
    at_touch = momenta(flight, flight.contact)
    moved = []
    for _ in range(10):
        flight.advance(ROWS // 10)
        moved.append(momenta(flight, flight.contact))
    np.testing.assert_allclose(moved, np.tile(at_touch, (10, 1)), atol=2e-6)
    flight.close()
    np.testing.assert_allclose(momenta(flight, None), at_touch, atol=2e-6)
    assert np.abs(at_touch).max() > 0.1


def test_joints_that_give_way_are_caught_with_too(motion):
    """The spring's stiffness is that of the wrist as it gives way; by the stiff arm's, joints of 5 Hz swing up."""
    payload = Solid.box(8.0, (0.4, 0.35, 0.3), (0.02, -0.01, 0.2))
    flight, _ = started(motion, payload, spring=SPRING, soft=SoftParts(np.full(5, 5.0), 0.03, None))
    at_touch = momenta(flight, flight.contact)
    rows = flight.advance(ROWS)
    assert np.isfinite(rows.sensors).all()
    np.testing.assert_allclose(momenta(flight, flight.contact), at_touch, atol=1e-4)
    flight.close()
    np.testing.assert_allclose(momenta(flight, None), at_touch, atol=1e-4)


def test_what_the_wrist_has_felt_when_the_grip_closes_is_the_impulse_of_a_plastic_capture():
    flight, _ = started(Still(), spring=SPRING)
    quiet, at_once = started(Still(), spring=None)
    wrist, gyro = flight.vehicle.sensor("force", "link_5"), flight.vehicle.sensor("gyro", "imu_base")
    rows = flight.advance(ROWS).sensors
    felt = np.trapezoid(rows[:, wrist], dx=STEP_s, axis=0) + flight.close().sensors[wrist]
    wanted = at_once.sensors[wrist] + np.trapezoid(quiet.advance(ROWS).sensors[:, wrist], dx=STEP_s, axis=0)
    np.testing.assert_allclose(felt, wanted, atol=0.02 * np.abs(wanted).max())  # the wrist turns by 0.02 rad meanwhile
    np.testing.assert_allclose(flight.show().sensors[0, gyro], quiet.show().sensors[0, gyro], atol=1e-4)
    longest = np.abs(rows[:, wrist]).max()
    assert longest < 40.0  # N; at once it is an impulse of 0.3 N s in one row
    assert np.abs(wanted).max() > 0.1


def test_a_light_payload_swings_on_its_spring_as_a_damped_oscillator_does():
    speck = Solid.box(1e-4, (0.02, 0.02, 0.02), (0.0, 0.0, 0.0))
    flight, _ = started(Still(), speck, spring=SPRING)
    w, ratio = 2.0 * np.pi * SPRING[0], SPRING[1]
    w_d = w * np.sqrt(1.0 - ratio**2)
    link, stretch = flight.data.body("l.payload"), []
    for _ in range(60):
        flight.advance(1)
        flight.show()
        stretch.append(link.xmat.reshape(3, 3).T @ (flight.contact.state[:3] - link.xpos))
    t = STEP_s * np.arange(1, 61)
    expected = np.outer(np.exp(-ratio * w * t) * np.sin(w_d * t) / w_d, VELOCITY_m_s)
    np.testing.assert_allclose(stretch, expected, atol=0.02 * np.abs(expected).max())


def test_a_heavy_payload_at_the_end_of_the_arm_swings_no_faster():
    """The wrist gives way by a mass of about a kilogram; a spring made for 25 kg alone would be unstable here."""
    heavy = Solid.box(25.0, (0.55, 0.5, 0.5), (0.1, -0.05, 0.2))
    flight, _ = started(Still(), heavy, spring=(10.0, 0.5))
    rows = flight.advance(round(Contact.lasts_s(10.0, 0.5) / STEP_s))
    left = flight.contact.released(flight.grip(), flight.grip_twist())
    assert np.linalg.norm(left.rate_rad_s) < 0.02 * np.linalg.norm(RATE_rad_s)
    assert np.linalg.norm(left.velocity_m_s) < 0.02 * np.linalg.norm(VELOCITY_m_s)
    assert np.abs(rows.sensors).max() < 60.0


def test_a_joints_drive_holds_what_the_spring_pulls(motion):
    """The last joint's drive exerts what MuJoCo's force sensor reads beside it, the spring included."""
    flight, _ = started(motion, spring=SPRING)
    resting = flight.show().torques[0]
    rows = flight.advance(30)
    assert np.abs(rows.torques - resting).max() > 0.2
    force, torque = (flight.vehicle.sensor(kind, "link_5") for kind in ("force", "torque"))
    now = flight.show()
    site, joint = flight.data.site("at link_5"), flight.data.joint(flight.vehicle.joints[-1])
    axis, arm = joint.xaxis, joint.xanchor - site.xpos
    F, T = (site.xmat.reshape(3, 3) @ now.sensors[0, one] for one in (force, torque))
    assert now.torques[0, -1] == pytest.approx(float(axis @ (T - np.cross(arm, F))), rel=1e-6)


def test_a_grip_that_cannot_close_in_the_mission_is_refused(rng):
    tables = {
        "vehicle": {"urdf": "", "label": "x", "base": "free", "base_link": "base", "payload_link": "payload"},
        "payload": {"mass_kg": (5.0, 5.0)},
        "capture": {"earliest_s": 1.0, "latest_s": 1.0, "contact_Hz": (1.0, 1.0)},
        "sequence": [{"phase": 0, "action": "hold", "duration_s": 2.0}],
        "scenario": {"name": "x", "description": "x"},
        **{name: {} for name in ("sensor", "clock", "bus")},
        "device": {"x": {"kind": "x"}},
    }
    scenario = Scenario.model_validate(tables)
    with pytest.raises(ScenarioError, match="ends before the grip closes: give capture a higher contact_Hz"):
        events(scenario, BOX, STEP_s, 1000, rng)
    found = events(scenario, BOX, STEP_s, 1500, rng)
    assert [event.name for event in found] == ["capture", "grip"]
    assert found[1].row - found[0].row == pytest.approx(6.0 / (0.5 * 2.0 * np.pi) / STEP_s, abs=1.0)
    with pytest.raises(ValueError, match='held by a spring first with base = "free" alone'):
        Scenario.model_validate({**tables, "vehicle": {**tables["vehicle"], "base": "planar"}})
