"""A payload on a free-flyer's arm, against the Cramer-Rao bound; the truth is MuJoCo's.

Every seed is a flight of its own: motion, momentum at release, errors, noise. The bound is Cramer and Rao's for the
motion flown, at the truth, with every quantity estimated that the case leaves unknown.
"""

import ast
import os
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.momentum import momentum_columns
from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import ImuErrors, sample
from onboard import config
from onboard.dynamics.kinematics import composite_inertia, link_motions
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import BodyEstimate, numbers_of, standard_covariance, standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.ground.campaign.results import FlightAnswer
from onboard.identification.free_flyer.batch import MotionFit
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN, ImuPrior
from onboard.identification.quantities import BODY, BODY_UNITS
from onboard.identification.standing import Level

Floats = NDArray[np.float64]

NORMAL = 1.960  # half a 95 % interval, sigmas
DURATION_s, SAMPLES_PER_TICK, SMOOTHING_s = 20.0, 5, 0.1
BOXES = {
    1: free_flyer.Body.box(1.0, (0.10, 0.08, 0.12), (0.02, -0.01, 0.05)),
    5: free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08)),
    20: free_flyer.Body.box(20.0, (0.30, 0.30, 0.25), (0.04, -0.03, 0.14)),
}
ERRORS = ImuErrors(
    gyro_bias_rad_s=np.deg2rad(0.5),
    gyro_drift_rad_s2=np.deg2rad(0.005),
    accelerometer_bias_m_s2=0.1,
    accelerometer_drift_m_s3=1e-3,
    scale=0.003,
    turn_rad=np.deg2rad(0.2),
    delay_s=1e-4,
)
IMU_PRIOR = ImuPrior(
    ERRORS.gyro_bias_rad_s,
    ERRORS.gyro_drift_rad_s2,
    ERRORS.scale,
    ERRORS.turn_rad,
    ERRORS.accelerometer_bias_m_s2,
    ERRORS.accelerometer_drift_m_s3,
    ERRORS.scale,
    ERRORS.turn_rad,
    ERRORS.delay_s,
)
BASE_SIGMA, LINK_SIGMA = (0.003, 1e-3, 0.01), (0.01, 1e-3, 0.01)  # mass, centre of mass (m), inertia
PAYLOAD_SIGMA = np.array([50.0, *[20.0] * 3, *[10.0] * 6])


def vehicle() -> VehicleModel:
    """The free-flyer as its flight computer knows it."""
    urdf = config.packaged("rocksat").parents[1] / "dymaflex_parabolic" / "dymaflex.urdf"
    return VehicleModel(urdf.read_text(encoding="utf-8"), VehicleSpec(BaseKind.FREE, "base", "payload"))


def tools(directory: Path) -> list[free_flyer.Body]:
    """The workshop tools in their grasp frames."""
    found = []
    for path in sorted(directory.glob("*.yaml")):
        lines = (line.partition(":") for line in path.read_text(encoding="utf-8").splitlines()[1:])
        fields = {key.strip(): ast.literal_eval(value.strip()) for key, _, value in lines}
        grasp = np.array(fields["GRASP_WRT_MESH"])
        R, p = grasp[:3, :3], grasp[:3, 3]
        centre = R.T @ (np.array(fields["COM_WRT_MESH"]) - p)
        found.append(free_flyer.Body(fields["MASS"], centre, R.T @ np.array(fields["INERTIA_WRT_COM"]) @ R))
    return found


def as_built(body: free_flyer.Body, sigma: tuple[float, float, float], rng: np.random.Generator) -> free_flyer.Body:
    """A body that differs from its drawing by these sigmas: mass (relative), centre of mass (m), inertia (relative)."""
    mass, centre, inertia = sigma
    half_trace = 0.5 * np.trace(body.inertia_kg_m2)
    change = np.zeros((3, 3))
    change[np.triu_indices(3)] = inertia * half_trace * rng.standard_normal(6)
    return free_flyer.Body(
        body.mass_kg * (1.0 + mass * rng.standard_normal()),
        body.centre_of_mass_m + centre * rng.standard_normal(3),
        body.inertia_kg_m2 + change + np.triu(change, 1).T,
    )


def vehicle_as_built(rng: np.random.Generator) -> tuple[free_flyer.Body, tuple[free_flyer.Body, ...]]:
    """Base and arm as they came out, within what is known of them."""
    base = as_built(free_flyer.BASE, BASE_SIGMA, rng)
    return base, tuple(as_built(link, LINK_SIGMA, rng) for link in free_flyer.ARM)


