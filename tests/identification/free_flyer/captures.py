"""Captures in MuJoCo, how the payload really came, and what is known of each."""

import numpy as np

from bench.true_flights import free_flyer
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_covariance, standard_of
from onboard.identification.free_flyer.before_capture import Payload, Zeros, before_capture
from tests.identification.free_flyer.recorded_flights import BIASED, online, recorded, ticks_of

PERIOD_s = 0.01
LARGE = free_flyer.Body.box(15.0, (0.7, 0.6, 0.5), (0.03, -0.02, 0.25))


class Case:
    """A payload that is caught 1.2 s, or later, after the start; known is that it was touched about then."""

    def __init__(self, seed, body, velocity, rate, capture_s=1.2, end_s=2.5):
        rng = np.random.default_rng(seed)
        flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng, swing_rad=0.15), rng.uniform(-0.05, 0.05, 3))
        flown = free_flyer.fly_with_capture(flight, free_flyer.Capture(body, capture_s, velocity, rate), end_s)
        signals = recorded(flown, rng, BIASED)
        self.touched_s = capture_s - 0.07, capture_s + 0.04
        self.ticks = ticks_of(signals)
        self.online = online(signals, held=False)
        self.predictor = self.online.predictor
        true = np.c_[flown.rate_rad_s, flown.specific_force_m_s2]
        samples = round(len(true) * PERIOD_s / end_s)
        at = np.rint(self.ticks.time_s / PERIOD_s - 0.5).astype(int)
        means = true[: samples * (len(true) // samples)].reshape(-1, samples, 6).mean(axis=1)[at]
        off = self.ticks.measured - means
        self.zeros = Zeros(np.median(off, axis=0), np.diag(off.std(axis=0) ** 2 / len(off)))
        self.chi = standard_of(RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2))
        at = int(np.searchsorted(self.ticks.time_s, capture_s))
        servicer = FloatingArm(self.predictor.vehicle, "payload")
        R, _ = servicer.tip_pose(self.ticks.q[at])
        R_BS, _ = self.predictor.vehicle.pose_in_base("imu_base")
        base = R_BS @ true[round(capture_s / end_s * len(true)) - 1, :3]
        tip = servicer.tip_jacobian(self.ticks.q[at]) @ np.r_[np.zeros(3), base, self.ticks.dq[at]]
        self.velocity = R.T @ (velocity + np.cross(rate, R @ body.centre_of_mass_m))
        self.rate = R.T @ (rate + tip[3:])

    def told(self, **other):
        known = {"ticks": self.ticks, "chi": self.chi, "touched_s": self.touched_s} | other
        payload = Payload(known["chi"], standard_covariance(self.chi, 0.005, 1e-3, 0.02))
        state = np.zeros(len(self.predictor.names))
        return before_capture(self.predictor, state, known["ticks"], self.zeros, payload, known["touched_s"])

    def squares(self, found):
        off = np.concatenate([found.velocity_m_s - self.velocity, found.rate_rad_s - self.rate])
        return off @ np.linalg.solve(found.covariance, off)
