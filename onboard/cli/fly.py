"""``heft fly`` flies a vehicle on real buses and the real clock."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config


def add(commands: common.Commands) -> None:
    """Make the command known."""
    fly = commands.add_parser("fly", help="fly a vehicle: acquire, record, estimate")
    fly.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    fly.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    fly.add_argument("--new", action="store_true", help="a new flight, even where an interrupted flight could go on")
    fly.add_argument("--duration", type=float, metavar="S", help="stop after this many seconds")
    fly.add_argument(
        "--continue",
        dest="earlier",
        type=Path,
        metavar="LOG",
        help="start from the last estimate of LOG: the same payload must still be held",
    )
    fly.add_argument("--motion", type=Path, metavar="CSV", help="motion for the drives, in place of that of [drive]")
    fly.add_argument("--arm", action="store_true", help="drive the arm: after a preflight, when every drive is ready")
    fly.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    spoken = fly.add_mutually_exclusive_group()
    spoken.add_argument("--quiet", action="store_true", help="say warnings and errors only")
    spoken.add_argument("--json-lines", action="store_true", help="say everything as JSON, an object a line")
    common.add_flying(fly)
    fly.set_defaults(command=_fly)


def _fly(arguments: argparse.Namespace) -> int:
    from onboard import config
    from onboard.cli import messages
    from onboard.flight.supervise import runner
    from onboard.flight.supervise.runner_processes import FlightError

    vehicle = config.with_mission(common.load_vehicle(arguments.vehicle), arguments.until, arguments.segments)
    plan = None
    driven = _with_drives(vehicle, arguments)
    if driven is None:
        return common.NOT_READY
    vehicle = driven
    log = arguments.log
    if log is None:
        new_log = common.next_log(vehicle.file.recording.directory, vehicle.file.vehicle.name)
        plan = runner.plan_of(vehicle, new_log, fresh=arguments.new)
        vehicle, log = plan.vehicle, plan.log
        if plan.before is not None and vehicle.arm:
            raise ValueError("this start goes on with a flight that lost its power, and does not drive the arm: --new")
    runner.require_new(log)
    if arguments.earlier:
        from onboard.ground.identify.replay import warm_start
        from onboard.recording.reader import LogReader

        vehicle = warm_start.go_on(vehicle, LogReader(arguments.earlier))
    vehicle = common.with_hand_over(common.with_urls(vehicle, arguments.url), arguments.hand_over)
    try:
        with (
            runner.Servers(vehicle, shared=True) as servers,  # before there are threads
            messages.spoken(quiet=arguments.quiet, json_lines=arguments.json_lines) as status_s,
            common.shown(arguments, log, vehicle),
        ):
            flight = runner.fly(
                vehicle, log, duration_s=arguments.duration, status_s=status_s, plan=plan, servers=servers
            )
    except FlightError as error:
        common.complain(error)
        return common.FAILED
    print(flight.log)
    for lost in flight.lost:
        common.complain(f"of the log: {lost}")
    for name in flight.died:
        common.complain(f"the {name} worker died; see its message above, and the event in the log")
    return common.FAILED if flight.died or flight.lost or (flight.missing and not flight.was_over) else common.OK


def _with_drives(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> "config.Vehicle | None":
    """The vehicle with what its drives are to play, if anything; None where a preflight stands against it."""
    drive = vehicle.file.drive
    if arguments.until is not None and not (arguments.arm or (drive is not None and drive.phase is not None)):
        raise ValueError("--until asks for motions: add --arm, or give [drive] phase (docs/driving.md)")
    if arguments.arm or arguments.motion is not None:
        if drive is None or not drive.armed:
            raise ValueError(f"{vehicle.label}: --arm and --motion need [drive] armed = true (docs/driving.md)")
        motion = None if arguments.motion is None else arguments.motion.absolute()
        vehicle = vehicle.model_copy(update={"arm": arguments.arm, "own_motion": motion})
    if drive is None or not drive.armed or not (vehicle.arm or drive.phase is not None):
        return vehicle
    from onboard.flight.check import preflight
    from onboard.flight.estimate.estimator import Estimator
    from onboard.flight.supervise import workers  # Pinocchio comes with them, which a supervisor does without

    if vehicle.motion is None and vehicle.segments_path is None:
        raise ValueError(f"{vehicle.label}: no motion to drive: give --motion, or [drive] motion")
    playing = [bus for bus in vehicle.buses if vehicle.play(bus) is not None]
    looks = time.monotonic_ns, time.sleep, workers.run_for, None, preflight.FLIGHT_S, Estimator(vehicle), time.time()
    with common.busy("preflight, before the arm is driven") as told:
        found = preflight.preflight(common.with_urls(vehicle, arguments.url), *looks, told)
    played = vehicle.motion.name if vehicle.motion is not None else "segments as they are asked for"
    if found.ready:
        common.console().print(f"preflight is green: {played} on {', '.join(playing)}")
        return vehicle
    common.show(preflight.render(found))
    if vehicle.arm:
        common.complain(
            "the preflight is not green: the arm is not driven, and nothing flown; fly without --arm to record"
        )
        return None
    common.complain("the preflight is not green: the flight begins, and the arm is not driven")
    return vehicle.with_sections(drive=drive.model_copy(update={"armed": False}))
