"""``heft init`` writes a vehicle to begin with."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli.common import OK, Commands, bus_and_url, busy
from onboard.dynamics.model.bases import BASES as KINDS
from onboard.dynamics.model.bases import BaseKind

if TYPE_CHECKING:
    from onboard.ground.before.init.drawing import DrawnUrdf
    from onboard.ground.before.init.vehicle import NewVehicle

_WITH_AN_ARM = [name for name in KINDS if name != BaseKind.PIVOT.name]
_QUESTIONS = (
    ("base", "What is the base? " + ", ".join(_WITH_AN_ARM), "free"),
    ("joints", "Joints of the arm: how many, or their names with commas", "2"),
    ("imu", "IMU on the base?", "mpu6050"),
    ("encoder", "What measures the joints?", "cia406"),
    ("load_cell", "Load cell?", "none"),
)

_NO_PROOF = "no proof mass is set on: all answers lean on the wheels' inertia, and are weak; --payload-link names it"


def add(commands: Commands) -> None:
    """Make the command known."""
    init = commands.add_parser(
        "init",
        help="a vehicle to begin with: vehicle.toml and URDF, valid at once",
        description="Asks, on a terminal and without --base; every answer can be given as an option.",
    )
    init.add_argument("directory", type=Path, help="where the files go; made if need be")
    init.add_argument("--from", dest="packaged", metavar="NAME", help="copy a packaged vehicle: rocksat, dymaflex, ...")
    init.add_argument("--name", help="of the vehicle (default: that of the directory)")
    init.add_argument("--base", choices=tuple(KINDS))
    init.add_argument("--urdf", type=Path, help="a URDF at hand: its joints and links; it is copied into the directory")
    imu = "of --urdf, whose axes are the IMU's (default: the base's frames that are called so, or a new frame)"
    init.add_argument("--imu-frame", metavar="LINK", help=imu)
    init.add_argument("--payload-link", metavar="LINK", help="of --urdf, that holds the payload (default: a new link)")
    init.add_argument(
        "--joints",
        metavar="N|NAME,NAME",
        help="how many, or their names from the base outwards (2); of --urdf, those measured: others are fixed",
    )
    init.add_argument("--imu", metavar="KIND", help="on the base (mpu6050); recorded, or none; ? for a list")
    init.add_argument("--encoder", metavar="KIND", help="of every joint (cia406); recorded, ...; ? for a list")
    init.add_argument(
        "--drives", action="store_true", help="what measures the joints moves them too: [drive], and a motion to try"
    )
    init.add_argument("--load-cell", metavar="KIND", help="(none); recorded, ...; ? for a list")
    init.add_argument(
        "--gains", metavar="G,G,...", help="N m in an A of each joint, where currents of its motor were recorded"
    )
    init.add_argument(
        "--thrusters",
        metavar="N|NAME,NAME",
        help=f"of a recorded body without joints on a table (--base {BaseKind.PLANAR}): how many, or frames of "
        "--urdf, x along the force",
    )
    init.add_argument("--force", metavar="N", type=float, default=1.0, help="of each of --thrusters, in newtons (1)")
    init.add_argument("--marker", metavar="LINK", help="of --urdf, that is tracked (default: a new link)")
    init.add_argument("--no-pulse", action="store_true", help="no sync pulse is wired: clocks are then known to ms")
    init.add_argument("--bus", action="append", default=[], metavar="NAME=URL", help="URL of a bus, e.g. can_0=...")
    init.set_defaults(command=_init)


def _init(arguments: argparse.Namespace) -> int:
    from onboard.ground.before.init import pucks, vehicle

    notes: tuple[str, ...] = ()
    if arguments.packaged:
        files = vehicle.copy(arguments.packaged, arguments.directory)
    else:
        if arguments.base is None:
            if not sys.stdin.isatty():
                raise ValueError(f"say what the base is: --base {' or '.join(_WITH_AN_ARM)}; or give --from")
            _ask(arguments)
        if arguments.thrusters is not None:
            return _body(arguments)
        if arguments.base == "pivot":
            return _bed(arguments)
        wanted = _wanted(arguments)
        files = vehicle.make(wanted, arguments.directory)
        notes = wanted.drawn.notes if wanted.drawn else ()
        if wanted.drawn is not None:
            notes += _of_payload(wanted.drawn, wanted.payload_link)
            notes += _of_imu(wanted.drawn, wanted.imu_frame, wanted.further_imus) if wanted.imu != "none" else ()
            notes += (pucks.note(wanted.drawn),) if wanted.pucks else ()
    return _written(files, notes)


def _body(arguments: argparse.Namespace) -> int:
    """A body without joints."""
    from onboard.ground.before.init import body, drawing

    if arguments.base != BaseKind.PLANAR.name:
        where = "by wheels it is moved on a bearing (--base pivot) or freely (docs/free_body.md)"
        raise ValueError(f"--thrusters move a body on a table: --base {BaseKind.PLANAR}, not {arguments.base}; {where}")
    if given := [one for one in ("joints", "encoder", "load_cell", "gains", "imu") if getattr(arguments, one)]:
        raise ValueError(f"--{given[0].replace('_', '-')}: a body by its --thrusters has no arm; leave it out")
    drawn = drawing.read(arguments.urdf, arguments.base, recorded=True) if arguments.urdf else None
    name, marker = arguments.name or arguments.directory.resolve().name, arguments.marker or "marker"
    wanted = body.NewBody(name, tuple(body.names_of(arguments.thrusters)), arguments.force, drawn, marker)
    if arguments.marker and (drawn is None or marker not in drawn.frames):
        raise ValueError(f"the URDF has no link {marker!r}" if drawn else f"{marker!r}: give the --urdf that has it")
    return _written(body.write(wanted, arguments.directory), drawn.notes if drawn else ())


def _bed(arguments: argparse.Namespace) -> int:
    """A body on a spherical air bearing."""
    from onboard.ground.before.init import bed, drawing

    if given := [one for one in ("load_cell", "gains") if getattr(arguments, one)]:
        raise ValueError(f"--{given[0].replace('_', '-')}: a body on a pivot has no arm; leave it out")
    if not arguments.urdf:
        raise ValueError("--base pivot: give the --urdf of the body, base link at the pivot, a joint for each wheel")
    if {one for one in (arguments.imu, arguments.encoder) if one} - {"recorded"}:
        raise ValueError("--base pivot is of recordings: --imu recorded; of devices start by --from spherical_bearing")
    wheels = arguments.joints.split(",") if arguments.joints else ()
    drawn = drawing.read(arguments.urdf, arguments.base, wheels, recorded=True)
    for link in (arguments.imu_frame, arguments.payload_link):
        if link and link not in drawn.frames:
            raise ValueError(f"the URDF has no link {link!r}")
    imu = arguments.imu_frame or (drawn.imus[0] if drawn.imus else "imu_base")
    name = arguments.name or arguments.directory.resolve().name
    files = bed.write(bed.NewBed(name, drawn, imu, arguments.payload_link or ""), arguments.directory)
    proof = () if arguments.payload_link else (_NO_PROOF,)
    return _written(files, (*drawn.notes, *_of_imu(drawn, imu), *proof))


def _written(files: "list[Path]", notes: tuple[str, ...]) -> int:
    """What was written, and what comes next."""
    for path in files:
        print(path)
    for note in notes:
        print(f"note: {note}")
    if "\n[bus." in files[0].read_text(encoding="utf-8"):
        print(f"next: heft hil {files[0]} rehearses it")
        if any(path.name == "motion.csv" for path in files):
            print(f"or, its drives at work: python -m hil_sim.serve_driven {files[0]} --directory DIR, docs/driving.md")
        print(f"then: put your numbers in, and heft preflight {files[0]}")
    else:
        own = "".join(f", or in {path}" for path in files if path.name == "import.toml")
        print("next: put your numbers in; say which column of a recording is what, by")
        print(f"heft import --guess RECORDING --vehicle {files[0]} -o MAPPING{own};")
        print("then heft import MAPPING RECORDING -o logs, and heft identify")
    return OK


def _of_payload(drawn: "DrawnUrdf", link: str) -> tuple[str, ...]:
    """Which link stands for what is held, and which others could be meant."""
    if link in drawn.links:
        return (
            f"link {link} has a mass in the URDF: it is taken for what is held. Name a massless frame of the last link",
        )
    if link in drawn.frames:
        return ()
    tips = " or ".join(map(shlex.quote, drawn.tips))
    others = f"; --payload-link {tips} for a frame of the URDF" if drawn.tips else ""
    return (f"what is held is estimated in a new link {link!r} at the origin of {drawn.last}{others}",)


def _of_imu(drawn: "DrawnUrdf", link: str, further: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Where the IMU is taken to be, and each further one."""
    if link not in drawn.frames:
        return (f"the IMU is put in a new link {link!r} at the origin of {drawn.root}: put its place in",)
    if further:
        each = ", ".join((link, *further))
        return (f"each of {each} is the place and the axes of an IMU; --imu-frame names the one where there is one",)
    others = " or ".join(shlex.quote(one) for one in drawn.imus if one != link)
    return (f"the IMU has the axes and the place of link {link}" + (f"; --imu-frame {others}" if others else ""),)


