"""``heft fly``, ``heft preflight`` and ``heft hil``."""

import argparse
import json
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from onboard.cli.common import FAILED, NOT_READY, OK, complain, console, load_vehicle, next_log, progress

Commands = Any  # argparse keeps the type of what add_subparsers returns to itself


def add(commands: Commands) -> None:
    """Make the commands known."""
    fly = commands.add_parser("fly", help="fly a vehicle: acquire, record, estimate")
    fly.add_argument("vehicle", type=Path, help="vehicle.toml")
    fly.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    fly.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds")
    fly.add_argument(
        "--continue",
        dest="earlier",
        type=Path,
        metavar="LOG",
        help="go on from what the flight of LOG said last: the same payload is held still",
    )
    fly.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    _add_live(fly)
    fly.set_defaults(command=_fly)

    preflight = commands.add_parser("preflight", help="is every device of a vehicle there and as its file says?")
    preflight.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    preflight.add_argument("--seconds", type=float, metavar="S", help="run the devices for so long")
    preflight.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    preflight.set_defaults(command=_preflight)

    hil = commands.add_parser("hil", help="fly a scenario against simulated devices")
    hil.add_argument("scenario", help="a packaged scenario: rocksat, dymaflex, ...")
    hil.add_argument("--seed", type=int, default=1, help="of everything random in the scenario (default 1)")
    hil.add_argument("--realtime", action="store_true", help="devices and flight app as processes, on the real clock")
    hil.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON too")
    hil.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    _add_live(hil)
    hil.set_defaults(command=_hil)


def _add_live(command: Any) -> None:
    command.add_argument(
        "--live",
        nargs="?",
        const="127.0.0.1:8765",
        metavar="HOST:PORT",
        help="serve the flight to Foxglove or Lichtblick by WebSocket (default ws://127.0.0.1:8765)",
    )


def _live(address: str | None, log: Path) -> AbstractContextManager[int | None]:
    """The server for who asked for one."""
    if address is None:
        return nullcontext()
    try:
        from onboard.live.process import serving
    except ImportError as error:
        raise ValueError(f"--live needs the Foxglove SDK ({error}): pip install 'heft[live]'") from error
    return serving(log, address)


def _fly(arguments: argparse.Namespace) -> int:
    from onboard import config
    from onboard.flight import runner
    from onboard.offline import carrying
    from onboard.recording.reader import LogReader

    urls = dict(_bus_and_url(text) for text in arguments.url)
    vehicle = config.load(arguments.vehicle)
    if arguments.earlier:
        vehicle = carrying.go_on(vehicle, LogReader(arguments.earlier))
    vehicle = vehicle.with_urls(urls)
    log = arguments.log or next_log(vehicle.file.recording.directory, vehicle.file.vehicle.name)
    try:
        with _live(arguments.live, log):
            flight = runner.fly(vehicle, log, duration_s=arguments.duration)
    except runner.FlightError as error:
        complain(error)
        return FAILED
    print(flight.log)
    for name in flight.died:
        complain(f"the {name} worker died; its message stands above, and an event in the log")
    return FAILED if flight.died else OK


def _preflight(arguments: argparse.Namespace) -> int:
    from onboard.flight import preflight, workers

    vehicle = load_vehicle(arguments.vehicle).with_urls(dict(_bus_and_url(text) for text in arguments.url))
    found = preflight.preflight(vehicle, time.monotonic_ns, time.sleep, workers.run_for, arguments.seconds)
    console().print(preflight.render(found))
    return OK if found.ready else NOT_READY


def _bus_and_url(text: str) -> tuple[str, str]:
    bus, separator, url = text.partition("=")
    if not separator:
        raise ValueError(f"--url {text}: write BUS=URL, e.g. can_0=can+socketcan://can0?bitrate=500000")
    return bus, url


def _hil(arguments: argparse.Namespace) -> int:
    from hil_sim.mission import open_in_process
    from onboard import config
    from onboard.flight import hil, runner
    from onboard.offline import table, truth

    if arguments.live is not None and not arguments.realtime:
        raise ValueError("--live shows a flight on the real clock: add --realtime")
    shown = console()
    name, seed = arguments.scenario, arguments.seed
    vehicle = config.load(config.packaged(name))
    log = arguments.log or next_log(vehicle.file.recording.directory, name)
    with progress() as bar:
        task = bar.add_task(f"{name}, seed {seed}", total=1.0)
        if arguments.realtime:
            serve = ["-m", "hil_sim.serve", name, "--seed", str(seed)]
            try:
                with _live(arguments.live, log):
                    flown = hil.fly_realtime(vehicle, serve, log, lambda done: bar.update(task, completed=done))
            except runner.FlightError as error:
                complain(error)
                return FAILED
        else:
            world, urls = open_in_process(name, seed)
            with world:
                flown = hil.fly_simulated(vehicle, world, urls, log, lambda done: bar.update(task, completed=done))
    truth.write(flown.log, flown.truth)
    result = table.result(flown)
    shown.print(table.render(result))
    shown.print(f"log: {log}", soft_wrap=True)
    shown.print(f"next: heft report {log}, heft info {log}, heft replay {log}", soft_wrap=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return OK if result["identified"] and result["accounted"] else FAILED
