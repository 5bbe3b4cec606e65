"""``heft resync`` aligns the clocks of several recorders by the motion."""

import argparse
from pathlib import Path

from onboard.cli import common


def add(commands: common.Commands) -> None:
    """Make the command known."""
    resync = commands.add_parser("resync", help="find how the clocks of several recorders' logs lie, from the motion")
    resync.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="logs of a flight; any has an IMU")
    resync.add_argument("--vehicle", metavar="VEHICLE", help="file or name: which channel is what, and the model")
    resync.add_argument(
        "--peak-hz", type=float, default=1.0, help="frequency of the strongest motion, Hz (1); not used with a model"
    )
    resync.add_argument("--rate-limit", type=float, default=0.02, help="largest error of a clock's rate (0.02)")
    resync.add_argument("--shocks", action="store_true", help="compare taps of a mallet instead; good to milliseconds")
    resync.add_argument("-o", "--output", type=Path, metavar="FILE", help="merge the logs into FILE as well")
    common.add_json(resync)
    resync.set_defaults(command=_resync)


def _resync(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.rescue.merge import RecorderLog, merge
    from onboard.ground.log.rescue.resync import render, resync
    from onboard.recording.format.segments import flights
    from onboard.recording.format.segments import logs as named
    from onboard.recording.reader import LogReader
    from onboard.timebase.resync import ResyncError

    vehicle = common.load_vehicle(arguments.vehicle) if arguments.vehicle else None
    groups = flights(arguments.logs)
    try:
        logs = [LogReader(one) for one in named(arguments.logs)]
        with common.busy("resync") as told:
            placed = resync(logs, vehicle, arguments.peak_hz, arguments.rate_limit, arguments.shocks, told)
    except ResyncError as error:
        common.complain(error)
        return common.FAILED
    common.show(render(placed))
    common.write_json(arguments.json, [one.as_json() for one in placed])
    if arguments.output:
        clocks = {one.log: (round(one.shift_s * 1e9), 1.0 + one.rate) for one in placed}
        whole = [one if isinstance(one, Path) else None for one in named(arguments.logs)]
        parts = [
            RecorderLog(group, *clocks.get(group[0], (0, 1.0)), whole=one)
            for group, one in zip(groups, whole, strict=True)
        ]
        with common.progress() as bar:
            merge(sorted(parts, key=lambda part: part.segments[0] in clocks), arguments.output, progress=bar)
        print(arguments.output)
    return common.OK
