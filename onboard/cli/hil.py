"""``heft hil`` flies a scenario against simulated devices."""

import argparse
import json
from pathlib import Path

from onboard.cli.common import (
    FAILED,
    OK,
    Commands,
    add_live,
    complain,
    console,
    next_log,
    progress,
    serve_live,
    show,
)


def add(commands: Commands) -> None:
    """Make the command known."""
    hil = commands.add_parser("hil", help="fly a scenario against simulated devices")
    hil.add_argument("scenario", help="a packaged scenario: rocksat, dymaflex, ...")
    hil.add_argument("--seed", type=int, default=1, help="seed of all random numbers of the scenario (default 1)")
    hil.add_argument("--realtime", action="store_true", help="devices and flight app as processes, on the real clock")
    hil.add_argument("--json", type=Path, metavar="FILE", help="also write the result as JSON")
    hil.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    add_live(hil)
    hil.set_defaults(command=_hil)


def _hil(arguments: argparse.Namespace) -> int:
    try:
        from hil_sim.mission import open_in_process
    except ModuleNotFoundError as error:
        raise ValueError(f"heft hil simulates with MuJoCo ({error}): pip install mujoco") from error
    from onboard import config
    from onboard.flight import hil
    from onboard.flight.runner_processes import FlightError
    from onboard.offline.tables import truth
    from onboard.offline.views import mission_table

    if arguments.live is not None and not arguments.realtime:
        raise ValueError("--live shows a flight on the real clock: add --realtime")
    shown = console()
    name, seed = arguments.scenario, arguments.seed
    vehicle = config.named(name)
    log = arguments.log or next_log(vehicle.file.recording.directory, name)
    with progress() as bar:
        task = bar.add_task(f"{name}, seed {seed}", total=1.0)
        if arguments.realtime:
            serve = ["-m", "hil_sim.serve", name, "--seed", str(seed)]
            try:
                with serve_live(arguments.live, log):
                    flown = hil.fly_realtime(vehicle, serve, log, lambda done: bar.update(task, completed=done))
            except FlightError as error:
                complain(error)
                return FAILED
        else:
            world, urls = open_in_process(name, seed)
            with world:
                flown = hil.fly_simulated(vehicle, world, urls, log, lambda done: bar.update(task, completed=done))
    truth.write(flown.log, flown.truth)
    result = mission_table.result(flown)
    show(mission_table.render(result))
    shown.print(f"log: {log}", soft_wrap=True)
    shown.print(f"next: heft report {log}, heft info {log}, heft replay {log}", soft_wrap=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return OK if result["identified"] and result["accounted"] else FAILED
