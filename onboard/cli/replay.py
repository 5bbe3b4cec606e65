"""``heft replay`` recomputes the estimates from a log and compares them with those of the flight."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from onboard.cli.common import DAMAGED, FAILED, OK, Commands, add_json, progress, show, warn, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    replay = commands.add_parser("replay", help="recompute the estimates from a log and compare bit for bit")
    replay.add_argument("log", type=Path)
    replay.add_argument(
        "--with",
        dest="settings",
        type=Path,
        metavar="TOML",
        help="use these settings over those of the log, and show the differences",
    )
    add_json(replay)
    replay.set_defaults(command=_replay)


def _replay(arguments: argparse.Namespace) -> int:
    if arguments.settings is not None:
        return _reestimate(arguments)
    from onboard.ground.identify.replay.kernels import kernels_needed
    from onboard.ground.identify.replay.replay import replay
    from onboard.recording.reader import LogReader

    if (needed := kernels_needed(LogReader(arguments.log))) is not None:
        return _replay_with(needed, arguments)
    with progress() as bar:
        result = replay(arguments.log, bar)
    print(result.summary)
    write_json(arguments.json, result)
    warn(result.damage)
    if not result.agrees:
        return FAILED
    return DAMAGED if result.damage else OK


def _replay_with(kernels: str, arguments: argparse.Namespace) -> int:
    """Replay in a process that loads these kernels of OpenBLAS, which this one cannot any more."""
    command = [sys.executable, "-m", "onboard.cli", "replay", str(arguments.log)]
    if arguments.json is not None:
        command += ["--json", str(arguments.json) if isinstance(arguments.json, Path) else "-"]
    return subprocess.run(command, env=os.environ | {"OPENBLAS_CORETYPE": kernels}, check=False).returncode


def _reestimate(arguments: argparse.Namespace) -> int:
    from onboard.ground.identify.replay.replay import reestimate, render

    with progress() as bar:
        found = reestimate(arguments.log, arguments.settings, bar)
    show(render(found))
    write_json(arguments.json, found.as_json())
    warn(found.damage)
    if not any(row["supported"] for row in found.now.answers.values()):
        return FAILED
    return DAMAGED if found.damage else OK
