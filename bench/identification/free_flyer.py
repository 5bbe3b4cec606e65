"""A payload on a free-flyer's arm, against the Cramer-Rao bound; the truth is MuJoCo's.

Every seed is a flight of its own: motion, momentum at release, errors, noise. The bound is Cramer and Rao's for the
motion flown, at the truth, with every quantity estimated that the case leaves unknown.
"""

import argparse
import ast
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import ImuErrors, sample
from onboard import config
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.kinematics import composite_inertia, link_motions, momentum_columns
from onboard.dynamics.payload import BodyEstimate, body_of, standard_covariance, standard_of
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec
from onboard.estimation.errors import ConvergenceError
from onboard.identification.exiddm.batch import Exiddm
from onboard.identification.exiddm.free_base import free_exiddm
from onboard.identification.exiddm.imu_errors import CERTAIN, ImuPrior
from onboard.regressor.free_rows import measured_base, zero_wrench_rows

Floats = NDArray[np.float64]

DURATION_s, SAMPLES_PER_TICK, SMOOTHING_s, ROW_SMOOTHING_s = 20.0, 5, 0.1, 0.4
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
BASE_SIGMA, LINK_SIGMA = (0.003, 1e-3, 0.01), (0.01, 1e-3, 0.01)  # mass, centre of mass (m), inertia
PAYLOAD_SIGMA = np.array([50.0, *[20.0] * 3, *[10.0] * 6])
TENSOR_WEIGHTS = np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])  # XX XY YY XZ YZ ZZ in the tensor's norm


class Outcome(NamedTuple):
    """One flight's answer: errors in units of mass, metres, and the inertia's norm; squares of the bound alike."""

    error: Floats  # (3,)
    bound: Floats  # (3,) rms, same units
    plain: Floats  # (3,) of the least squares on rows
    inside: NDArray[np.bool_]  # (10,) truths inside the 95 % interval
    misfit: float  # whitened residual sum over its degrees of freedom


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


def _score(estimate: RigidBody, truth: RigidBody) -> Floats:
    return np.array(
        [
            abs(estimate.mass_kg / truth.mass_kg - 1.0),
            np.linalg.norm(estimate.centre_of_mass_m - truth.centre_of_mass_m),
            np.linalg.norm(estimate.inertia_kg_m2 - truth.inertia_kg_m2) / np.linalg.norm(truth.inertia_kg_m2),
        ]
    )