def _ask(arguments: argparse.Namespace) -> None:
    from onboard.ground.before.init.vehicle import ENCODERS, IMUS, LOAD_CELLS

    known = {"imu": IMUS, "encoder": ENCODERS, "load_cell": LOAD_CELLS}
    answering = _answering(known)
    for option, question, usual in _QUESTIONS:
        if getattr(arguments, option) is None and not (option == "joints" and arguments.urdf):
            choices = f" {', '.join(known[option])}" if option in known else ""
            kind, bus, where = answering.get(option, (usual, "", ""))
            answer = input(f"{question}{choices}{where} [{kind}] ").strip() or kind
            setattr(arguments, option, answer)
            if bus and answer == kind:
                arguments.bus.insert(0, bus)


def _answering(known: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, str, str]]:
    """By option the first kind that answers on a bus of this computer, its bus with the URL, and words of both."""
    import time

    from onboard.flight.check import scan
    from onboard.ground.before.init import seen

    found = dict[str, tuple[str, str, str]]()
    for url in scan.urls():
        with busy(f"looking at {url}"):
            bus = scan.scan(url, time.monotonic_ns, time.sleep)
        for option, kinds in known.items():
            if kind := next((one.kind for one in bus.found if one.kind in kinds), ""):
                words = f"; {kind} answers on {url}"
                found.setdefault(option, (kind, f"{seen.bus_of(kind)}={url}", words))
    return found


