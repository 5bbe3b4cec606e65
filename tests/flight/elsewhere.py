"""A package of others beside heft, as pip would install it, and commands that see it."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def installed(directory: Path, name: str, points: str) -> Path:
    """Make ``name`` known with its entry points; returns where its code goes."""
    information = directory / "site" / f"{name}-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(points)
    return directory / "site"


def heft(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command of heft in ``directory``, in a process that sees what is installed there."""
    environment = {**os.environ, "PYTHONPATH": f"{directory / 'site'}:{ROOT}"}
    command = [sys.executable, "-m", "onboard.cli", *arguments]
    return subprocess.run(command, env=environment, cwd=directory, capture_output=True, text=True, check=False)
