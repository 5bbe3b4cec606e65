"""``heft calibrate`` measures instruments and the bare vehicle on a bench, and writes the result into vehicle.toml."""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config
    from onboard.ground.calibrate.guide import GuideStep
    from onboard.ground.calibrate.readings import LogSpan
    from onboard.ground.calibrate.result import Calibration
    from onboard.ground.calibrate.supports import PartRig
    from onboard.recording.reader import LogReader

    Analysis = Callable[[argparse.Namespace, LogReader, config.Vehicle, str, Sequence[LogSpan]], Calibration]

_WEIGHED_SIGMA_KG = 0.005


def add(commands: common.Commands) -> None:
    """Make the command known."""
    calibrate = commands.add_parser(
        "calibrate",
        help="measure an instrument or the bare vehicle on a bench, and write it into vehicle.toml",
        description="From the devices, step by step; from a log with --log; against a simulated bench with --hil.",
    )
    kinds = calibrate.add_subparsers(required=True, metavar="WHAT")
    _add_imu(kinds)
    _add_load_cell(kinds)
    _add_encoder(kinds)
    _add_bifilar(kinds)
    _add_balance(kinds)


def _kind(kinds: Any, name: str, about: str, device: str, **others: Any) -> Any:
    one = kinds.add_parser(name, help=about, description=f"{about}; docs/calibration.md tells how.")
    one.add_argument("vehicle", help="vehicle.toml; it gets the result")
    one.add_argument("--device", metavar="NAME", help=device)
    one.add_argument("--log", type=Path, help="of a bench run, in place of the devices")
    one.add_argument("--at", default="", metavar="S-S,S-S", help="the stretches of the log to use, s from its start")
    one.add_argument("--hil", nargs="?", const="", metavar="SCENARIO", help="a simulated bench (that of the vehicle)")
    one.add_argument("--seed", type=int, default=1, help="of the simulated bench (1)")
    one.add_argument("--record", type=Path, metavar="LOG", help="log to write (flights/NAME-WHAT-NNN.mcap)")
    one.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    one.add_argument("--latitude-deg", type=float, help="of the place, for gravity; without it 0.15 %% are added")
    one.add_argument("--height-m", type=float, default=0.0, help="above the sea (0)")
    one.add_argument("--dry-run", action="store_true", help="show what would change in the file, and leave it")
    common.add_json(one)
    one.set_defaults(command=_calibrate, what=name, **others)
    return one


def _add_imu(kinds: Any) -> None:
    one = _kind(
        *(kinds, "imu", "six positions and whole turns: bias, scale, misalignment", "the IMU (that of the base)"),
        analyse=_imu, role="imu",
    )  # fmt: skip
    one.add_argument("--turn-deg", type=float, default=360.0, help="a turn is this, or a multiple (360)")
    one.add_argument("--turn-sigma-mrad", type=float, default=1.0, help="how well (1)")
    one.add_argument("--fixture-mrad", type=float, default=1.0, help="how well a position is held, 1 sigma (1)")
    one.add_argument(
        "--allan", nargs="?", type=float, const=1800.0, metavar="S", help="noise by Allan deviation, from a rest of S s"
    )
    one.add_argument("--plot", type=Path, metavar="FILE", help="the Allan deviation as a figure (.png, .svg, .pdf)")


def _add_load_cell(kinds: Any) -> None:
    one = _kind(
        *(kinds, "load-cell", "known masses: scale, offset, or lever", "which load cell, if several"),
        analyse=_load_cell, role="cell",
    )  # fmt: skip
    one.add_argument("--masses-kg", type=_numbers, required=True, metavar="M,M", help="in their order; 0 for none")
    one.add_argument("--mass-sigma-g", type=float, default=0.1, help="of each (0.1)")
    one.add_argument("--combined-error-percent", type=float, default=0.03, help="of the cell's data sheet (0.03)")
    one.add_argument("--arm-m", type=float, help="of a moment: from the axis to where they hang, for its lever")
    one.add_argument("--arm-sigma-mm", type=float, default=0.2, help="how well (0.2)")


def _add_encoder(kinds: Any) -> None:
    one = _kind(
        *(kinds, "encoder", "the stops of a joint: zero, direction, counts per turn", "which encoder, if several"),
        analyse=_encoder, role="joint",
    )  # fmt: skip
    one.add_argument("--angles-deg", type=_numbers, metavar="A,A", help="in their order (limits of the URDF, twice)")
    one.add_argument("--angle-sigma-deg", type=float, default=0.02, help="of each (0.02)")


