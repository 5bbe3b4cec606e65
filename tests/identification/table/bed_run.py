"""A run of an arm on an air-bearing table, flown in MuJoCo, and its signals."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import onboard
from bench.true_flights import free_flyer, planar_bed
from bench.true_flights.free_flyer_sensors import ImuErrors, sample
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.identification.table.floating_base import AirBearingPrior, DragPrior

URDF = (Path(onboard.__file__).parent / "vehicles" / "dymaflex_air_bearing" / "dymaflex.urdf").read_text()
BOX = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
PAYLOAD = RigidBody(BOX.mass_kg, BOX.centre_of_mass_m, BOX.inertia_kg_m2)
DRAGS = (planar_bed.Drag(0.05, 0.004), planar_bed.Drag(2.0, 0.3), planar_bed.Drag(0.02, 0.002))
TILT = (0.002, -0.001)
PUCKS = {f"puck_{k}": DragPrior(5.0, 0.5) for k in (1, 2, 3)}
PRIOR = AirBearingPrior(0.05, 1.0, PUCKS, 0.005)
WIDE = np.array([50.0, *[20.0] * 3, *[10.0] * 6])
SECONDS = 8.0


class Run(NamedTuple):
    vehicle: VehicleModel
    chi: np.ndarray
    flight: planar_bed.PlanarFlight
    motion: free_flyer.JointMotion


def vehicle(base=BaseKind.PLANAR, payload="payload"):
    return VehicleModel(URDF, VehicleSpec(base, "base", payload))


@cache
def fly(swing, seconds=SECONDS, drags=DRAGS):
    rng = np.random.default_rng(5)
    motion = free_flyer.JointMotion.draw(rng, swing)
    motion = replace(motion, start_rad=np.array([0.0, 1.2, 0.0, -1.2, 0.0]))
    flight = planar_bed.fly(planar_bed.world(BOX, tilt_m_s2=TILT), motion, [0.02, -0.01, 0.05], drags, seconds)
    model = vehicle()
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(PAYLOAD)
    return Run(model, chi, flight, motion)


def exact(run, every=3):
    """Signals without noise at every third sample, joints as they were commanded."""
    f = run.flight
    at = slice(0, None, every)
    q, dq, ddq = run.motion.at(f.time_s[at])
    sigma = np.full(3, 1e-3)
    period_s = every * float(f.time_s[1] - f.time_s[0])
    return FlightSignals(period_s, q, dq, ddq, f.rate_rad_s[at], f.specific_force_m_s2[at], sigma, sigma, 1)


def noisy(run, rng, errors=ImuErrors()):  # noqa: B008
    sampled = sample(run.flight, errors, rng)
    return tick_signals(*sampled[:4], sampled[4:], 5, 0.1)


def once_a_turn(q, dq, ddq):
    """Cosine and sine of an angle and their two derivatives, (n, 3, 2); each (n,)."""
    cos, sin = np.cos(q), np.sin(q)
    turned = [(cos, sin), (-sin * dq, cos * dq), (-sin * ddq - cos * dq**2, cos * ddq - sin * dq**2)]
    return np.stack([np.stack(pair, axis=1) for pair in turned], axis=1)
