"""A payload on the arm of a vehicle on an air-bearing table, one of whose pucks drags; the truth is MuJoCo's.

Wrong, beside noise at the datasheet's density: all that the real free-flyer has (IMU scale, axes, bias, drift, time;
base and links as they were weighed), the table's level, the velocity at the start, and which puck drags how much.
"""

import os
from dataclasses import replace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import (
    BASE_SIGMA,
    BOXES,
    ERRORS,
    IMU_PRIOR,
    LINK_SIGMA,
    NORMAL,
    PAYLOAD_SIGMA,
    as_built,
)
from bench.true_flights import free_flyer, planar_bed
from bench.true_flights.free_flyer_sensors import sample
from onboard import config
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.payload import standard_covariance
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import tick_signals
from onboard.estimation.errors import ConvergenceError
from onboard.ground.campaign.results import FlightAnswer, FlightResult
from onboard.identification.standing import Level
from onboard.identification.table.air_bearing import TableFit, drag_of
from onboard.identification.table.floating_base import AirBearingPrior, DragPrior

Floats = NDArray[np.float64]

DURATION_s, SAMPLES_PER_TICK, SMOOTHING_s = 20.0, 5, 0.1
POSTURE_rad = (0.0, 1.2, 0.0, -1.2, 0.0)  # the gripper points up: the last joint turns the payload about the vertical
SWING = (1.0, 1.0, 1.0, 1.0, 3.0)  # of 0.35 rad: that turn is what shows Izz
TILT_m_s2, VELOCITY_m_s, RATE_rad_s = 0.002, 0.02, 0.05  # standard deviations; 0.2 mrad
VISCOUS_N_s_m, COULOMB_N = (1.0, 4.0), (0.1, 0.4)  # of the puck that drags
GOOD_N_s_m, GOOD_N = 0.05, 0.005  # of one that does not, at most


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
    pucks = {f"puck_{k}": DragPrior(5.0, 0.5) for k in (1, 2, 3)}
    return links, AirBearingPrior(VELOCITY_m_s, 1.0, pucks, TILT_m_s2, imu=IMU_PRIOR)


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """One run of ``bench/plans/planar.toml``, 5 kg, from MuJoCo to the answer.

    Args:
        seed: of everything drawn.
        settings: none.
    """
    del settings
    body = BOXES[5]
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
    motion_fit = TableFit(model, "imu_base", signals, PAYLOAD_SIGMA, links, prior)
    names, units = ("m", "c_x", "c_y", "I_zz", "Fv", "Fc"), ("kg", "m", "m", "kg m^2", "N s/m", "N")
    own = slice(2 * dragging, 2 * dragging + 2)
    drag = drags[dragging]
    truth = [body.mass_kg, *body.centre_of_mass_m[:2], body.inertia_kg_m2[2, 2], drag.viscous_N_s_m, drag.coulomb_N]
    told = [
        FlightAnswer(name, unit, float(true), level=str(Level.WEAK))
        for name, unit, true in zip(names, units, truth, strict=True)
    ]
    try:
        found = motion_fit.fit()
    except ConvergenceError as error:
        return FlightResult(tuple(one._replace(why=str(error)) for one in told))
    fit, payload = drag_of(found, prior.pucks), found.payload
    values = [
        payload.body.mass_kg,
        *payload.body.centre_of_mass_m[:2],
        payload.body.inertia_kg_m2[2, 2],
        *fit.drag[own],
    ]
    sigmas = [*np.sqrt(np.diag(payload.covariance))[[0, 1, 2, 9]], *fit.sigma[own]]
    level = Level.DO_NOT_USE if fit.reason else Level.GOOD
    return FlightResult(
        tuple(
            one._replace(value=v, low=v - NORMAL * s, high=v + NORMAL * s, sigma=s)._replace(
                supported=not fit.reason, level=str(level), why=fit.reason
            )
            for one, v, s in zip(told, map(float, values), map(float, sigmas), strict=True)
        )
    )
