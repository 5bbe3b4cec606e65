"""A grip that holds its payload by a spring first: conservation laws, the plastic capture, a closed form."""

import mujoco
import numpy as np
import pytest

from hil_sim.plants import free_flyer
from hil_sim.plants.body import Body
from hil_sim.plants.events import events
from hil_sim.plants.parts.contact import Contact
from hil_sim.plants.parts.exchange import Released
from hil_sim.plants.parts.soft_parts import SoftParts
from hil_sim.plants.urdf_model import UrdfModel, matrix_of
from hil_sim.plants.vehicle_flight import VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario
from tests.hil_sim.plants.test_soft_parts import Still
from tests.hil_sim.plants.test_vehicle_plant import BOX, DYMAFLEX, PLACES, RATE

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
    payload = Body.box(8.0, (0.4, 0.35, 0.3), (0.02, -0.01, 0.2))
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
    speck = Body.box(1e-4, (0.02, 0.02, 0.02), (0.0, 0.0, 0.0))
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
    heavy = Body.box(25.0, (0.55, 0.5, 0.5), (0.1, -0.05, 0.2))
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