def _add_bifilar(kinds: Any) -> None:
    one = _kind(
        *(kinds, "bifilar", "swings on two strings: inertia of the bare base", "the IMU on it (that of the base)"),
        analyse=_bifilar, role="imu",
    )  # fmt: skip
    one.add_argument("--mass-kg", type=float, help="of the body, weighed")
    one.add_argument("--mass-sigma-kg", type=float, default=_WEIGHED_SIGMA_KG, help="how well (0.005)")
    one.add_argument("--spacing-m", type=float, help="between the strings")
    one.add_argument("--spacing-sigma-m", type=float, default=1e-4, help="how well (0.0001)")
    one.add_argument("--length-m", type=float, help="of each string")
    one.add_argument("--length-sigma-m", type=float, default=3e-4, help="how well (0.0003)")


def _add_balance(kinds: Any) -> None:
    one = _kind(
        *(kinds, "balance", "mass and centre: a base on a load cell, a part on edges or scales", "the load cell"),
        analyse=_balance, role="cell",
    )  # fmt: skip
    one.add_argument("--rig", type=Path, required=True, help="TOML file of the orientations, or of edges and scales")
    one.add_argument("--link", metavar="LINK", help="that lies on edges or scales")


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def _calibrate(arguments: argparse.Namespace) -> int:
    from onboard.estimation.errors import CalibrationError
    from onboard.ground.calibrate import readings, vehicle_file
    from onboard.recording.reader import LogReader

    vehicle = common.with_urls(common.load_vehicle(arguments.vehicle), arguments.url)
    if not arguments.dry_run:
        vehicle_file.require_writable(vehicle)
    if arguments.what == "balance" and (done := _part(arguments, vehicle)) is not None:
        return done
    device = _device(vehicle, arguments)
    at = readings.spans_of(arguments.at)
    log = arguments.log or _recorded(arguments, vehicle, device)
    try:
        with common.progress() as bar:
            bar.add_task(f"{arguments.what} {log.name}", total=None)
            found = arguments.analyse(arguments, LogReader(log, kept=1.0), vehicle, device, at)
    except CalibrationError as error:
        common.complain(f"{error} ({vehicle.label} is as it was; the log is {log})")
        return common.FAILED
    return _written(arguments, vehicle, found, device, log)


def _part(a: argparse.Namespace, vehicle: "config.Vehicle") -> int | None:
    """A part on edges or scales, whose readings stand in the rig file; None where the rig is of a load cell."""
    from onboard.estimation.errors import CalibrationError
    from onboard.ground.calibrate import supports

    rig = supports.part_rig(a.rig)
    if rig is None:
        if a.link is not None and a.link != vehicle.file.vehicle.base_link:
            raise ValueError(
                f"--link {a.link}: {a.rig} has no [[edge]] and no [[scales]]; a load cell balances the base"
            )
        return None
    if a.link is None:
        raise ValueError(f"{a.rig} is of a part: say which by --link")
    for option, value in (("--device", a.device), ("--log", a.log), ("--at", a.at), ("--record", a.record)):
        if value:
            raise ValueError(f"{option}: {a.rig} has the readings of its edges and scales; leave it out")
    try:
        if a.hil is not None:
            rig = _simulated_part(a, vehicle, rig)
        found = supports.balance_part(vehicle, a.link, rig)
    except CalibrationError as error:
        common.complain(f"{error} ({vehicle.label} is as it was)")
        return common.FAILED
    return _written(a, vehicle, found, a.link, a.rig)


def _simulated_part(a: argparse.Namespace, vehicle: "config.Vehicle", rig: "PartRig") -> "PartRig":
    try:
        from hil_sim.bench import part_readings
    except ModuleNotFoundError as error:
        raise ValueError(f"--hil simulates with MuJoCo ({error}): pip install mujoco") from error

    told = rig.model_dump()
    return type(rig)(**told | part_readings(a.hil or vehicle.file.vehicle.name, a.seed, a.link, told))


