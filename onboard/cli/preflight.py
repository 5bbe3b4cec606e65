"""``heft preflight`` checks every device of a vehicle against the vehicle file."""

import argparse
import time
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config


def add(commands: common.Commands) -> None:
    """Make the command known."""
    preflight = commands.add_parser("preflight", help="check every device of a vehicle against its file")
    preflight.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    preflight.add_argument("--seconds", type=float, metavar="S", help="run the devices for this many seconds")
    preflight.add_argument("--minutes", type=float, metavar="M", default=60.0, help="length of the flight (default 60)")
    preflight.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    common.add_json(preflight)
    preflight.set_defaults(command=_preflight)


def _preflight(arguments: argparse.Namespace) -> int:
    from onboard.flight.check import preflight
    from onboard.flight.estimate.estimator import Estimator
    from onboard.flight.supervise import workers

    minutes: float = arguments.minutes
    if not 0.0 < minutes < 1e6:
        raise ValueError(f"--minutes {minutes:g}: give the length of the flight, e.g. 30")
    vehicle = common.with_urls(common.load_vehicle(arguments.vehicle), arguments.url)
    flight_s = 60.0 * minutes
    with common.busy("the estimator is built") as told:
        estimator = Estimator(vehicle)  # what heft fly would refuse is refused here
        looks = time.monotonic_ns, time.sleep, workers.run_for, arguments.seconds, flight_s, estimator, time.time()
        found = preflight.preflight(vehicle, *looks, told)
    common.show(preflight.render(found))
    expected = _foresee(vehicle)
    common.write_json(arguments.json, {"ready": found.ready, **found._asdict(), "expected": expected})
    return common.OK if found.ready else common.NOT_READY


def _foresee(vehicle: "config.Vehicle") -> list[dict[str, Any]]:
    """Say what the default motion of a rehearsal determines: preflight knows no other; the same as JSON values."""
    try:
        from hil_sim.devices.vehicle_file import scenario_of
        from hil_sim.plants.planned import default_plan
    except ModuleNotFoundError as error:
        common.console().print(f"what the vehicle can determine is said where the simulator is installed ({error})")
        return []
    motion = "the default motion of a rehearsal"
    try:
        with common.busy(f"what {motion} determines"):
            plan = default_plan(scenario_of(vehicle.path), 1.0 / vehicle.file.estimation.row_rate_hz)
    except ValueError as error:
        common.console().print(f"what {motion} determines is not known: {error}")
        return []
    return common.show_foreseen(vehicle, plan, motion)
