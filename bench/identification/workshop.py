"""Twenty workshop tools in the gripper of an arm on a fixed base, weighed by a wrist load cell; the truth is MuJoCo's.

Ten seconds of the gripper alone give the cell's zero (a tare in many poses, not at one), then the tool is held for
twenty. Motion, cell and noise of every run are its own.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import as_built, tools
from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion
from onboard import config
from onboard.dynamics.vehicle import STANDARD, BaseKind, VehicleModel, VehicleSpec
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.identification.rows.grasped import Grasped, grasped
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.base_parameters import base_parameters, named_relative_sigma
from onboard.regressor.rows import RowModel, standing
from onboard.regressor.sensor_rows import wrist_cell_rows
from onboard.regressor.signals import SignalNoise, Signals

Floats = NDArray[np.float64]

GRASP_s, END_s, SETTLE_s = 10.0, 30.0, 0.3
SWING_rad = 0.5
SMOOTHING_s, ROW_s = 0.2, 0.02
PAYLOAD_SIGMA = (5.0, 1.0, 1.0, 1.0, *[0.2] * 6)  # kg, kg m, kg m^2
BIAS_SIGMA = {"force": 5.0, "moment": 0.5}
GRIPPER_SIGMA, GRIPPER_CENTRE_SIGMA_m = 0.01, 5e-4  # as it was weighed
BARS = (1.0, 2.0)  # per cent, mm


class Outcome(NamedTuple):
    """One run's answer."""

    error: Floats  # (3,) mass relative, centre of mass m, inertia relative to its norm
    inside: NDArray[np.bool_]  # (10,) truths inside the 95 % interval
    refused: int


def identifier() -> Identifier:
    """Of the workshop's arm: six rows, gripper and tool and the cell's biases and scales unknown."""
    urdf = config.packaged("rocksat").parents[1] / "workshop" / "workshop.urdf"
    vehicle = VehicleModel(urdf.read_text(encoding="utf-8"), VehicleSpec(BaseKind.FIXED, "bench", "tool"))
    model = RowModel(vehicle, wrist_cell_rows("wrist", "wrist", scale=True))
    base = base_parameters(model, np.random.default_rng(1))
    extras = {f"{name}_tool": sigma for name, sigma in zip(STANDARD, PAYLOAD_SIGMA, strict=True)}
    for row in model.rows:
        extras[f"bias_{row.name}"] = BIAS_SIGMA["force" if "force" in row.name else "moment"]
        extras[f"scale_{row.name}"] = fixed_arm.WristErrors().scale
    links = dict.fromkeys(vehicle.links, GRIPPER_SIGMA)
    prior = named_relative_sigma(model, links, extras)
    return Identifier(model, base, prior, 5.0 * SMOOTHING_s)


def rows(readings: fixed_arm.Readings, vehicle: VehicleModel) -> Signals:
    """Encoders and cell through one kernel."""
    t = readings.time_s
    at = np.arange(t[0] + SMOOTHING_s, t[-1] - SMOOTHING_s, ROW_s)
    at = at[np.abs(at - GRASP_s) > SETTLE_s]
    window = SmoothingWindow(t, at, SMOOTHING_s)
    q, dq, ddq = (window.apply(readings.angle_rad, order) for order in range(3))
    wrist = window.apply(readings.wrench)
    inflation = correlation_inflation(SMOOTHING_s, ROW_s)
    count, still = np.full(5, fixed_arm.COUNT_rad / np.sqrt(12.0)), np.zeros((len(at), 3))
    doubts = [np.outer(joint.noise_gain, count) for joint in (q, dq, ddq)]
    return Signals(
        at,
        q.values,
        dq.values,
        ddq.values,
        standing(vehicle, len(at)),
        wrist.values,
        np.outer(wrist.noise_gain, readings.noise) * inflation,
        noise=SignalNoise(doubts[0], doubts[1], doubts[2], still, still, still, inflation),
    )


def weigh(tool: Body, seed: int) -> tuple[Grasped, Identifier]:
    """One run from MuJoCo to the answer."""
    rng = np.random.default_rng(seed)
    gripper = as_built(fixed_arm.GRIPPER, (GRIPPER_SIGMA, GRIPPER_CENTRE_SIGMA_m, GRIPPER_SIGMA), rng)
    flown = fixed_arm.run(tool, JointMotion.draw(rng, SWING_rad), GRASP_s, END_s, gripper)
    readings = fixed_arm.read(flown, fixed_arm.WristErrors(), rng)
    who = identifier()
    signals = rows(readings, who.model.vehicle)
    who.update(signals, signals.time_s > GRASP_s, np.zeros(len(signals.time_s), np.int64))
    return grasped(who), who


def outcome(tool: Body, seed: int) -> Outcome:
    """One run against the truth."""
    found, who = weigh(tool, seed)
    body = found.body
    inertia = tool.inertia_kg_m2
    truth = np.concatenate([[tool.mass_kg], tool.centre_of_mass_m, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    error = np.array(
        [
            abs(body.mass_kg / tool.mass_kg - 1.0),
            np.linalg.norm(body.centre_of_mass_m - tool.centre_of_mass_m),
            np.linalg.norm(body.inertia_kg_m2 - inertia) / np.linalg.norm(inertia),
        ]
    )
    return Outcome(error, (found.low <= truth) & (truth <= found.high), sum(who.refused.values()))


def run(arguments: argparse.Namespace) -> None:
    """Every tool, as many runs each as there are seeds."""
    directory = arguments.datasets / "workshop_tools"
    names, bodies = [path.stem for path in sorted(directory.glob("*.yaml"))], tools(directory)
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    jobs = [(body, 1000 * index + seed) for index, body in enumerate(bodies) for seed in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        all_runs = list(pool.map(outcome, *zip(*jobs, strict=True), chunksize=4))
    print(f"\n{len(bodies)} workshop tools, fixed base, wrist load cell; {len(seeds)} runs of {END_s:g} s each")
    print(f"{'':20}{'':9}{'mass, %':>16}{'':6}{'centre, mm':>16}{'':6}{'inertia, %':>12}{'covered':>9}")
    print(f"{'':20}{'kg':>9}{'rms':>8}{'worst':>8}{'bar':>6}{'rms':>8}{'worst':>8}{'bar':>6}{'rms':>12}{'92-98':>9}")
    every = []
    for index, (name, body) in enumerate(zip(names, bodies, strict=True)):
        mine = all_runs[index * len(seeds) : (index + 1) * len(seeds)]
        every += mine
        print(_line(name, f"{body.mass_kg:9.4f}", mine))
    print(_line("all", f"{'':9}", every))
    inside = np.array([one.inside for one in every])
    parts = (("mass", slice(0, 1)), ("centre of mass", slice(1, 4)), ("inertia", slice(4, 10)))
    print("covered: " + ", ".join(f"{name} {100 * inside[:, part].mean():.1f} %" for name, part in parts))
    print(f"rows refused in all: {sum(one.refused for one in every)}")


def _line(name: str, mass: str, runs: list[Outcome]) -> str:
    error = np.array([one.error for one in runs]) * [100.0, 1e3, 100.0]
    rms, worst = np.sqrt((error**2).mean(axis=0)), error.max(axis=0)
    covered = 100.0 * np.mean([one.inside for one in runs])
    return (
        f"{name:20}{mass}{rms[0]:8.3f}{worst[0]:8.3f}{BARS[0]:6g}{rms[1]:8.3f}{worst[1]:8.3f}{BARS[1]:6g}"
        f"{rms[2]:12.2f}{covered:8.1f}%"
    )