def _written(
    arguments: argparse.Namespace, vehicle: "config.Vehicle", found: "Calibration", what: str, source: Path
) -> int:
    """Show what was found, and write it into the vehicle file."""
    import datetime

    from onboard.ground.calibrate import result, vehicle_file

    note = f"{datetime.date.fromtimestamp(time.time())}, {source.name}, heft calibrate {arguments.what}"
    tables = dict.fromkeys(one.table for one in found.changes if one.table[0] in ("device", "link"))
    found.changes += [result.KeyChange(table, "calibrated", note) for table in tables]
    text = vehicle_file.changed(vehicle, found.changes)
    common.show(result.render(found, f"{arguments.what}: {what} of {vehicle.file.vehicle.name}"))
    for line in found.notes:
        common.console().print(line, soft_wrap=True, highlight=False, markup=False)
    if arguments.dry_run:
        sys.stdout.write(vehicle_file.difference(vehicle, text))
    else:
        vehicle_file.replace(vehicle, text)
    told = "would be changed" if arguments.dry_run else "changed"
    common.console().print(
        f"{vehicle.label}: {len(found.changes)} keys {told}; from {source}", soft_wrap=True, markup=False
    )
    common.write_json(arguments.json, found.as_json() | {"log": str(source), "device": what, "calibrated": note})
    return common.OK


