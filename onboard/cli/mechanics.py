"""``heft mechanics``: reaction of a floating base to its arm: Jacobians, workspaces, reorientation."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli.common import FAILED, OK, Commands, add_json, busy, complain, load_vehicle, show, write_json

if TYPE_CHECKING:
    from onboard import config
    from onboard.estimation.arrays import FloatArray
    from onboard.ground.before.mechanics.analysis import Mechanics


def add(commands: Commands) -> None:
    """Make the command known."""
    mechanics = commands.add_parser("mechanics", help="mechanics of a free-floating arm and its base")
    mechanics.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    mechanics.add_argument("--tip", metavar="FRAME", help="frame that is moved (default: the payload link)")
    mechanics.add_argument(
        "--at", action="append", default=[], metavar="JOINT=DEG", help="position of a joint (default 0); m if it slides"
    )
    mechanics.add_argument("--line", metavar="X,Y,Z", help="move the tip by so many metres in a straight line")
    mechanics.add_argument("--seconds", type=float, default=5.0, metavar="S", help="for --line (default 5)")
    mechanics.add_argument("--turn", metavar="X,Y,Z", help="turn the base by this rotation vector, deg, by arm cycles")
    mechanics.add_argument("--map", nargs=2, metavar="JOINT", help="singularities and workspaces over two joints")
    add_json(mechanics)
    mechanics.add_argument("--figures", type=Path, metavar="DIR", help="draw --line and --map into DIR")
    mechanics.set_defaults(command=_mechanics)


def _mechanics(arguments: argparse.Namespace) -> int:
    import numpy as np

    from onboard.dynamics.model.errors import ModelError
    from onboard.ground.before.mechanics import view

    step_m = None if arguments.line is None else np.array(_triple("--line", arguments.line))
    turn_rad = None if arguments.turn is None else np.deg2rad(_triple("--turn", arguments.turn))
    if not (math.isfinite(arguments.seconds) and arguments.seconds > 0.0):
        raise ValueError(f"--seconds {arguments.seconds:g}: give a positive number")
    vehicle = load_vehicle(arguments.vehicle)
    try:
        with busy(f"mechanics of {vehicle.file.vehicle.name}"):
            found = _analysed(vehicle, arguments, step_m, turn_rad)
    except ModelError as error:
        raise ValueError(str(error)) from error
    show(view.render(found))
    write_json(arguments.json, found.as_json())
    if arguments.figures:
        for path in view.draw(found, arguments.figures):
            print(path)
    if found.line is not None and not found.line.is_followed:
        complain(
            f"the tip cannot follow this line: it is up to {1e3 * found.line.error_m:.2g} mm off; "
            "ask for a shorter line, from other joint positions (--at), in more time (--seconds)"
        )
        return FAILED
    return OK


def _analysed(
    vehicle: "config.Vehicle", arguments: argparse.Namespace, step_m: "FloatArray | None", turn_rad: "FloatArray | None"
) -> "Mechanics":
    from onboard.dynamics.mechanics import nonholonomic, workspace
    from onboard.ground.before.mechanics import analysis

    arm = analysis.arm_of(vehicle, arguments.tip)
    joints = {joint.name: joint for joint in arm.vehicle.joints}
    given = dict(_position(text) for text in arguments.at)
    q = analysis.positions(
        arm.vehicle, {n: v if n in joints and not joints[n].revolute else math.radians(v) for n, v in given.items()}
    )
    found = analysis.analyse(vehicle.file.vehicle.name, arm, arm.model.frames[arm.tip].name, q)
    if step_m is not None:
        found.line = analysis.line(arm, q, step_m, arguments.seconds)
    if turn_rad is not None:
        found.turn = nonholonomic.reorient(arm, q, turn_rad)
    if arguments.map:
        pair = [arm.vehicle.joints.index(arm.vehicle.joint(name)) for name in arguments.map]
        found.map = workspace.singularity_map(arm, q, (pair[0], pair[1]))
        found.map_joints = arguments.map[0], arguments.map[1]
    return found


def _triple(option: str, text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{option} {text}: write three numbers, e.g. {option}=0.1,0,-0.05")
    return values


def _position(text: str) -> tuple[str, float]:
    joint, separator, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not separator or not math.isfinite(number):
        raise ValueError(f"--at {text}: write JOINT=DEGREES, e.g. --at joint_2=35")
    return joint, number
