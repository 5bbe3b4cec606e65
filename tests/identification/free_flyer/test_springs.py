"""An arm with springs in its joints: no answer, and the reason is that something swings, not that nothing is held."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from hil_sim.plants import urdf_drawing
from hil_sim.plants.parts.soft_parts import SoftParts
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.standing import Level, standing
from tests.dynamics.free_flyer_twin import URDF
from tests.identification.free_flyer.recorded_flights import online, recorded, ticks_of

SECONDS, STEP_s = 7.0, 2e-3
PLACES = Places(("imu_base",), ())


def flown(frequency_Hz):
    """DYMAFLEX with nothing in its gripper swings its arm from the first moment on."""
    rng = np.random.default_rng(1)
    model = UrdfModel(urdf_drawing.read(URDF.read_text(), URDF.name), "free", (0.0, 0.0, 0.0), PLACES)
    soft = SoftParts(np.full(5, frequency_Hz), 0.02, None) if frequency_Hz else None
    velocity = np.array([0.0, 0.0, 0.0, *rng.uniform(-0.03, 0.03, 3)])
    flight = VehicleFlight(model, free_flyer.JointMotion.draw(rng), PLACES, "payload", STEP_s, velocity, soft=soft)
    rows = flight.advance(round(SECONDS / STEP_s))
    n = len(rows.joints)
    gyro, accelerometer = (rows.sensors[:, model.sensor(kind, "imu_base")] for kind in ("gyro", "accelerometer"))
    still = np.zeros((n, 3))
    seen = STEP_s * np.arange(n), rows.joints, rows.rates, gyro, accelerometer, still, still, rows.torques
    return recorded(free_flyer.FreeFlightSignals(*seen), rng)


@pytest.mark.parametrize(
    "frequency_Hz", [0.0, pytest.param(3.0, marks=pytest.mark.campaign)]
)  # with a payload: prediction/test_flexible
def test_joints_that_give_way_are_the_reason(frequency_Hz):
    signals = flown(frequency_Hz)
    ekf = online(signals, held=False)
    identifier, ticks = MotionIdentifier(ekf), ticks_of(signals)
    told = 0
    for first in range(0, len(ticks.time_s), 10):
        ekf.update(ticks.part(slice(first, first + 10)))
        told += sum(one.supported for one in identifier.estimate().quantities)
    ekf.finish()
    found = [standing(one, identifier.findings()) for one in identifier.estimate().quantities]
    assert told == 0
    if frequency_Hz:
        assert {one.level for one in found} == {Level.DO_NOT_USE}
        assert "swings at" in found[0].why
        assert "a flexible joint" in found[0].why
    else:
        assert {one.text for one in found} == {"weak: nothing is held"}