def _device(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> str:
    """The device that is meant.

    Raises:
        ConfigError: none is, or it is not there.
    """
    from onboard import config
    from onboard.flight.estimate.readings.roles import roles_of

    roles = roles_of(vehicle)
    by_role = {
        "imu": [imu.channels[0] for imu in roles.imus[:1]],
        "cell": [cell.name for cell in roles.cells],
        "joint": [joint.channel for joint in roles.joints],
    }
    name: str | None = arguments.device
    if name is None:
        known = by_role[arguments.role]
        if len(known) != 1:
            raise config.ConfigError(f"{vehicle.label}: which device? give --device: {', '.join(known) or 'none'}")
        name = known[0]
    if name not in vehicle.file.device:
        raise config.ConfigError(f"{vehicle.label}: no device {name!r}; there are {', '.join(vehicle.file.device)}")
    return name


def _recorded(arguments: argparse.Namespace, vehicle: "config.Vehicle", device: str) -> Path:
    """A log of the devices, step by step, or of a simulated bench."""
    from onboard.flight import bench
    from onboard.flight.estimate.readings.roles import roles_of
    from onboard.ground.calibrate import steps

    if arguments.at:
        raise ValueError("--at says which stretches of a log to use: give --log as well")
    imus = [imu.channels[0] for imu in roles_of(vehicle).imus[:1] if len(imu.channels) == 1]
    wanted = {device, *(imus if arguments.what == "balance" else [])}
    some = bench.only(vehicle, wanted)
    name = f"{vehicle.file.vehicle.name}-{arguments.what}"
    log: Path = arguments.record or common.next_log(vehicle.file.recording.directory, name)
    if arguments.hil is not None:
        _simulated(arguments, some, device, log)
    else:
        if not sys.stdin.isatty():
            raise ValueError("a calibration is done by hand: run it on a terminal, or give --log or --hil")
        _guided(steps.steps(arguments, vehicle, device), some, log)
    return log


def _simulated(arguments: argparse.Namespace, vehicle: "config.Vehicle", device: str, log: Path) -> None:
    try:
        from hil_sim.bench import LATITUDE_deg, open_bench
    except ModuleNotFoundError as error:
        raise ValueError(f"--hil simulates with MuJoCo ({error}): pip install mujoco") from error
    from onboard.flight import bench
    from onboard.ground.calibrate import steps

    if arguments.latitude_deg is None:
        arguments.latitude_deg = LATITUDE_deg
    scenario = arguments.hil or vehicle.file.vehicle.name
    settings = steps.settings(arguments, vehicle, device)
    with common.progress() as bar:
        task = bar.add_task(f"{arguments.what} bench, seed {arguments.seed}", total=1.0)
        world, urls = open_bench(arguments.what, scenario, arguments.seed, set(vehicle.file.device), settings)
        with world:
            on_bench = bench.on_simulated(vehicle, urls)
            bench.record_simulated(on_bench, world, log, lambda done: bar.update(task, completed=done))
        if arguments.what == "bifilar" and arguments.mass_kg is None:  # the bench has a scale, too
            arguments.mass_kg = round(world.truth()["weighed_kg"], 3)


def _guided(steps: "list[GuideStep]", vehicle: "config.Vehicle", log: Path) -> None:
    """The steps on a terminal: each shown, confirmed, then held for its time."""
    from onboard.flight import bench

    with bench.BenchRun(vehicle, log, time.monotonic_ns) as run, bench.PumpedBench(run) as pumped:
        for number, step in enumerate(steps, 1):
            input(f"{number}/{len(steps)}  {step.text} Enter when it is so: ")
            pumped.check()
            run.mark(bench.BEGIN, step.name)
            with common.progress() as bar:
                task = bar.add_task(step.name, total=step.hold_s)
                begun_s = time.monotonic()
                while (done_s := time.monotonic() - begun_s) < step.hold_s:
                    bar.update(task, completed=done_s)
                    time.sleep(0.1)
            pumped.check()
            run.mark(bench.END, step.name)


# By kind: what the log says, what the operator does, what the simulated bench does


def _place(arguments: argparse.Namespace) -> Any:
    from onboard.ground.calibrate.place import place

    return place(arguments.latitude_deg, arguments.height_m)


def _imu(a: argparse.Namespace, log: "LogReader", v: "config.Vehicle", device: str, at: "Sequence[LogSpan]") -> Any:
    import math

    from onboard.ground.calibrate import allan
    from onboard.ground.calibrate.imu import ImuOptions, calibrate_imu
    from onboard.ground.calibrate.readings import readings

    options = ImuOptions(
        _place(a), 1e-3 * a.fixture_mrad, math.radians(a.turn_deg), 1e-3 * a.turn_sigma_mrad, a.allan is not None
    )
    found, deviation = calibrate_imu(readings(log, v, device), v, device, options, at)
    if a.plot is not None:
        if deviation is None:
            raise ValueError("--plot shows the Allan deviation: give --allan as well")
        allan.plot(deviation, a.plot)
    return found


def _load_cell(
    a: argparse.Namespace, log: "LogReader", v: "config.Vehicle", device: str, at: "Sequence[LogSpan]"
) -> Any:
    from onboard.ground.calibrate.load_cell import HungMasses, calibrate_load_cell
    from onboard.ground.calibrate.readings import readings

    hung = HungMasses(
        a.masses_kg, 1e-3 * a.mass_sigma_g, _place(a), a.arm_m, 1e-3 * a.arm_sigma_mm, 1e-2 * a.combined_error_percent
    )
    channel = next(iter(v.file.device[device].channels(device)))
    return calibrate_load_cell(readings(log, v, channel), v, device, hung, at)


def _encoder(a: argparse.Namespace, log: "LogReader", v: "config.Vehicle", device: str, at: "Sequence[LogSpan]") -> Any:
    import math

    from onboard.ground.calibrate import steps
    from onboard.ground.calibrate.encoder import Stops, calibrate_encoder
    from onboard.ground.calibrate.readings import readings

    angles = tuple(math.radians(angle) for angle in steps.angles_deg(a, v, device))
    stops = Stops(angles, math.radians(a.angle_sigma_deg))
    return calibrate_encoder(readings(log, v, device), v, device, stops, at)


def _bifilar(a: argparse.Namespace, log: "LogReader", v: "config.Vehicle", device: str, at: "Sequence[LogSpan]") -> Any:
    from onboard.estimation.calibration.bifilar import Suspension
    from onboard.ground.calibrate.bifilar import calibrate_bifilar
    from onboard.ground.calibrate.readings import readings

    missing = [f"--{key}" for key in ("mass-kg", "spacing-m", "length-m") if getattr(a, key.replace("-", "_")) is None]
    if missing:
        raise ValueError(f"give {', '.join(missing)}: what the body weighs and how it hangs")
    sigmas = a.mass_sigma_kg, a.spacing_sigma_m, a.length_sigma_m
    g = _place(a)
    suspension = Suspension(a.mass_kg, a.spacing_m, a.length_m, *sigmas, gravity_m_s2=g.gravity_m_s2)
    read = readings(log, v, device, calibrated=True)
    return calibrate_bifilar(read, v, device, suspension, at, g.sigma_m_s2 / g.gravity_m_s2)[0]


def _balance(a: argparse.Namespace, log: "LogReader", v: "config.Vehicle", device: str, at: "Sequence[LogSpan]") -> Any:
    from onboard.flight.estimate.readings.roles import roles_of
    from onboard.ground.calibrate.balance import calibrate_balance, rig
    from onboard.ground.calibrate.readings import readings

    channel, imus = next(iter(v.file.device[device].channels(device))), roles_of(v).imus
    imu = imus[0].channels[0] if imus and imus[0].channels[0] in log.channels else None
    cell = readings(log, v, channel, calibrated=True)
    base = readings(log, v, imu, calibrated=True) if imu else None
    return calibrate_balance(cell, base, v, device, rig(a.rig), _place(a), at)
