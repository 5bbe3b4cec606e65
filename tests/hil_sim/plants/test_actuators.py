"""Reaction wheels of a simulated free-flyer: laws of momentum, and what the estimator's model says."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import onboard
from bench.true_flights import free_flyer
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants import urdf_drawing
from hil_sim.plants.motions.attitude import Wheels
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import AttitudeTable
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec

URDF = Path(onboard.__file__).parent / "vehicles" / "dymaflex_wheels" / "dymaflex.urdf"
HOLD = AttitudeTable(spring_N_m_rad=0.1, damper_N_m_s=0.5, torque_N_m=0.1, start_rad_s=100.0)
IDLE = HOLD.model_copy(update={"spring_N_m_rad": 0.0, "damper_N_m_s": 0.0})
RATE = (0.05, -0.04, 0.03)
STEP_s, EVERY = 2e-3, 5
SHORT = {
    "sequence": [{"phase": 0, "action": "hold", "duration_s": 0.3}],
    "capture": {"earliest_s": 0.1, "latest_s": 0.1},
    "burn": [],
}


class WithWheels:
    """The arm's motion, and none of the wheels."""

    def __init__(self, motion):
        self.motion = motion

    def at(self, time_s):
        return tuple(np.hstack([of_arm, np.zeros((len(time_s), 3))]) for of_arm in self.motion.at(time_s))


def flown(law, seconds=3.0):
    """The arm's motion, the flight, rates of the base at the IMU, speeds of the wheels."""
    motion, places = free_flyer.JointMotion.draw(np.random.default_rng(4)), Places(("imu_base",), ())
    model = UrdfModel(urdf_drawing.read(URDF.read_text(), URDF.name), "free", (0.0, 0.0, 0.0), places)
    assert model.joints[5:] == ("wheel_x", "wheel_y", "wheel_z")
    wheels, velocity = Wheels(np.arange(5, 8), np.eye(3), law), np.array([0.0, 0.0, 0.0, *RATE])
    flight = VehicleFlight(model, WithWheels(motion), places, None, STEP_s, velocity, wheels=wheels)
    rows = flight.advance(round(seconds / STEP_s))
    flight.show()
    return motion, flight, rows.sensors[:, model.sensor("gyro", "imu_base")], rows.rates[:, 5:]


def momentum(flight):
    """Of everything: linear, and angular about the centre of mass, world axes."""
    mujoco.mj_subtreeVel(flight.model, flight.data)
    base = flight.vehicle.body("base")
    whole = float(flight.model.body_subtreemass[base])
    return whole * flight.data.subtree_linvel[base], flight.data.subtree_angmom[base].copy()


@pytest.fixture(scope="module")
def held():
    return flown(HOLD)


def test_wheels_exchange_momentum_and_calm_the_base(held):
    before = momentum(flown(HOLD, STEP_s)[1])
    _, flight, rate, spun = held
    after = momentum(flight)
    assert np.abs(spun[-1] - 100.0).max() > 5.0  # they have worked
    a_millionth = 1e-6 * np.linalg.norm(before[1])
    np.testing.assert_allclose(after[1], before[1], atol=a_millionth)
    np.testing.assert_allclose(after[0], before[0], atol=1e-9)
    *_, idle, by_itself = flown(IDLE)
    assert np.abs(by_itself - 100.0).max() < 1.0  # by the base's own motion alone
    rms = [np.sqrt(np.mean(one**2)) for one in (rate, idle)]
    assert rms[0] < 0.9 * rms[1]


@pytest.mark.parametrize("wheels", [True, False])
def test_the_estimators_model_predicts_the_base_with_its_wheels_and_only_so(held, wheels):
    motion, _, rate, speeds = held
    rate, spin = rate[::EVERY], speeds[::EVERY] if wheels else np.zeros((len(speeds[::EVERY]), 3))
    q, dq, ddq = motion.at(EVERY * STEP_s * np.arange(len(rate)))
    still, change = np.zeros_like(spin), np.gradient(spin, EVERY * STEP_s, axis=0, edge_order=2)
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    chi = vehicle.chi.copy()
    chi[vehicle.payload_columns()] = 0.0
    chain = chain_motion(vehicle, *(np.hstack(two) for two in ((q, still), (dq, spin), (ddq, change))))
    R, _ = vehicle.pose_in_base("imu_base")
    base = predict_base_from_rate(chain.links, EVERY * STEP_s, chi, R @ rate[0], ())
    off = np.abs(base.rate @ R - rate).max()
    a_hundredth_of_the_gyros_noise = 2e-5
    assert off < a_hundredth_of_the_gyros_noise if wheels else off > 1e3 * a_hundredth_of_the_gyros_noise


def test_wheels_as_built_and_what_they_cannot_be():
    plant = VehiclePlant(scenario_of("dymaflex_wheels", SHORT), np.random.default_rng(3))
    drawn = np.array([np.diag(plant.bodies[f"rotor_{x}"].inertia_kg_m2)[k] for k, x in enumerate("xyz")])
    assert 0.0 < np.abs(drawn / 0.0025 - 1.0).max() < 5 * 0.004
    plant.advance(0.2)
    np.testing.assert_allclose(plant.wheel_rate_rad_s("wheel_y")[: plant.count], 100.0, atol=5.0)
    with pytest.raises(ScenarioError, match="no moving joint 'wheel_w'"):
        plant.wheel_rate_rad_s("wheel_w")
    with pytest.raises(ScenarioError, match="no thruster 'jet_3'"):
        plant.thrust_n("jet_3")
    told = {"phase": 1, "action": "sweep", "duration_s": 1.0, "rates": {"wheel_x": 10.0}}
    with pytest.raises(ScenarioError, match=r"wheel_x, which \[attitude\] turns"):
        VehiclePlant(scenario_of("dymaflex_wheels", SHORT | {"sequence": [told]}), np.random.default_rng(3))
    with pytest.raises(ScenarioError, match="with stiff joints"):
        scenario_of("dymaflex_wheels", SHORT | {"flexibility": {}})
