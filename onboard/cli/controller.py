"""``heft hil VEHICLE --controller``: its options, and what they run."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli.common import FAILED, OK, console, next_log, progress, show, write_json

if TYPE_CHECKING:
    from onboard import config
    from onboard.ground.before.control.run import TrialSeries

NAMES = ("learning_pd", "learning_pi", "learning_forgetting", "computed_torque")
_FEWEST, _MOST = 1, 1000


def add(hil: argparse.ArgumentParser) -> None:
    """Make the options known."""
    group = hil.add_argument_group("controllers", "trials of a controller on simulated drives: docs/learning.md")
    group.add_argument("--controller", choices=NAMES, help="repeat a motion with it, after the payload was captured")
    group.add_argument("--trials", type=int, default=10, metavar="N", help="of the controller (default 10)")
    group.add_argument(
        "--identified", type=Path, metavar="FILE", help="payload to adopt: the log of a flight, or a URDF of identify"
    )
    group.add_argument(
        "--model-error", type=float, default=0.0, metavar="PERCENT", help="make the controller's model so wrong"
    )
    group.add_argument("--noise", type=float, default=0.0, metavar="MRAD", help="white noise of the encoders, 1 sigma")
    group.add_argument("--gain", type=float, default=1.0, metavar="FACTOR", help="of all learning gains (default 1)")
    group.add_argument("--figure", type=Path, metavar="FILE", help="also draw the convergence, as SVG or PNG")


def fly(arguments: argparse.Namespace, vehicle: "config.Vehicle", scenario: Any, faults: Sequence[Any]) -> int:
    """Run the trials that were asked for; the exit status."""
    from onboard.ground.before.control import view

    _check(arguments)
    log: Path | None = arguments.log
    if arguments.controller == "computed_torque" and arguments.identified is None:
        log = None  # it is the flight's
        code = _identify_in_flight(arguments, vehicle)
        if code != OK:
            return code
    log = log or next_log(vehicle.file.recording.directory, f"{_name(arguments, vehicle)}-trials")
    made = _run(arguments, vehicle, scenario, faults, log)
    show(view.render(made))
    console().print(f"log: {log}", soft_wrap=True)
    write_json(arguments.json, made.as_json())
    if arguments.figure:
        view.draw(made, arguments.figure)
        print(arguments.figure)
    return FAILED if made.stopped else OK


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be.

    Raises:
        ValueError: an option that makes no sense.
    """
    if not _FEWEST <= arguments.trials <= _MOST:
        raise ValueError(f"--trials {arguments.trials}: give {_FEWEST} to {_MOST}")
    if not -90.0 <= arguments.model_error <= 900.0:
        raise ValueError(f"--model-error {arguments.model_error:g}: give a percentage from -90 to 900")
    if not 0.0 <= arguments.noise <= 100.0:
        raise ValueError(f"--noise {arguments.noise:g}: give mrad from 0 to 100")
    if not (math.isfinite(arguments.gain) and arguments.gain > 0.0):
        raise ValueError(f"--gain {arguments.gain:g}: give a positive number")
    if arguments.figure and arguments.figure.suffix not in (".svg", ".png"):
        raise ValueError(f"--figure {arguments.figure}: name a .svg or a .png file")
    if arguments.until is not None or arguments.segments is not None or arguments.hand_over is not None:
        raise ValueError("--controller moves the arm itself: leave --until, --segments and --hand-over out")
    if arguments.realtime:
        raise ValueError("--controller runs in virtual time: leave --realtime out")
    if arguments.controller == "computed_torque" and arguments.identified is None and arguments.fault:
        raise ValueError(
            "a --fault is of the mission or of the drives: fly the mission first, then add --identified LOG"
        )


def _name(arguments: argparse.Namespace, vehicle: "config.Vehicle") -> str:
    return str(arguments.scenario) if not arguments.scenario.endswith(".toml") else vehicle.file.vehicle.name


def _identify_in_flight(arguments: argparse.Namespace, vehicle: "config.Vehicle") -> int:
    """Fly the mission of the same seed, whose answers are adopted; its exit status."""
    from onboard.cli import main

    arguments.identified = arguments.log or next_log(vehicle.file.recording.directory, _name(arguments, vehicle))
    over = ["--scenario", str(arguments.over)] if arguments.over else []
    mission = [arguments.scenario, "--seed", str(arguments.seed), "--log", str(arguments.identified), *over]
    return main(["hil", *mission])


def _run(
    arguments: argparse.Namespace, vehicle: "config.Vehicle", scenario: Any, faults: Sequence[Any], log: Path
) -> "TrialSeries":
    from hil_sim.arm_rig import Wired
    from hil_sim.driven_world import DrivenWorld
    from onboard.dynamics.model.errors import ModelError
    from onboard.flight.estimate.problem.model import build_model
    from onboard.flight.trials import PERIOD_MS
    from onboard.ground.before.control import run
    from onboard.ground.before.control.adopted import adopted_urdf
    from onboard.ground.before.control.trials_log import TrialsLog

    adopted = None if arguments.identified is None else adopted_urdf(vehicle, arguments.identified, arguments.seed)
    asked = run.TrialRequest(
        arguments.controller,
        arguments.trials,
        adopted,
        1e-2 * arguments.model_error,
        1e-3 * arguments.noise,
        arguments.gain,
    )
    try:
        joints = tuple(joint.name for joint in build_model(vehicle).joints)
        wired = [Wired(*wire) for wire in run.wires(vehicle, joints)]
        period_ns = round(1e6 * PERIOD_MS)
        with (
            DrivenWorld(
                scenario, arguments.seed, wired, faults, period_ns=period_ns, noise_rad=asked.noise_rad
            ) as world,
            TrialsLog(vehicle, log, lambda: world.now_ns) as recorded,
            progress() as bar,
        ):
            task = bar.add_task(f"{asked.controller}, seed {arguments.seed}", total=asked.trials + 3)

            def take(flown: run.Trial) -> None:
                recorded.trial(flown)
                bar.advance(task)

            return run.run(vehicle, world, asked, take, recorded.record)
    except (ModelError, RuntimeError) as error:
        raise ValueError(str(error)) from error
