"""``heft recover``, ``resync`` and ``merge``: one whole log out of a damaged one, or out of several."""

import argparse
from pathlib import Path
from typing import Any

from onboard.cli.common import DAMAGED, FAILED, OK, complain, console, load_vehicle, progress, warn

Commands = Any


def add(commands: Commands) -> None:
    """Make the commands known."""
    recover = commands.add_parser("recover", help="what can be read of a damaged log, as a whole one, and what is lost")
    recover.add_argument("log", type=Path, nargs="+", help="a log, a flight directory, or all segments of one flight")
    recover.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="log to write")
    recover.set_defaults(command=_recover)

    resync = commands.add_parser("resync", help="find how the clocks of several recorders' logs lie, from the motion")
    resync.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="logs of one flight; one with an IMU")
    resync.add_argument("--vehicle", metavar="VEHICLE", help="file or name: which channel is what, and the model")
    resync.add_argument(
        "--peak-hz", type=float, default=1.0, help="where the motion is liveliest (1); the model needs none"
    )
    resync.add_argument("--rate-limit", type=float, default=0.02, help="largest error of a clock's rate (0.02)")
    resync.add_argument("--shocks", action="store_true", help="compare taps of a mallet instead; good to milliseconds")
    resync.add_argument("-o", "--output", type=Path, metavar="FILE", help="merge the logs into FILE as well")
    resync.add_argument("--json", action="store_true", help="machine-readable")
    resync.set_defaults(command=_resync)

    merge = commands.add_parser("merge", help="the logs of several recorders of one flight as one")
    merge.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    merge.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="log to write")
    merge.add_argument(
        "--rename", action="store_true", help="give channels that several logs have the name of their log in front"
    )
    merge.add_argument(
        "--align",
        action="append",
        default=[],
        metavar="LOG=S[,RATE]",
        help="put LOG on the first log's clock: its time x RATE + S seconds (as heft resync says)",
    )
    merge.set_defaults(command=_merge)


def _recover(arguments: argparse.Namespace) -> int:
    from onboard.recording.recover import recover
    from onboard.recording.segments import flights

    groups = flights(arguments.log)
    if len(groups) > 1:
        names = ", ".join(group[0].name for group in groups)
        raise ValueError(f"{names} are logs of different flights: recover them one by one, then merge them")
    with progress() as bar:
        task = bar.add_task("recover", total=None)
        found = recover(groups[0], arguments.output, lambda done, size: bar.update(task, completed=done, total=size))
    for one in found.damage:
        print(f"damage: {one}")
    for gap in found.gaps:
        print(f"gap: {gap}")
    if found.exit_code == FAILED:
        complain(found.problem or "nothing of the log can be read")
        return FAILED
    for name, rows in found.rows.items():
        print(f"{name}: {rows} rows")
    print({OK: "lossless: all that was recorded is there", DAMAGED: "some of it is lost: see above"}[found.exit_code])
    print(arguments.output)
    return found.exit_code


def _resync(arguments: argparse.Namespace) -> int:
    import json

    from onboard.offline.merge import Part, merge
    from onboard.offline.resync import render, resync
    from onboard.recording.reader import LogReader
    from onboard.recording.segments import flights
    from onboard.timebase.resync import ResyncError

    vehicle = load_vehicle(arguments.vehicle) if arguments.vehicle else None
    groups = flights(arguments.logs)
    try:
        logs = [LogReader(group) for group in groups]
        placed = resync(logs, vehicle, arguments.peak_hz, arguments.rate_limit, arguments.shocks)
    except ResyncError as error:
        complain(error)
        return FAILED
    if arguments.json:
        print(json.dumps([one.as_json() for one in placed], default=str))
    else:
        console().print(render(placed))
    if arguments.output:
        clocks = {one.log: (round(one.shift_s * 1e9), 1.0 + one.rate) for one in placed}
        parts = [Part(group, *clocks.get(group[0], (0, 1.0))) for group in groups]
        merge(sorted(parts, key=lambda part: part.segments[0] in clocks), arguments.output)
        print(arguments.output)
    return OK


def _merge(arguments: argparse.Namespace) -> int:
    from onboard.offline.merge import Part, merge
    from onboard.recording.segments import flights

    clocks = dict(_clock(text) for text in arguments.align)
    groups = flights(arguments.logs)
    names = [group[0].stem for group in groups]
    if unknown := sorted(set(clocks) - set(names)):
        raise ValueError(f"--align {unknown[0]}: the logs are {', '.join(names)}")
    parts = [Part(group, *clocks.get(name, (0, 1.0))) for group, name in zip(groups, names, strict=True)]
    with progress() as bar:
        made = merge(parts, arguments.output, rename=arguments.rename, progress=bar)
    for name, rows in made.rows.items():
        print(f"{name}: {rows} rows")
    print(arguments.output)
    warn(made.warnings)
    warn(made.damage)
    return DAMAGED if made.damage else OK


def _clock(text: str) -> tuple[str, tuple[int, float]]:
    name, _, numbers = text.rpartition("=")
    shift, _, rate = numbers.partition(",")
    try:
        clock = round(float(shift) * 1e9), float(rate or 1.0)
    except ValueError:
        name = ""
    if not name:
        raise ValueError(f"--align {text}: write LOG=SECONDS or LOG=SECONDS,RATE, e.g. imu=-1.25,1.00002")
    return Path(name).stem, clock
