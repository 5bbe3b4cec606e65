"""``heft checkout VEHICLE``: the dissertation's checkout (appendix A.1), and what a loss leaves (``--without``)."""

import argparse
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config
    from onboard.flight.check.checkout_checks import CheckResult

_MOVE_S, _DRY_RUN_S = 20.0, 10.0


def add(commands: common.Commands) -> None:
    """Make the command known."""
    checkout = commands.add_parser("checkout", help="walk through the checkout list, or compute what a loss leaves")
    checkout.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    checkout.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="NAME",
        help="no walk: say what stays identifiable without a joint, a device, cell or pulse; repeatable",
    )
    checkout.add_argument(
        "--scenario", type=Path, metavar="TOML", help="for --without: another motion (docs/rehearsal.md)"
    )
    checkout.add_argument("--seconds", type=float, metavar="S", help="run the devices for this many seconds")
    checkout.add_argument("--minutes", type=float, metavar="M", default=60.0, help="length of the flight (default 60)")
    checkout.add_argument("--move", type=float, metavar="S", default=_MOVE_S, help="to move a joint (default 20)")
    checkout.add_argument("--dry-run", type=float, metavar="S", default=_DRY_RUN_S, help="its length (default 10)")
    checkout.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    common.add_json(checkout)
    checkout.set_defaults(command=_checkout)


def _checkout(arguments: argparse.Namespace) -> int:
    for option, value in (
        ("--minutes", arguments.minutes),
        ("--move", arguments.move),
        ("--dry-run", arguments.dry_run),
    ):
        if not 0.0 < value < 1e6:
            raise ValueError(f"{option} {value:g}: give a positive number")
    vehicle = common.with_urls(common.load_vehicle(arguments.vehicle), arguments.url)
    if arguments.without:
        return _without(vehicle, arguments)
    if arguments.scenario:
        raise ValueError("--scenario is the motion of --without; a walk has none")
    return _walk(vehicle, arguments)


def _without(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> int:
    try:
        from hil_sim.devices.vehicle_file import scenario_of
        from hil_sim.plants.planned import default_plan
    except ModuleNotFoundError as error:
        raise ValueError(f"the motion is the simulator's, which is not installed ({error})") from error
    from onboard.ground.before.foresee import contingency_view as contingency
    from onboard.ground.before.foresee.contingency import foresee_without
    from onboard.ground.before.foresee.plan import plan_of

    scenario = scenario_of(vehicle.path, arguments.scenario)
    with common.busy(f"what is left without {', '.join(arguments.without)}"):
        plan = plan_of(vehicle, default_plan(scenario, 1.0 / vehicle.file.estimation.row_rate_hz))
        found = foresee_without(vehicle, plan, list(dict.fromkeys(arguments.without)))
    motion = "the motion of the scenario" if arguments.scenario else "the default motion of a rehearsal"
    common.show(contingency.render(found, motion))
    common.write_json(arguments.json, found.as_json())
    return common.OK if found.useful else common.FAILED


class _Console:
    """The operator at the terminal; what is piped in answers in turn, and its end answers nothing more."""

    def ask(self, text: str) -> str | None:
        """The answer, without its line end; None: nobody answers."""
        print(text, end=" ", flush=True)
        line = sys.stdin.readline()
        if not sys.stdin.isatty():
            print(line.rstrip("\n"))
        return line.strip() if line else None

    def tell(self, text: str) -> None:
        """Say how a step came out."""
        print(text, flush=True)


def _walk(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> int:
    from onboard.flight.check import checkout
    from onboard.flight.estimate.estimator import Estimator
    from onboard.flight.supervise import workers

    directory = Path(vehicle.file.recording.directory)

    def dry_run() -> "CheckResult":
        return _dry_run(vehicle, arguments.dry_run)

    bench = checkout.CheckHost(time.monotonic_ns, time.sleep, lambda: datetime.now(UTC), workers.run_for, dry_run)
    lengths = checkout.Lengths(arguments.seconds, arguments.move, 60.0 * arguments.minutes)
    record = checkout.checkout(vehicle, Estimator(vehicle), bench, _Console(), lengths)
    common.show(checkout.render(record))
    path = checkout.write(record, directory)
    print(path)
    common.write_json(arguments.json, record.as_json())
    return common.OK if record.ready else common.NOT_READY


def _dry_run(vehicle: "config.Vehicle", seconds: float) -> "CheckResult":
    """Fly the whole app for some seconds, and look at its log."""
    from onboard.cli import messages
    from onboard.cli.common import next_log
    from onboard.flight.check.checkout_checks import CheckResult, look_at
    from onboard.flight.supervise import runner
    from onboard.flight.supervise.runner_processes import FlightError
    from onboard.recording.reader import LogReader

    log = next_log(vehicle.file.recording.directory, f"{vehicle.file.vehicle.name}-checkout")
    try:
        with messages.spoken(quiet=True, json_lines=False) as status_s:
            flight = runner.fly(vehicle, log, duration_s=seconds, status_s=status_s, plan=None)
    except FlightError as error:
        return CheckResult((str(error),), "")
    return look_at(vehicle, LogReader(flight.log), flight.died)
