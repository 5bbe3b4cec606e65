"""A payload on the arm of a vehicle on an air-bearing table, one of whose pucks drags; the truth is MuJoCo's.

Wrong, beside noise at the datasheet's density: all that the real free-flyer has (IMU scale, axes, bias, drift, time;
base and links as they were weighed), the table's level, the velocity at the start, and which puck drags how much.
"""

import argparse
import contextlib
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from bench.identification.free_flyer import BASE_SIGMA, BOXES, ERRORS, LINK_SIGMA, PAYLOAD_SIGMA, as_built
from hil_sim.plants import free_flyer, planar_bed
from hil_sim.sensing.free_flyer_sensors import sample
from onboard import config
from onboard.dynamics.errors import SignalError
from onboard.dynamics.payload import standard_covariance
from onboard.dynamics.ticks import tick_signals
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec
from onboard.estimation.errors import ConvergenceError
from onboard.identification.exiddm.air_bearing import AirBearingPrior, DragPrior, air_bearing_exiddm, drag_of
from onboard.identification.exiddm.imu_errors import ImuPrior

Floats = NDArray[np.float64]

DURATION_s, SAMPLES_PER_TICK, SMOOTHING_s = 20.0, 5, 0.1
POSTURE_rad = (0.0, 1.2, 0.0, -1.2, 0.0)  # the gripper points up: the last joint turns the payload about the vertical
SWING = (1.0, 1.0, 1.0, 1.0, 3.0)  # of 0.35 rad: that turn is what shows Izz
TILT_m_s2, VELOCITY_m_s, RATE_rad_s = 0.002, 0.02, 0.05  # standard deviations; 0.2 mrad
VISCOUS_N_s_m, COULOMB_N = (1.0, 4.0), (0.1, 0.4)  # of the puck that drags
GOOD_N_s_m, GOOD_N = 0.05, 0.005  # of one that does not, at most


class Outcome(NamedTuple):
    """One run's answer: errors and sigmas of mass and Izz, relative; of Fv and Fc of the puck that drags."""

    error: Floats  # (4,)
    sigma: Floats  # (4,)
    plain: Floats  # (2,) of a least squares on rows that knows nothing of drag
    centre_m: float
    inside: NDArray[np.bool_]  # (6,) drags of all pucks in their intervals
    misfit: float
    reason: str  # why it is not to be used; empty if it is


def vehicle() -> VehicleModel:
    """The vehicle as its flight computer knows it."""
    urdf = config.packaged("rocksat").parents[1] / "dymaflex_air_bearing" / "dymaflex.urdf"
    return VehicleModel(urdf.read_text(encoding="utf-8"), VehicleSpec(BaseKind.PLANAR, "base", "payload"))


def priors(model: VehicleModel) -> tuple[dict[str, Floats], AirBearingPrior]:
    """What is not known: covariances of the links, and the rest."""
    links = {
        link: standard_covariance(model.chi[10 * k : 10 * k + 10], *(LINK_SIGMA if k else BASE_SIGMA))
        for k, link in enumerate(model.links[:-1])
    }
    gyro = (ERRORS.gyro_bias_rad_s, ERRORS.gyro_drift_rad_s2, ERRORS.scale, ERRORS.turn_rad)
    accelerometer = (ERRORS.accelerometer_bias_m_s2, ERRORS.accelerometer_drift_m_s3, ERRORS.scale, ERRORS.turn_rad)
    pucks = {f"puck_{k}": DragPrior(5.0, 0.5) for k in (1, 2, 3)}
    imu = ImuPrior(*gyro, *accelerometer, ERRORS.delay_s)
    return links, AirBearingPrior(VELOCITY_m_s, 1.0, pucks, TILT_m_s2, imu)


