"""How a payload moved before it was captured, against MuJoCo's capture of it."""

import numpy as np
import pytest

from hil_sim.plants import free_flyer
from onboard.dynamics.errors import SignalError
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.payload import standard_covariance, standard_of
from onboard.offline.estimate_again.before_capture import Payload, Zeros, before_capture
from onboard.offline.estimate_again.identify_view import _within
from tests.identification.exiddm.recorded_flights import BIASED, online, recorded, ticks_of

CAPTURE_s, END_s, KNOWN_s, PERIOD_s = 1.2, 2.5, (1.13, 1.24), 0.01  # it was touched between these
LARGE = free_flyer.Body.box(15.0, (0.7, 0.6, 0.5), (0.03, -0.02, 0.25))


class Case:
    """A capture, and what is known of it."""

    def __init__(self, seed, body, velocity, rate):
        rng = np.random.default_rng(seed)
        flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng, swing_rad=0.15), rng.uniform(-0.05, 0.05, 3))
        flown = free_flyer.fly_with_capture(flight, free_flyer.Capture(body, CAPTURE_s, velocity, rate), END_s)
        signals = recorded(flown, rng, BIASED)
        self.ticks = ticks_of(signals)
        self.predictor = online(signals).predictor
        true = np.c_[flown.rate_rad_s, flown.specific_force_m_s2]
        samples = round(len(true) * PERIOD_s / END_s)
        at = np.rint(self.ticks.time_s / PERIOD_s - 0.5).astype(int)
        means = true[: samples * (len(true) // samples)].reshape(-1, samples, 6).mean(axis=1)[at]
        off = self.ticks.measured - means
        self.zeros = Zeros(np.median(off, axis=0), np.diag(off.std(axis=0) ** 2 / len(off)))
        self.chi = standard_of(RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2))
        at = int(np.searchsorted(self.ticks.time_s, CAPTURE_s))
        servicer = FloatingArm(self.predictor.vehicle, "payload")
        R, _ = servicer.tip_pose(self.ticks.q[at])
        R_BS, _ = self.predictor.vehicle.pose_in_base("imu_base")
        base = R_BS @ true[round(CAPTURE_s / END_s * len(true)) - 1, :3]
        tip = servicer.tip_jacobian(self.ticks.q[at]) @ np.r_[np.zeros(3), base, self.ticks.dq[at]]
        self.velocity = R.T @ (velocity + np.cross(rate, R @ body.centre_of_mass_m))
        self.rate = R.T @ (rate + tip[3:])

    def told(self, **other):
        known = {"ticks": self.ticks, "chi": self.chi, "touched_s": KNOWN_s} | other
        payload = Payload(known["chi"], standard_covariance(self.chi, 0.005, 1e-3, 0.02))
        state = np.zeros(len(self.predictor.names))
        return before_capture(self.predictor, state, known["ticks"], self.zeros, payload, known["touched_s"])

    def squares(self, found):
        off = np.concatenate([found.velocity_m_s - self.velocity, found.rate_rad_s - self.rate])
        return off @ np.linalg.solve(found.covariance, off)


@pytest.mark.parametrize("seed", range(6))
def test_a_large_body_that_tumbles(seed):
    rng = np.random.default_rng(100 + seed)
    case = Case(seed, LARGE, 0.02 * rng.normal(size=3), 0.1 * rng.normal(size=3))
    found = case.told()
    assert case.squares(found) < 22.5  # 99.9 % of chi-squared with 6
    assert (found.sigma[3:] < 0.06).all()
    assert (found.sigma[:3] < 0.05).all()


def test_of_a_small_one_the_interval_says_that_nothing_is_known():
    body = free_flyer.Body.box(1.5, (0.12, 0.11, 0.10), (0.01, -0.01, 0.05))
    case = Case(1, body, np.array([0.02, -0.01, 0.0]), np.array([0.1, 0.0, -0.1]))
    found = case.told()
    assert case.squares(found) < 22.5
    assert (found.sigma[3:] > 0.3).all()


def test_readings_must_be_there():
    case = Case(1, LARGE, np.zeros(3), np.zeros(3))
    with pytest.raises(SignalError, match=r"ticks are missing within 0\.12 s of the capture"):
        case.told(touched_s=(0.1, 0.2))
    with pytest.raises(SignalError, match="no mass"):
        case.told(chi=np.zeros(10))
    holed = case.ticks.part(np.r_[0:110, 112 : len(case.ticks.time_s)])
    with pytest.raises(SignalError, match="readings are missing"):
        case.told(ticks=holed)
    case.ticks.measured[120, 0] = np.nan
    with pytest.raises(SignalError, match="readings are missing"):
        case.told()


def test_it_is_shown_to_two_digits_of_its_interval():
    assert _within(np.array([-2.37, 8.451, 0.0123]), np.array([140.3, 0.59, 0.001])) == (
        "-2 ± 140, 8.45 ± 0.59, 0.0123 ± 0.0010"
    )
