"""What a command imports before it begins: no part of SciPy that costs more than what is used of it."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import with_library
from tests.flight.missions import CATCH

_HEAVY = [
    *(f"scipy.{part}" for part in ("signal", "stats", "optimize", "interpolate", "spatial", "ndimage", "integrate")),
    *("glfw", "xml.sax", "http.client", "matplotlib", "filterpy", "canopen", "asyncssh", "dask", "pandas", "pyarrow"),
]
_SIMULATOR = ["mujoco", "hil_sim"]
_COUNT = """
import json, sys
from onboard.cli import main
code = main(sys.argv[1:])
import pydantic
def below(cls):
    return {cls}.union(*map(below, cls.__subclasses__()))
tables = [cls.__name__ for cls in below(pydantic.BaseModel) if cls.__module__.split(".")[0] in ("onboard", "hil_sim")]
made = [cls.__name__ for cls in below(pydantic.BaseModel) if cls.__dict__.get("__pydantic_complete__")]
print(json.dumps([code, sorted(sys.modules), [name for name in made if name in tables]]))
"""
_FORESIGHT = """
import json, sys
from onboard import config
from onboard.cli.common import show_foreseen
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
vehicle = config.with_mission(config.named(sys.argv[1]), None, None)
world, _ = open_in_process(scenario_of(sys.argv[1], json.loads(sys.argv[2])), 3, [])
said = show_foreseen(vehicle, world.planned(1.0 / vehicle.file.estimation.row_rate_hz), "this motion")
print(json.dumps([len(said), sorted(sys.modules)]))
"""


@pytest.mark.parametrize(
    ("command", "code", "without", "most", "validators"),
    [
        pytest.param("hil dymaflex --faults", 0, _HEAVY, 1213, 10, marks=pytest.mark.campaign),
        pytest.param("hil rocksat --faults", 0, _HEAVY, 1213, 10, marks=pytest.mark.campaign),
        ("hil rocksat_serial --faults", 0, [*_HEAVY, "can"], 1123, 10),
        pytest.param(  # as identify, which loads more
            "replay missing.mcap", 2, [*_HEAVY, *_SIMULATOR], 883, 0, marks=pytest.mark.campaign
        ),
        ("identify missing.mcap --vehicle dymaflex", 2, [*_HEAVY, *_SIMULATOR], 1000, 1),
        ("fly missing.toml", 2, [*_HEAVY, *_SIMULATOR, "pinocchio", "scipy"], 513, 1),
    ],
)
def test_modules_of_a_start(
    command: str, code: int, without: list[str], most: int, validators: int, tmp_path: Path
) -> None:
    """The command gets as far as its input, and what is made by then is little: modules 2 to 4 % above what they are.

    Validators are made of tables that are read, not of each that could be.
    """
    done = subprocess.run(
        [sys.executable, "-c", _COUNT, *command.split()], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    ended, modules, made = json.loads(done.stdout.splitlines()[-1])
    assert ended == code, done.stderr
    assert "onboard.config" in modules
    assert [name for name in (*without, "numpy.f2py.crackfortran") if name in modules] == []
    assert len(modules) <= most
    assert len(made) == validators, made


@pytest.mark.parametrize(
    ("mission", "changes"), [pytest.param("rocksat", {}, marks=pytest.mark.campaign), ("dymaflex", CATCH)]
)
def test_modules_of_foresight(
    mission: str, changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table before a flight loads no part of SciPy that the flight does without."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(with_library(tmp_path)))
    done = subprocess.run(
        [sys.executable, "-c", _FORESIGHT, mission, json.dumps(changes)],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    said, modules = json.loads(done.stdout.splitlines()[-1])
    assert said >= 10
    assert "onboard.ground.before.foresee.foresee" in modules
    assert [name for name in _HEAVY if name in modules] == []
    assert [name for name in modules if name.startswith("onboard.ground.identify")] == []
