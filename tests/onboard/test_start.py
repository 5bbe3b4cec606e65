"""What a command imports before it begins: no part of SciPy that costs more than what is used of it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

_HEAVY = [
    *(f"scipy.{part}" for part in ("signal", "stats", "optimize", "interpolate", "spatial", "ndimage", "integrate")),
    *("glfw", "xml.sax", "http.client", "matplotlib", "filterpy", "canopen", "asyncssh", "dask", "pandas", "pyarrow"),
]
_SIMULATOR = ["mujoco", "hil_sim"]
_COUNT = """
import json, sys
from onboard.cli import main
code = main(sys.argv[1:])
print(json.dumps([code, sorted(sys.modules)]))
"""


@pytest.mark.parametrize(
    ("command", "code", "without", "most"),
    [
        ("hil dymaflex --faults", 0, _HEAVY, 1220),
        ("hil rocksat --faults", 0, _HEAVY, 1220),
        ("replay missing.mcap", 2, [*_HEAVY, *_SIMULATOR], 980),
        ("identify missing.mcap --vehicle dymaflex", 2, [*_HEAVY, *_SIMULATOR], 1020),
        ("fly missing.toml", 2, [*_HEAVY, *_SIMULATOR, "pinocchio", "scipy"], 620),
    ],
)
def test_modules_of_a_start(command: str, code: int, without: list[str], most: int, tmp_path: Path) -> None:
    """The command gets as far as its input, and the modules loaded by then are few: 2 to 4 % above what they are."""
    done = subprocess.run(
        [sys.executable, "-c", _COUNT, *command.split()], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    ended, modules = json.loads(done.stdout.splitlines()[-1])
    assert ended == code, done.stderr
    assert "onboard.config" in modules
    assert [name for name in without if name in modules] == []
    assert len(modules) <= most
