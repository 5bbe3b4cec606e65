"""Twenty workshop tools in the gripper of an arm on a fixed base, weighed by a wrist load cell; the truth is MuJoCo's.

Ten seconds of the gripper alone give the cell's zero (a tare in many poses, not at one), then the tool is held for
twenty. Motion, cell and noise of every run are its own. Every run becomes a log and is weighed as ``heft identify
--vehicle workshop LOG`` weighs it.
"""

import argparse
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import as_built, tools
from drivers.records import SCALAR, Rows
from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion
from onboard import config
from onboard.dynamics.inertia import elements, symmetric
from onboard.identification.quantities import BODY
from onboard.identification.verdict import Level
from onboard.offline.estimate_again.identified import Identified
from onboard.offline.estimate_again.identify import identify
from onboard.recording.writer import LogWriter

Floats = NDArray[np.float64]

GRASP_s, END_s = 10.0, 30.0
SWING_rad = 0.5
GRIPPER_SIGMA, GRIPPER_CENTRE_SIGMA_m = 0.01, 5e-4  # as it was weighed
BARS = (1.0, 2.0)  # per cent, mm
AXES = [f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]


class Outcome(NamedTuple):
    """One run's answer."""

    error: Floats  # (3,) mass relative, centre of mass m, inertia relative to its norm
    inside: NDArray[np.bool_]  # (10,) truths inside the 95 % interval
    refused: int
    good: bool


def _scalars(time_s: Floats, values: Floats, scale: float, unit: bytes) -> Rows:
    made = np.zeros(len(time_s), SCALAR)
    made["sequence"], made["host_ns"] = np.arange(len(time_s)), np.rint(1e9 * (10.0 + time_s))
    made["value_raw"], made["scale"], made["unit"] = np.rint(values / scale), scale, unit
    return made


def write(path: Path, readings: fixed_arm.Readings, grasp_s: float) -> Path:
    """A log of encoders, cell and phase, as the vehicle ``workshop`` names them."""
    told_s = np.arange(0.0, readings.time_s[-1], 0.1)
    channels = {f"joint_{k + 1}": _scalars(readings.time_s, readings.angle_rad[:, k], 1e-7, b"rad") for k in range(5)}
    for k, name in enumerate(AXES):
        channels[name] = _scalars(readings.time_s, readings.wrench[:, k], 1e-6, b"N" if k < 3 else b"N m")
    channels["phase"] = _scalars(told_s, np.where(told_s < grasp_s, 1.0, 2.0), 1.0, b"1")
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        for name, batch in channels.items():
            writer.register(name, SCALAR)
            writer.write(name, batch)
    return path


def weigh(tool: Body, seed: int) -> Identified:
    """One run from MuJoCo to the answer."""
    rng = np.random.default_rng(seed)
    gripper = as_built(fixed_arm.GRIPPER, (GRIPPER_SIGMA, GRIPPER_CENTRE_SIGMA_m, GRIPPER_SIGMA), rng)
    flown = fixed_arm.run(tool, JointMotion.draw(rng, SWING_rad), GRASP_s, END_s, gripper)
    readings = fixed_arm.read(flown, fixed_arm.WristErrors(), rng)
    with tempfile.TemporaryDirectory() as directory:
        log = write(Path(directory) / "run.mcap", readings, GRASP_s)
        return identify(config.load(config.packaged("workshop")), [log]).logs[0]


def outcome(tool: Body, seed: int) -> Outcome:
    """One run against the truth."""
    log = weigh(tool, seed)
    answers = {answer.name: answer for answer in log.answers}
    found = [answers[f"{name}_tool"] for name in BODY]
    low, high, value = (np.array([getattr(one, field) for one in found]) for field in ("low", "high", "value"))
    truth = np.array([tool.mass_kg, *tool.centre_of_mass_m, *elements(tool.inertia_kg_m2)])
    off = value - truth
    of_inertia = np.linalg.norm(symmetric(off[4:])) / np.linalg.norm(tool.inertia_kg_m2)
    error = np.array([abs(off[0]) / tool.mass_kg, np.linalg.norm(off[1:4]), of_inertia])
    inside = (low <= truth) & (truth <= high)
    return Outcome(error, inside, log.refused.get("residual", 0), log.verdict.level is Level.GOOD)


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
    print(f"rows refused in all: {sum(one.refused for one in every)}; verdict good: {sum(one.good for one in every)}")


def _line(name: str, mass: str, runs: list[Outcome]) -> str:
    error = np.array([one.error for one in runs]) * [100.0, 1e3, 100.0]
    rms, worst = np.sqrt((error**2).mean(axis=0)), error.max(axis=0)
    covered = 100.0 * np.mean([one.inside for one in runs])
    return (
        f"{name:20}{mass}{rms[0]:8.3f}{worst[0]:8.3f}{BARS[0]:6g}{rms[1]:8.3f}{worst[1]:8.3f}{BARS[1]:6g}"
        f"{rms[2]:12.2f}{covered:8.1f}%"
    )
