"""``heft fly`` flies a vehicle on real buses and the real clock."""

import argparse
from pathlib import Path

from onboard.cli.common import (
    FAILED,
    OK,
    Commands,
    add_live,
    bus_and_url,
    complain,
    load_vehicle,
    next_log,
    serve_live,
)


def add(commands: Commands) -> None:
    """Make the command known."""
    fly = commands.add_parser("fly", help="fly a vehicle: acquire, record, estimate")
    fly.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    fly.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    fly.add_argument("--new", action="store_true", help="a new flight, also where one that lost its power could go on")
    fly.add_argument("--duration", type=float, metavar="S", help="stop after this many seconds")
    fly.add_argument(
        "--continue",
        dest="earlier",
        type=Path,
        metavar="LOG",
        help="start from the last estimate of LOG: the same payload must still be held",
    )
    fly.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    spoken = fly.add_mutually_exclusive_group()
    spoken.add_argument("--quiet", action="store_true", help="say warnings and errors only")
    spoken.add_argument("--json-lines", action="store_true", help="say everything as JSON, an object a line")
    add_live(fly)
    fly.set_defaults(command=_fly)


def _fly(arguments: argparse.Namespace) -> int:
    from onboard.cli import messages
    from onboard.flight import runner
    from onboard.flight.runner_processes import FlightError

    urls = dict(bus_and_url(text) for text in arguments.url)
    vehicle, plan = load_vehicle(arguments.vehicle), None
    log = arguments.log
    if log is None:
        new_log = next_log(vehicle.file.recording.directory, vehicle.file.vehicle.name)
        plan = runner.plan_of(vehicle, new_log, fresh=arguments.new)
        vehicle, log = plan.vehicle, plan.log
    if arguments.earlier:
        from onboard.offline.estimate_again import warm_start
        from onboard.recording.reader import LogReader

        vehicle = warm_start.go_on(vehicle, LogReader(arguments.earlier))
    vehicle = vehicle.with_urls(urls)
    try:
        with (
            messages.spoken(quiet=arguments.quiet, json_lines=arguments.json_lines) as status_s,
            serve_live(arguments.live, log),
        ):
            flight = runner.fly(vehicle, log, duration_s=arguments.duration, status_s=status_s, plan=plan)
    except FlightError as error:
        complain(error)
        return FAILED
    print(flight.log)
    for name in flight.died:
        complain(f"the {name} worker died; see its message above, and the event in the log")
    return FAILED if flight.died or (flight.missing and not flight.was_over) else OK
