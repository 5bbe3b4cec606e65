"""Joints that give way: base and bends move as MuJoCo's do, steps between ticks are exact, soft springs are refused."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from hil_sim.plants import urdf_drawing
from hil_sim.plants.parts.soft_parts import SoftParts
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior, SpringPrior
from tests.dynamics.free_flyer_twin import BOX, URDF

TICK_s, TICKS = 0.01, 40
PLACES = Places(("imu_base",), ())


def flown(frequency_Hz, step_s, seconds, tick_s=TICK_s):
    """The arm swings with a payload; every joint has a spring, all else is known."""
    model = UrdfModel(urdf_drawing.read(URDF.read_text(), URDF.name), "free", (0.0, 0.0, 0.0), PLACES)
    soft, motion = (
        SoftParts(np.full(5, frequency_Hz), 0.02, None),
        free_flyer.JointMotion.draw(np.random.default_rng(1)),
    )
    velocity = np.array([0.0, 0.0, 0.0, 0.05, -0.03, 0.02])
    flight = VehicleFlight(model, motion, PLACES, "payload", step_s, velocity, soft=soft)
    flight.alter(BOX)
    springs = [SpringPrior(k, 0.1, d, 0.5) for k, d in zip(soft.stiffness_N_m_rad, soft.damping_N_m_s_rad, strict=True)]
    rows = flight.advance(round(seconds / step_s))
    seen = slice(None, None, round(tick_s / step_s))
    ddq = motion.at(tick_s * np.arange(len(rows.joints[seen])))[2]
    shown = [rows.sensors[seen, model.sensor(kind, "imu_base")] for kind in ("gyro", "accelerometer")]
    return (rows.joints[seen], rows.rates[seen], ddq), np.hstack(shown), springs


def predictor_of(springs):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    joints = {f"joint_{k}": JointPrior(spring=spring) for k, spring in enumerate(springs, 1)}
    return ImuPredictor(vehicle, "imu_base", TICK_s, 1, {}, CERTAIN, GeometryPrior(joints=joints))


@pytest.mark.parametrize(
    ("frequency_Hz", "step_s", "seconds", "at_least_rad", "rad_s", "m_s2"),
    [
        (3.0, 2e-3, 2.5, 0.8, 5e-4, 5e-4),
        pytest.param(20.0, 1e-3, 1.5, 0.03, 1e-4, 4e-4, marks=pytest.mark.campaign),  # test_flexible flies it
    ],
)
def test_it_moves_as_in_mujoco(frequency_Hz, step_s, seconds, at_least_rad, rad_s, m_s2):
    motion, shown, springs = flown(frequency_Hz, step_s, seconds)
    predictor = predictor_of(springs)
    x = np.zeros(len(predictor.names))
    x[PAYLOAD] = standard_of(RigidBody(BOX.mass_kg, np.array(BOX.centre_of_mass_m), np.array(BOX.inertia_kg_m2)))
    x[RATE] = predictor.imus[0].R_BS @ shown[0, :3]
    largest, compared = 0.0, 0
    for first in range(0, len(shown) - TICKS - 2, TICKS):  # the state is carried on, nothing corrects it
        found = predictor.predict(*(part[first : first + TICKS + 2] for part in motion), x)
        away = np.abs(found.values - shown[first + 1 : first + TICKS + 1])
        assert away[:, :3].max() < rad_s
        assert away[:, 3:].max() < m_s2
        x, compared = found.state, compared + TICKS
        largest = max(largest, float(np.abs(x[predictor.bends][:5]).max()))
    assert compared >= 80
    assert largest > at_least_rad  # as stiff joints it would be another motion


def test_where_no_motion_is_found_there_is_no_prediction():
    motion, _, springs = flown(3.0, 2e-3, 0.5)
    predictor = predictor_of(springs)
    x = np.zeros(len(predictor.names))
    x[PAYLOAD] = standard_of(RigidBody(BOX.mass_kg, np.array(BOX.centre_of_mass_m), np.array(BOX.inertia_kg_m2)))
    x[predictor.bends[5:]] = 1e5  # rad/s
    with np.errstate(all="ignore"):
        found = predictor.predict(*(part[:TICKS] for part in motion), x)
    assert np.isnan(found.values).all()
    assert not found.moderate
