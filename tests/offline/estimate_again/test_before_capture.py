"""How a payload moved before it was captured, against MuJoCo's capture of it."""

import numpy as np
import pytest

from hil_sim.plants import free_flyer
from onboard.dynamics.errors import SignalError
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.payload import standard_covariance, standard_of
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec
from onboard.offline.estimate_again.before_capture import before_capture, jump_of
from onboard.offline.estimate_again.identify_view import _within
from tests.dynamics.free_flyer_twin import URDF
from tests.identification.exiddm.recorded_flights import BIASED, recorded, ticks_of

VEHICLE = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
R_BS, PLACE_m = VEHICLE.pose_in_base("imu_base")
BEGIN_s, CAPTURE_s, END_s = 0.5, 1.2, 2.0
PERIOD_s = 0.01


def captured(seed, body, velocity, rate):
    """Ticks about a capture, and the motion of the payload before it, payload's axes."""
    rng = np.random.default_rng(seed)
    motion = free_flyer.JointMotion.draw(rng, swing_rad=0.15)
    flight = free_flyer.FreeFlight(motion, rng.uniform(-0.05, 0.05, 3))
    flown = free_flyer.fly_with_capture(flight, free_flyer.Capture(body, CAPTURE_s, velocity, rate), END_s)
    ticks = ticks_of(recorded(flown, rng, BIASED))
    about = ticks.part(slice(round(BEGIN_s / PERIOD_s), None))
    jump = jump_of(about, R_BS, PLACE_m, PERIOD_s)
    chi = standard_of(RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2))
    found = before_capture(VEHICLE, about.q[jump.at], jump, chi, standard_covariance(chi, 0.005, 1e-3, 0.02))
    R, _ = FloatingArm(VEHICLE, "payload").tip_pose(about.q[jump.at])
    return found, np.concatenate([R.T @ velocity, R.T @ rate]), about.time_s[jump.at]


@pytest.mark.parametrize("seed", range(4))
def test_a_large_body_that_tumbles(seed):
    body = free_flyer.Body.box(15.0, (0.7, 0.6, 0.5), (0.03, -0.02, 0.25))
    rng = np.random.default_rng(100 + seed)
    found, truth, at_s = captured(seed, body, 0.02 * rng.normal(size=3), 0.1 * rng.normal(size=3))
    off = np.concatenate([found.velocity_m_s, found.rate_rad_s]) - truth
    assert at_s == pytest.approx(CAPTURE_s, abs=0.1)
    assert off @ np.linalg.solve(found.covariance, off) < 22.5  # 99.9 % of chi-squared with 6
    assert (found.sigma[3:] < 0.04).all()


def test_of_a_small_one_the_interval_says_that_nothing_is_known():
    body = free_flyer.Body.box(1.5, (0.12, 0.11, 0.10), (0.01, -0.01, 0.05))
    found, truth, _ = captured(1, body, np.array([0.02, -0.01, 0.0]), np.array([0.1, 0.0, -0.1]))
    off = np.concatenate([found.velocity_m_s, found.rate_rad_s]) - truth
    assert off @ np.linalg.solve(found.covariance, off) < 22.5
    assert (found.sigma[3:] > 0.3).all()


def test_readings_must_be_there():
    body = free_flyer.Body.box(15.0, (0.7, 0.6, 0.5), (0.03, -0.02, 0.25))
    rng = np.random.default_rng(1)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), np.zeros(3), body)
    flight.advance(400)
    ticks = ticks_of(recorded(flight.history, rng, BIASED))
    with pytest.raises(SignalError, match="ticks about the capture"):
        jump_of(ticks.part(slice(0, 20)), R_BS, PLACE_m, PERIOD_s)
    ticks.measured[:, 0] = np.nan
    with pytest.raises(SignalError, match="readings are missing"):
        jump_of(ticks, R_BS, PLACE_m, PERIOD_s)
    jump = jump_of(ticks_of(recorded(flight.history, rng, BIASED)), R_BS, PLACE_m, PERIOD_s)
    with pytest.raises(SignalError, match="no mass"):
        before_capture(VEHICLE, ticks.q[0], jump, np.zeros(10), np.eye(10))


def test_it_is_shown_to_two_digits_of_its_interval():
    assert _within(np.array([-2.37, 8.451, 0.0123]), np.array([140.3, 0.59, 0.001])) == (
        "-2 ± 140, 8.45 ± 0.59, 0.0123 ± 0.0010"
    )
