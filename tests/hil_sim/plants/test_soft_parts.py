"""Springs in a vehicle: stiff ones change nothing, soft ones swing as stated, and momentum stays what it was."""

import numpy as np
import pytest

from hil_sim.plants import free_flyer
from hil_sim.plants.parts.soft_parts import Slosh, SoftParts
from hil_sim.plants.urdf_model import UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from tests.hil_sim.plants.test_vehicle_plant import BOX, DYMAFLEX, PLACES, RATE

STEP_s = 1e-3
CENTRE_m = np.array([0.004, -0.006, 0.011])


def flown(motion, soft, rows, base="free"):
    model = UrdfModel(DYMAFLEX, base, (0.0, 0.0, -9.8) if base == "fixed" else (0.0, 0.0, 0.0), PLACES)
    model.hold("payload", BOX)
    velocity = np.array([0.01, -0.02, 0.03, *RATE]) if base == "free" else np.zeros(0)
    flight = VehicleFlight(model, motion, PLACES, "payload", STEP_s, velocity, soft=soft)
    return flight, flight.advance(rows)


def jointed(hertz):
    return SoftParts(np.full(5, hertz), 0.05, None)


def slosh(kg=1.5, hertz=0.5):
    rate = 2.0 * np.pi * hertz
    return SoftParts(np.zeros(0), 0.0, Slosh(kg, kg * rate**2, 0.01 * kg * rate, CENTRE_m))


@pytest.fixture
def motion(rng):
    return free_flyer.JointMotion.draw(rng)


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
    crossings = np.flatnonzero(np.diff(np.sign(bends))) * STEP_s
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
    assert np.abs(soft.state[:3] - flight._anchor(flight._pose, flight._velocity)[0]).max() > 1e-5


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