def _ten(body: RigidBody) -> Floats:
    return np.concatenate(
        [[body.mass_kg], body.centre_of_mass_m, body.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    )


def _rms(bound: BodyEstimate) -> Floats:
    variance = np.diag(bound.covariance)
    norm = np.linalg.norm(bound.body.inertia_kg_m2)
    return np.sqrt([variance[0] / bound.body.mass_kg**2, variance[1:4].sum(), TENSOR_WEIGHTS @ variance[4:] / norm**2])


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
    imu_prior = ImuPrior(
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
    return covariance, imu_prior


def fly(body: free_flyer.Body, real: bool, seed: int) -> Outcome:
    """One flight from MuJoCo to the answer."""
    recorded = record(body, real, seed)
    signals = recorded.signals
    model = vehicle()
    exiddm = free_exiddm(model, "imu_base", signals, PAYLOAD_SIGMA, *priors(model, real))
    moved = measured_base(model, "imu_base", signals, ROW_SMOOTHING_s)
    Y, y = zero_wrench_rows(model, signals.q, signals.dq, signals.ddq, moved)
    whole = np.isfinite(y).all(axis=1)
    plain = np.linalg.lstsq(Y[whole].reshape(-1, 10), y[whole].ravel())[0]
    plain_body = body_of(plain) if plain[0] > 0.0 else RigidBody(np.nan, np.full(3, np.nan), np.full((3, 3), np.nan))
    found = exiddm.fit()
    misfit = found.misfit
    return judged(body, found.payload, bound(exiddm, model, recorded, body), misfit, plain_body)


def bound(exiddm: Exiddm, model: VehicleModel, recorded: Recorded, body: free_flyer.Body) -> BodyEstimate:
    """Cramer and Rao's, at the drawn values of all nuisances, which changes it by their own few per cent."""
    signals, flight = recorded.signals, recorded.flight
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(_rigid(body))
    first = round((DURATION_s - len(signals.q) * signals.period_s) / 2.0 / (flight.time_s[1] - flight.time_s[0]))
    rate = model.pose_in_base("imu_base")[0] @ flight.rate_rad_s[first]
    return exiddm.bound(exiddm.parameters(_momentum(model, chi, signals, rate), _rigid(body)))


def judged(body: free_flyer.Body, found: BodyEstimate, least: BodyEstimate, misfit: float, plain: RigidBody) -> Outcome:
    """An answer beside the truth and the bound."""
    truth = _rigid(body)
    spread = stdtrit(np.inf, 0.975) * np.sqrt(np.diag(found.covariance))
    inside = np.abs(_ten(found.body) - _ten(truth)) <= spread
    return Outcome(_score(found.body, truth), _rms(least), _score(plain, truth), inside, misfit)


def _rigid(body: free_flyer.Body) -> RigidBody:
    return RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2)


def print_table(title: str, flown: Sequence[Outcome], limits: Sequence[float] | None) -> None:
    """Errors beside their bound and their bars."""
    error, bound, plain = (np.array([one[k] for one in flown]) for k in range(3))
    inside = np.array([one.inside for one in flown])
    groups = (slice(0, 1), slice(1, 4), slice(4, 10))
    print(f"\n{title}, {len(flown)} flights; misfit {np.mean([one.misfit for one in flown]):.3f}")
    print(
        f"{'':22}{'rms':>9}{'bound':>9}{'ratio':>7}{'bar':>6}{'p95':>9}{'bar':>7}{'covered':>9}{'bar':>9}{'plain':>10}"
    )
    for k, (name, factor, unit) in enumerate(
        (("mass", 100.0, "%"), ("centre of mass", 1e3, "mm"), ("inertia", 100.0, "%"))
    ):
        rms, least = np.sqrt(np.mean(error[:, k] ** 2)), np.sqrt(np.mean(bound[:, k] ** 2))
        ratio = np.sqrt(np.mean((error[:, k] / bound[:, k]) ** 2))
        bar = "" if limits is None else f"{limits[k]:g}"
        squares = plain[:, k][np.isfinite(plain[:, k])] ** 2
        rough = f"{factor * np.sqrt(squares.mean()):.3f}" if squares.size else "-"
        print(
            f"{name + ', ' + unit:22}{factor * rms:9.4f}{factor * least:9.4f}{ratio:7.2f}{'1.25':>6}"
            f"{factor * np.percentile(error[:, k], 95):9.4f}{bar:>7}"
            f"{100 * inside[:, groups[k]].mean():8.1f}%{'92-98':>9}"
            f"{rough:>10}"
        )


def noise(arguments: argparse.Namespace) -> None:
    """Datasheet noise and nothing else wrong."""
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for mass, body in BOXES.items():
            print_table(f"noise only, {mass} kg", list(pool.map(partial(fly, body, False), seeds(arguments))), None)


def real(arguments: argparse.Namespace) -> None:
    """Real-life errors, tools of 1 to 20 kg."""
    bodies = grown_tools(arguments)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        flown = [one for one in pool.map(_answered, bodies, seeds(arguments)) if one is not None]
    print(f"\n{len(bodies) - len(flown)} of {len(bodies)} flights without an answer: the fit gave up")
    print_table("real-life errors, workshop tools of 1 to 20 kg", flown, (2.0, 5.0, 6.0))


def _answered(body: free_flyer.Body, seed: int) -> Outcome | None:
    try:
        return fly(body, True, seed)
    except ConvergenceError:
        return None


def grown_tools(arguments: argparse.Namespace) -> list[free_flyer.Body]:
    """A workshop tool for every seed, scaled to a mass of 1 to 20 kg."""
    shapes = tools(arguments.datasets / "workshop_tools")
    masses = [float(np.exp(np.random.default_rng([seed]).uniform(0.0, np.log(20.0)))) for seed in seeds(arguments)]
    return [shapes[seed % len(shapes)].grown(mass) for seed, mass in zip(seeds(arguments), masses, strict=True)]


def seeds(arguments: argparse.Namespace) -> range:
    """Of the flights."""
    return range(arguments.first, arguments.first + arguments.seeds)