def run_one(body: free_flyer.Body, seed: int) -> Outcome | None:
    """One run from MuJoCo to the answer; none, where the fit finds none."""
    rng = np.random.default_rng(seed)
    base = as_built(free_flyer.BASE, BASE_SIGMA, rng)
    arm = tuple(as_built(link, LINK_SIGMA, rng) for link in free_flyer.ARM)
    motion = free_flyer.JointMotion.draw(rng)
    start = np.array(POSTURE_rad) + rng.uniform(-0.2, 0.2, 5)
    motion = replace(motion, start_rad=start, amplitude_rad=motion.amplitude_rad * np.array(SWING)[:, None])
    drags = [planar_bed.Drag(rng.uniform(0.0, GOOD_N_s_m), rng.uniform(0.0, GOOD_N)) for _ in planar_bed.PUCKS_m]
    dragging = int(rng.integers(3))
    drags[dragging] = planar_bed.Drag(rng.uniform(*VISCOUS_N_s_m), rng.uniform(*COULOMB_N))
    velocity = rng.standard_normal(3) * [VELOCITY_m_s, VELOCITY_m_s, RATE_rad_s]
    world = planar_bed.world(body, base, arm, TILT_m_s2 * rng.standard_normal(2))
    flown = planar_bed.fly(world, motion, velocity, drags, DURATION_s)
    sampled = sample(flown, ERRORS, rng)
    signals = tick_signals(*sampled[:4], sampled[4:], SAMPLES_PER_TICK, SMOOTHING_s)
    model = vehicle()
    links, prior = priors(model)
    exiddm = air_bearing_exiddm(model, "imu_base", signals, PAYLOAD_SIGMA, links, prior)
    try:
        found = exiddm.fit()
    except ConvergenceError:
        return None
    scale = np.array([body.mass_kg, body.inertia_kg_m2[2, 2]])
    plain = np.full(2, np.nan)
    with contextlib.suppress(SignalError):  # a mass below zero is no body
        rough = exiddm.rough()
        plain = np.array([rough.mass_kg, rough.inertia_kg_m2[2, 2]]) / scale - 1.0
    payload, sigma = found.payload, np.sqrt(np.diag(found.payload.covariance))
    truth = np.array([value for drag in drags for value in (drag.viscous_N_s_m, drag.coulomb_N)])
    drag = drag_of(found, prior.pucks)
    off = drag.drag - truth
    own = slice(2 * dragging, 2 * dragging + 2)
    error = np.array([payload.body.mass_kg, payload.body.inertia_kg_m2[2, 2]]) / scale - 1.0
    return Outcome(
        np.concatenate([error, off[own]]),
        np.concatenate([sigma[[0, 9]] / scale, drag.sigma[own]]),
        plain,
        float(np.linalg.norm(payload.body.centre_of_mass_m - body.centre_of_mass_m)),
        np.abs(off) <= stdtrit(np.inf, 0.975) * drag.sigma,
        found.misfit,
        drag.reason,
    )


def run(arguments: argparse.Namespace) -> None:
    """A payload of 5 kg, as many runs as there are seeds."""
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        _print("planar, 5 kg", list(pool.map(partial(run_one, BOXES[5]), seeds)))


def _print(title: str, flown: Sequence[Outcome | None]) -> None:
    runs = [one for one in flown if one is not None and not one.reason]
    refused = [one.reason for one in flown if one is not None and one.reason]
    error, sigma, plain = (np.array([one[k] for one in runs]) for k in range(3))
    inside = np.abs(error) <= stdtrit(np.inf, 0.975) * sigma
    print(f"\n{title}, {len(runs)} runs of {DURATION_s:g} s; misfit {np.mean([one.misfit for one in runs]):.3f}")
    print(f"{'':16}{'rms':>9}{'sigma':>9}{'p95':>9}{'bar':>6}{'covered':>9}{'bar':>9}{'plain':>9}")
    rows = (("mass, %", 100.0, "3"), ("Izz, %", 100.0, "3"), ("Fv, N s/m", 1.0, ""), ("Fc, N", 1.0, ""))
    for k, (name, factor, bar) in enumerate(rows):
        rms, told = (factor * np.sqrt(np.mean(x[:, k] ** 2)) for x in (error, sigma))
        p95 = factor * np.percentile(np.abs(error[:, k]), 95)
        least = f"{factor * np.sqrt(np.nanmean(plain[:, k] ** 2)):9.2f}" if k < 2 else ""
        print(f"{name:16}{rms:9.4f}{told:9.4f}{p95:9.4f}{bar:>6}{100 * inside[:, k].mean():8.1f}%{'92-98':>9}{least}")
    pucks = 100.0 * np.mean([one.inside for one in runs])
    centre = 1e3 * np.percentile([one.centre_m for one in runs], 95)
    print(f"of {len(flown)} runs {flown.count(None)} found no fit, {len(refused)} refused {sorted(set(refused)) or ''}")
    print(f"drag of all pucks covered {pucks:.1f} %; centre of mass, p95 {centre:.2f} mm")