def _momentum(model: VehicleModel, chi: Floats, signals: FlightSignals, rate: Floats) -> Floats:
    """Angular momentum about the centre of mass at the first tick, from the true rate of the base."""
    links = link_motions(model, signals.q[:1], signals.dq[:1], signals.ddq[:1])
    C, still = composite_inertia(links, chi)[0], np.zeros((1, 3))
    parts = zip(links, chi.reshape(-1, 10), strict=True)
    mu = np.sum([momentum_columns(link, still, still)[0] @ own for link, own in parts], axis=0)
    v = -np.linalg.solve(C[:3, :3], C[:3, 3:] @ rate + mu[:3])
    return np.asarray(C[3:, :3] @ v + C[3:, 3:] @ rate + mu[3:])


class Recorded(NamedTuple):
    """One flight as it was, and what its sensors said of it."""

    flight: free_flyer.FreeFlightSignals
    signals: FlightSignals


def record(body: free_flyer.Body, real: bool, seed: int) -> Recorded:
    """One flight by MuJoCo, its vehicle built and its sensors read with the errors of the case."""
    rng = np.random.default_rng(seed)
    base, arm = vehicle_as_built(rng) if real else (free_flyer.BASE, free_flyer.ARM)
    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(body, base, arm), motion, rng.uniform(-0.05, 0.05, 3), DURATION_s)
    sampled = sample(flight, ERRORS if real else ImuErrors(), rng)
    return Recorded(flight, tick_signals(*sampled[:4], sampled[4:], SAMPLES_PER_TICK, SMOOTHING_s))


def priors(model: VehicleModel, real: bool) -> tuple[dict[str, Floats], ImuPrior]:
    """What is known beforehand of the links, and the prior on instrument errors."""
    if not real:
        return {}, CERTAIN
    covariance = {}
    for index, link in enumerate(model.links[:-1]):
        own = model.chi[10 * index : 10 * index + 10]
        covariance[link] = standard_covariance(own, *(LINK_SIGMA if index else BASE_SIGMA))
    return covariance, IMU_PRIOR


def bound(motion_fit: MotionFit, model: VehicleModel, recorded: Recorded, body: free_flyer.Body) -> BodyEstimate:
    """Cramer and Rao's, at the drawn values of all nuisances, which changes it by their own few per cent."""
    signals, flight = recorded.signals, recorded.flight
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(_rigid(body))
    first = round((DURATION_s - len(signals.q) * signals.period_s) / 2.0 / (flight.time_s[1] - flight.time_s[0]))
    rate = model.pose_in_base("imu_base")[0] @ flight.rate_rad_s[first]
    return motion_fit.bound(motion_fit.parameters(_momentum(model, chi, signals, rate), _rigid(body)))


def answers(body: free_flyer.Body, found: BodyEstimate | None, least: BodyEstimate) -> tuple[FlightAnswer, ...]:
    """Mass, centre and inertia beside the truth and the bound; without an interval where there is no estimate."""
    truth, bound = _rigid(body), np.sqrt(np.diag(least.covariance))
    told = [
        FlightAnswer(name, unit, float(true), bound=float(own), level=str(Level.WEAK))
        for name, unit, true, own in zip(BODY, BODY_UNITS, numbers_of(truth), bound, strict=True)
    ]
    if found is None:
        return tuple(told)
    values, sigmas = numbers_of(found.body), np.sqrt(np.diag(found.covariance))
    return tuple(
        one._replace(value=v, low=v - NORMAL * s, high=v + NORMAL * s, sigma=s, supported=True, level=str(Level.GOOD))
        for one, v, s in zip(told, values.tolist(), sigmas.tolist(), strict=True)
    )


def _rigid(body: free_flyer.Body) -> RigidBody:
    return RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2)


def grown_tool(seed: int) -> free_flyer.Body:
    """A workshop tool scaled to a mass of 1 to 20 kg; the data set ``workshop_tools`` lies in $HEFT_DATASETS."""
    shapes = tools(Path(os.environ.get("HEFT_DATASETS", "../shared/datasets")) / "workshop_tools")
    return shapes[seed % len(shapes)].grown(float(np.exp(np.random.default_rng([seed]).uniform(0.0, np.log(20.0)))))
