"""``heft weigh`` weighs a tool by a wrist force-torque sensor in static poses, of a table or read live."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config
    from onboard.flight.bench import BenchRun
    from onboard.ground.calibrate.weigh.columns import Meaning
    from onboard.ground.calibrate.weigh.conventions import Known
    from onboard.ground.calibrate.weigh.live import Session
    from onboard.ground.calibrate.weigh.weigh import Answer


def add(commands: common.Commands) -> None:
    """Make the command known."""
    weigh = commands.add_parser(
        "weigh",
        help="weigh a tool by a wrist force-torque sensor in static poses: mass, centre of mass, zeros",
        description="From a table of orientations and wrenches, or live by --device; docs/weigh.md tells how.",
    )
    weigh.add_argument("poses", type=Path, nargs="*", metavar="POSES", help="CSV or text; more: columns side by side")
    _add_live(weigh)
    weigh.add_argument(
        "--columns", metavar="NAME,...", help="names of the columns, - for those that are not meant; or NAME=NUMBER"
    )
    weigh.add_argument(
        "--orientation", default="", metavar="KIND", help="xyzw, wxyz, matrix, rotvec, or Euler angles: xyz, ZYX, ..."
    )
    weigh.add_argument(
        "--sense", choices=("sensor-in-base", "base-in-sensor"), help="whose orientation it is (default: the likelier)"
    )
    weigh.add_argument("--axes", choices=("sensor", "base"), help="whose axes the wrench is in (the likelier ones)")
    weigh.add_argument(
        "--sign", choices=("weight", "reaction"), help="whether it is what acts on the sensor (default: the likelier)"
    )
    weigh.add_argument("--turned", default="", metavar="AXIS,...", help="axes whose sign is wrong: fx,mz")
    weigh.add_argument("--force-unit", default="", metavar="UNIT", help="N, kN, kgf, lbf ... (by the names, else N)")
    weigh.add_argument("--moment-unit", default="", metavar="UNIT", help="Nm, Nmm, mNm ... (by the names, else N m)")
    weigh.add_argument("--angle-unit", default="", metavar="UNIT", help="deg or rad (by the names, else by size)")
    weigh.add_argument("--urdf", type=Path, metavar="FILE", help="columns are joint angles of this arm")
    weigh.add_argument(
        "--link", default="", metavar="LINK", help="of --urdf or --device, that the sensor is on (the last)"
    )
    weigh.add_argument("--gravity", metavar="X,Y,Z", help="downwards in the base's axes (the likeliest of its axes)")
    weigh.add_argument("--latitude-deg", type=float, help="of the place, for gravity; without it 0.15 %% are added")
    weigh.add_argument("--height-m", type=float, default=0.0, help="above the sea (0)")
    weigh.add_argument(
        "--scale-percent",
        type=float,
        help="1 sigma of an axis' scale, of the sensor's data sheet (1; --device: the device's)",
    )
    weigh.add_argument("--tilt-deg", type=float, default=5.0, help="1 sigma of the base's tilt (5)")
    weigh.add_argument("--vehicle", metavar="FILE", help="vehicle.toml: its load cells get the zeros (offset_N)")
    weigh.add_argument("--dry-run", action="store_true", help="show what would change in the file, and leave it")
    weigh.add_argument("--plot", type=Path, metavar="FILE", help="the figure (.png, .svg, .pdf)")
    common.add_json(weigh)
    weigh.set_defaults(command=_weigh)


def _add_live(weigh: Any) -> None:
    weigh.add_argument("--device", metavar="VEHICLE", help="vehicle.toml of an arm whose wrist sensor is read live")
    weigh.add_argument(
        "--until-percent", type=float, default=1.0, help="--device: end when the mass is known so well (1)"
    )
    weigh.add_argument(
        "--hil", nargs="?", const="", metavar="SCENARIO", help="--device: a simulated arm (the vehicle's)"
    )
    weigh.add_argument("--seed", type=int, default=1, help="of the simulated arm (1)")
    weigh.add_argument(
        "--url", action="append", default=[], metavar="BUS=URL", help="--device: open BUS at URL instead"
    )
    weigh.add_argument(
        "--record", type=Path, metavar="LOG", help="--device: log to write (flights/NAME-weigh-NNN.mcap)"
    )


def _weigh(arguments: argparse.Namespace) -> int:
    from onboard.estimation.errors import CalibrationError
    from onboard.ground.calibrate.weigh import tare, view
    from onboard.ground.calibrate.weigh.further import further
    from onboard.ground.calibrate.weigh.judge import judge, judge_live
    from onboard.ground.calibrate.weigh.weigh import weigh
    from onboard.identification.standing import Level

    _require_one_source(arguments)
    extra: dict[str, Any] = {}
    if arguments.device is None:
        with common.busy("the table is read") as tell:
            meaning = _meaning(arguments)
            answer = weigh(meaning, _known(arguments), tell)
            tell("further poses")
            more = further(answer)
        judged = judge(answer)
        judged = judged._replace(notes=(*meaning.said, *judged.notes))
        title = f"weighed: {', '.join(path.name for path in arguments.poses)}"
    else:
        try:
            session, log = _by_device(arguments)
        except CalibrationError as error:
            common.complain(error)
            return common.FAILED
        if session.answer is None:
            common.complain(
                f"{len(session.R)} poses were taken, four are needed: nothing is weighed (the log is {log})"
            )
            return common.FAILED
        answer, more = session.answer, further(session.answer)
        judged = judge_live(answer, session.sensor.frame)
        title, extra = f"weighed: {session.sensor.frame}; log: {log}", dict(session.summary()) | {"log": str(log)}
    common.show(view.render(answer, judged, more, title))
    if arguments.plot is not None:
        view.draw(answer, arguments.plot)
        print(arguments.plot)
    refused = judged.verdict.level is Level.DO_NOT_USE
    written = extra | {"tare": {one.name: one.zero for one in answer.axes}}
    if arguments.vehicle is not None:
        written["vehicle"] = _tare(arguments, answer, refused)
    else:
        print("zeros, for the tables of the sensor's axes:\n" + tare.lines(answer))
    common.write_json(arguments.json, view.as_json(answer, judged, more) | written)
    return common.FAILED if refused else common.OK


def _require_one_source(a: argparse.Namespace) -> None:
    """Refuse a table and a device, or neither; and options of the one with the other.

    Raises:
        ValueError: naming the option.
    """
    if bool(a.poses) == (a.device is not None):
        raise ValueError("give a table of poses (heft weigh POSES.csv), or --device VEHICLE to read the sensor live")
    tables = ("columns", "orientation", "sense", "axes", "turned", "force_unit", "moment_unit", "angle_unit", "urdf")
    other = {"hil": a.hil, "url": a.url, "record": a.record} if a.poses else {name: getattr(a, name) for name in tables}
    for name, value in other.items():
        if value or value == "":
            if not a.poses and value == "":
                continue
            raise ValueError(f"--{name.replace('_', '-')} is for {'--device' if a.poses else 'a table of poses'} only")
    if not 0.01 <= a.until_percent <= 50.0:
        raise ValueError(f"--until-percent {a.until_percent:g}: half of the mass' interval, from 0.01 to 50")


def _by_device(a: argparse.Namespace) -> "tuple[Session, Path]":
    """Weigh live, or in a simulated world; the poses, and the log of all that was read."""
    from onboard.flight import bench
    from onboard.ground.calibrate import vehicle_file
    from onboard.ground.calibrate.weigh.conventions import DOWN, Said
    from onboard.ground.calibrate.weigh.live import Session
    from onboard.ground.calibrate.weigh.wrist_sensor import wrist_sensor

    vehicle = common.with_urls(common.load_vehicle(a.device), a.url)
    if a.vehicle is not None and not a.dry_run:
        vehicle_file.require_writable(common.load_vehicle(a.vehicle))
    sensor = wrist_sensor(vehicle, a.link)
    known = _known(a, 100.0 * sensor.scale_sigma or None)
    down = vehicle.file.vehicle.gravity_m_s2 or known.down or DOWN
    say = common.console().print
    session = Session(
        *(sensor, known.place, down, known.scale, known.tilt_rad, 1e-2 * a.until_percent),
        *(
            Said("sensor-in-base", "sensor", a.sign),
            lambda text: say(text, soft_wrap=True, highlight=False, markup=False),
        ),
    )
    some = bench.only(vehicle, sensor.devices(vehicle))
    log = a.record or common.next_log(vehicle.file.recording.directory, f"{vehicle.file.vehicle.name}-weigh")
    if a.hil is not None:
        _simulated(a, some, session, log)
    else:
        with bench.BenchRun(some, log, time.monotonic_ns) as run, bench.PumpedBench(run) as pumped:
            _read(run, session, pumped)
    return session, log


def _read(run: "BenchRun", session: "Session", pumped: Any) -> None:
    """Until it is done, or until Ctrl-C."""
    readers = run.readers(session.sensor.channels)
    try:
        while not session.done:
            time.sleep(0.05)
            pumped.check()
            for channel, reader in readers.items():
                session.feed(channel, reader.read()[0])
            session.step(time.monotonic())
    except KeyboardInterrupt:
        session.done = "ended by hand"


def _simulated(a: argparse.Namespace, vehicle: "config.Vehicle", session: "Session", log: Path) -> None:
    try:
        from hil_sim.bench import open_bench
    except ModuleNotFoundError as error:
        raise ValueError(f"--hil simulates with MuJoCo ({error}): pip install mujoco") from error
    from onboard.flight import bench

    world, urls = open_bench("weigh", a.hil or vehicle.file.vehicle.name, a.seed, set(vehicle.file.device), {})
    with world:
        bench.run_simulated(bench.on_simulated(vehicle, urls), world, log, session)


def _meaning(a: argparse.Namespace) -> "Meaning":
    import numpy as np

    from onboard.ground.calibrate.weigh import arm, columns, table
    from onboard.ground.calibrate.weigh.errors import PosesError

    read = table.read(a.poses)
    if a.columns:
        names = table.named(a.columns, read.values.shape[1])
        read = read._replace(names=names)
    of = arm.arm(a.urdf.read_text(encoding="utf-8"), str(a.urdf), a.link) if a.urdf else None
    units = columns.Units(a.force_unit, a.moment_unit, a.angle_unit)
    found = columns.understood(read, units, of.joints if of else (), a.orientation)
    signs = np.ones(6)
    for axis in filter(None, a.turned.split(",")):
        if axis not in (known := [f"{kind}{end}" for kind in "fm" for end in "xyz"]):
            raise PosesError(f"--turned {axis}: name axes of {', '.join(known)}")
        signs[known.index(axis)] = -1.0
    found = found._replace(wrench=signs * found.wrench)
    return arm.posed(found, of) if of else found


def _known(a: argparse.Namespace, scale_percent: float | None = None) -> "Known":
    import math

    from onboard.ground.calibrate.place import place
    from onboard.ground.calibrate.weigh.conventions import Known, Said

    down = None
    if a.gravity is not None:
        try:
            x, y, z = (float(part) for part in a.gravity.split(","))
        except ValueError as error:
            raise ValueError(f"--gravity {a.gravity}: write three numbers, 0,0,-1 for instance") from error
        if not 0.0 < math.hypot(x, y, z) < math.inf:
            raise ValueError(f"--gravity {a.gravity}: it has no direction; write 0,0,-1 for instance")
        down = x, y, z
    scale = next((one for one in (a.scale_percent, scale_percent) if one is not None), 1.0)
    for name, value in (("scale-percent", scale), ("tilt-deg", a.tilt_deg)):
        if not 1e-3 <= value <= 90.0:
            raise ValueError(f"--{name} {value:g}: give 1 sigma, from 0.001 to 90")
    where = place(a.latitude_deg, a.height_m)
    said = Said(a.sense, a.axes, a.sign)
    return Known(where, down, 1e-2 * scale, math.radians(a.tilt_deg), said=said)


def _tare(a: argparse.Namespace, answer: "Answer", refused: bool) -> dict[str, Any]:
    """Write the zeros, or show what would change; a weighing that is not to be used changes nothing."""
    from onboard.ground.calibrate import vehicle_file
    from onboard.ground.calibrate.weigh import tare

    vehicle = common.load_vehicle(a.vehicle)
    found = tare.changes(vehicle, answer)
    text = vehicle_file.changed(vehicle, found)
    if a.dry_run or refused:
        sys.stdout.write(vehicle_file.difference(vehicle, text))
    else:
        vehicle_file.replace(vehicle, text)
    told = (
        "would be changed"
        if a.dry_run
        else "are as they were: the weighing is not to be used"
        if refused
        else "changed"
    )
    common.console().print(f"{vehicle.label}: {len(found)} keys {told}", soft_wrap=True, markup=False)
    return {"file": vehicle.label, "changes": [one._asdict() | {"table": ".".join(one.table)} for one in found]}
