"""Twenty workshop tools in the gripper of an arm on a fixed base, weighed by a wrist load cell; the truth is MuJoCo's.

Ten seconds of the gripper alone give the cell's zero (a tare in many poses, not at one), then the tool is held for
twenty. Motion, cell and noise of every run are its own. Every run becomes a log and is weighed as ``heft identify
--vehicle workshop LOG`` weighs it.
"""

import os
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import as_built, tools
from drivers.records import SCALAR, Rows
from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion
from onboard import config
from onboard.dynamics.inertia import elements
from onboard.identification.quantities import BODY
from onboard.offline.campaign.results import FlightResult, of_log
from onboard.offline.estimate_again.identified import Identified
from onboard.offline.estimate_again.identify import identify
from onboard.recording.writer import LogWriter

Floats = NDArray[np.float64]

GRASP_s, END_s = 10.0, 30.0
SWING_rad = 0.5
GRIPPER_SIGMA, GRIPPER_CENTRE_SIGMA_m = 0.01, 5e-4  # as it was weighed
AXES = [f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]


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


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """One run of ``bench/plans/tools.toml``.

    Args:
        seed: of everything drawn; each tool has others.
        settings: ``tool``, by its file in the data set ``workshop_tools``.
    """
    directory = Path(os.environ.get("HEFT_DATASETS", "../shared/datasets")) / "workshop_tools"
    names = [path.stem for path in sorted(directory.glob("*.yaml"))]
    index = names.index(settings["tool"])
    tool = tools(directory)[index]
    truth = [tool.mass_kg, *tool.centre_of_mass_m, *elements(tool.inertia_kg_m2)]
    known = {f"{name}_tool": float(value) for name, value in zip(BODY, truth, strict=True)}
    found = of_log(weigh(tool, 1000 * index + seed), {"quantities": known})
    return found._replace(answers=tuple(one for one in found.answers if one.quantity in known))
