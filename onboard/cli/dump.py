"""``heft dump`` writes logs as tables for other programs."""

import argparse
import sys
from pathlib import Path

from onboard.cli.common import Commands, load_vehicle, progress, warn, worst

_STANDARD = "mcap"


def add(commands: Commands) -> None:
    """Make the command known."""
    dump = commands.add_parser("dump", help="logs as tables for other programs: csv, parquet, npz, mat")
    dump.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="several: a directory for each")
    dump.add_argument(
        "--to",
        nargs=2,
        metavar=("FORMAT", "DIR"),
        required=True,
        help="csv, parquet, npz or mat; DIR gets a file for each channel; csv -: a channel to stdout; mcap: IMUs, "
        "joint states and transforms as standard ROS 2 messages",
    )
    dump.add_argument("--channel", action="append", help="only this channel (may be repeated)")
    dump.add_argument("--from", dest="start", type=float, metavar="S", help="from S seconds after the first record")
    dump.add_argument("--until", type=float, metavar="S", help="up to S seconds after the first record")
    dump.add_argument("--phase", action="append", default=[], help="only this phase: its code, or 'sweep 1'")
    dump.add_argument("--vehicle", metavar="VEHICLE", help="file or name, for a log that carries none")
    dump.add_argument("--force", action="store_true", help="replace files of the same names")
    kinds = dump.add_mutually_exclusive_group()
    kinds.add_argument("--raw", dest="values", action="store_const", const="raw", help="all as recorded, no SI")
    kinds.add_argument("--si", dest="values", action="store_const", const="si", help="SI, without counts and scales")
    kinds.add_argument(
        "--aligned", type=float, metavar="HZ", help="all signals at common instants of vehicle time, in a table"
    )
    dump.set_defaults(command=_dump, values="both")


def _dump(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.export import opener
    from onboard.ground.log.export.dump import DumpResult, dump
    from onboard.ground.log.tables.flight_tables import FlightTables
    from onboard.ground.log.tables.selection import Selection
    from onboard.recording.format.segments import flights, logs
    from onboard.recording.reader import LogReader

    kind, target = arguments.to
    if kind == _STANDARD:
        chosen = (arguments.channel, arguments.start, arguments.until, arguments.phase, arguments.aligned)
        if target == "-" or any(chosen):
            raise ValueError("--to mcap writes whole flights as standard messages into a directory; drop the selection")
    else:
        opener(kind)  # an unknown format is reported before a missing log
    channels = tuple(arguments.channel) if arguments.channel else None
    selection = Selection(channels, arguments.start, arguments.until, tuple(arguments.phase))
    groups = flights(arguments.logs)
    piped = target == "-"
    vehicle = load_vehicle(arguments.vehicle) if arguments.vehicle else None
    if piped and len(groups) > 1:
        raise ValueError(f"{len(groups)} logs into a pipe: dump each by itself")
    codes: list[int] = []
    force = arguments.force
    with progress() as bar:
        for group, given in zip(groups, logs(arguments.logs), strict=True):
            log = FlightTables(LogReader(given), vehicle)
            name = group[0].stem
            where = sys.stdout.buffer if piped else Path(target) / name if len(groups) > 1 else Path(target)
            result: DumpResult
            if kind == _STANDARD:
                from onboard.ground.log.export.standard import dump_standard

                assert isinstance(where, Path)
                result = dump_standard(log, where, force=force, progress=bar)
            elif arguments.aligned is None:
                result = dump(log, where, selection, kind=kind, values=arguments.values, force=force, progress=bar)
            else:
                from onboard.ground.log.export.aligned import dump_aligned

                result = dump_aligned(log, where, arguments.aligned, selection, kind=kind, force=force, progress=bar)
            for path in result.files:
                print(path)
            warn(result.damage)
            codes.append(result.exit_code)
    return worst(codes)
