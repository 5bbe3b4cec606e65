"""Twenty workshop tools in the gripper of an arm on a bench, weighed by a wrist load cell; the truth is MuJoCo's.

The mission is the packaged one, ``heft hil workshop``: ten seconds of the gripper alone give the cell's zero (a tare in
many poses, not at one), then the tool is held for twenty. Every run's log is weighed as ``heft identify LOG`` does it.
"""

import os
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench.identification.free_flyer import tools
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from hil_sim.plants.body import Solid
from onboard import config
from onboard.dynamics.model.inertia import elements
from onboard.flight import hil
from onboard.ground.campaign.results import FlightResult, of_log
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds.identified import Identified
from onboard.identification.quantities import BODY


def payload(tool: Solid) -> dict[str, Any]:
    """The scenario's table of a tool: the solid box that has its mass, centre and inertia."""
    moments, axes = np.linalg.eigh(tool.inertia_kg_m2)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    size_m = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / tool.mass_kg, 1e-12))
    pitch = np.arcsin(np.clip(-axes[2, 0], -1.0, 1.0))
    roll, yaw = np.arctan2(axes[2, 1], axes[2, 2]), np.arctan2(axes[1, 0], axes[0, 0])
    return {
        "mass_kg": [tool.mass_kg] * 2,
        "size_mm": (1e3 * size_m).tolist(),
        "centre_of_mass_mm": (1e3 * np.asarray(tool.centre_of_mass_m)).tolist(),
        "roll_pitch_yaw_deg": np.rad2deg([roll, pitch, yaw]).tolist(),
    }


def weigh(tool: Solid, seed: int) -> Identified:
    """One run from MuJoCo to the answer."""
    scenario = scenario_of("workshop", {"payload": payload(tool)})
    vehicle = config.load(config.packaged("workshop"))
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, seed)
        with world:
            log = Path(directory) / "run.mcap"
            hil.fly_simulated(vehicle, world, urls, log)
        return identify(vehicle, [log]).logs[0]


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
