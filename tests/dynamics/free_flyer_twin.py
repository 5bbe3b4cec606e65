"""One flight of MuJoCo's free-flyer beside the model that the flight computer has of it."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import onboard
from bench.identification.momentum import momentum_columns
from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import ImuErrors, SampledSignals, sample
from onboard.dynamics.kinematics import composite_inertia, link_motions
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec

URDF = Path(onboard.__file__).parent / "vehicles" / "dymaflex_parabolic" / "dymaflex.urdf"
BOX = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
PAYLOAD = RigidBody(BOX.mass_kg, BOX.centre_of_mass_m, BOX.inertia_kg_m2)


class Twin(NamedTuple):
    vehicle: VehicleModel
    chi: np.ndarray  # the truth
    motion: free_flyer.JointMotion
    flight: free_flyer.FreeFlightSignals

    def samples(self, rng, errors=ImuErrors(), noise=True) -> SampledSignals:  # noqa: B008
        if noise:
            return sample(self.flight, errors, rng)
        f = self.flight
        return SampledSignals(f.time_s, f.q_rad, f.rate_rad_s, f.specific_force_m_s2, 1e-3, 1e-2)

    def momentum(self, q, dq, rate_base):
        """Angular momentum about the centre of mass, base axes, when the base turns with this rate."""
        links = link_motions(self.vehicle, q[None], dq[None], np.zeros((1, len(q))))
        C, zero = composite_inertia(links, self.chi)[0], np.zeros((1, 3))
        own = self.chi.reshape(-1, 10)
        mu = sum(momentum_columns(link, zero, zero)[0] @ part for link, part in zip(links, own, strict=True))
        v = -np.linalg.solve(C[:3, :3], C[:3, 3:] @ rate_base + mu[:3])
        return C[3:, :3] @ v + C[3:, 3:] @ rate_base + mu[3:]


def twin(seconds: float, seed: int = 7) -> Twin:
    rng = np.random.default_rng(seed)
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    chi = vehicle.chi.copy()
    chi[vehicle.payload_columns()] = standard_of(PAYLOAD)
    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(BOX), motion, rng.uniform(-0.05, 0.05, 3), seconds)
    return Twin(vehicle, chi, motion, flight)