def _wanted(arguments: argparse.Namespace) -> "NewVehicle":
    from onboard.ground.before.init import drawing
    from onboard.ground.before.init.vehicle import BASES, ENCODERS, IMUS, LOAD_CELLS, NewVehicle

    encoder, cell = arguments.encoder or "cia406", arguments.load_cell or "none"
    usual = "recorded" if encoder == "recorded" else "mpu6050"
    imu = arguments.imu or ("none" if arguments.base == "fixed" else usual)
    for said, known in ((arguments.base, BASES), (imu, IMUS), (encoder, ENCODERS), (cell, LOAD_CELLS)):
        if said not in known:
            raise ValueError(f"{said!r} is none of {', '.join(known)}" if said != "?" else f"any of {', '.join(known)}")
    joints = arguments.joints or "2"
    names = [f"joint_{n + 1}" for n in range(int(joints))] if joints.isdecimal() else joints.split(",")
    drawn = None
    if arguments.urdf:
        if joints.isdecimal() and arguments.joints:
            raise ValueError(
                "--joints is a number, and --urdf has joints: name those that are measured, or leave it out"
            )
        measured = names if arguments.joints else ()
        drawn = drawing.read(arguments.urdf, arguments.base, measured, recorded=encoder == "recorded")
        names = list(drawn.joints)
    for link in (arguments.imu_frame, arguments.payload_link):
        if link and (drawn is None or link not in drawn.frames):
            raise ValueError(f"the URDF has no link {link!r}" if drawn else f"{link!r}: give the --urdf that has it")
    name = arguments.name or arguments.directory.resolve().name
    urls = dict(bus_and_url(text, "--bus") for text in arguments.bus)
    own = drawn.imus if drawn is not None and drawn.imus else ("imu_base",)
    frames = arguments.imu_frame or own[0], arguments.payload_link or "payload"
    several = imu == "recorded" and KINDS[arguments.base].follows and not arguments.imu_frame
    gains = tuple(float(part) for part in arguments.gains.split(",")) if arguments.gains else ()
    pulse = not arguments.no_pulse
    chosen = tuple(names), imu, encoder, cell, pulse, urls, drawn, *frames, gains
    further = own[1:] if several else ()
    return NewVehicle(name, arguments.base, *chosen, drives=arguments.drives, further_imus=further)
