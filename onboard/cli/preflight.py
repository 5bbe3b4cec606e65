"""``heft preflight`` checks every device of a vehicle against the vehicle file."""

import argparse
import time

from onboard.cli.common import (
    NOT_READY,
    OK,
    Commands,
    bus_and_url,
    load_vehicle,
    show,
)


def add(commands: Commands) -> None:
    """Make the command known."""
    preflight = commands.add_parser("preflight", help="check every device of a vehicle against its file")
    preflight.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    preflight.add_argument("--seconds", type=float, metavar="S", help="run the devices for this many seconds")
    preflight.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    preflight.set_defaults(command=_preflight)


def _preflight(arguments: argparse.Namespace) -> int:
    from onboard.flight import preflight, workers
    from onboard.flight.estimator import Estimator

    vehicle = load_vehicle(arguments.vehicle).with_urls(dict(bus_and_url(text) for text in arguments.url))
    Estimator(vehicle)  # what heft fly would refuse is refused here
    found = preflight.preflight(vehicle, time.monotonic_ns, time.sleep, workers.run_for, arguments.seconds)
    show(preflight.render(found))
    return OK if found.ready else NOT_READY
