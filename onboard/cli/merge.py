"""``heft merge`` joins the logs of several recorders of the same flight, or recordings made one after the other."""

import argparse
from pathlib import Path

from onboard.cli.common import DAMAGED, OK, Commands, add_json, progress, warn, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    merge = commands.add_parser("merge", help="merge the logs of several recorders of a flight, or of several runs")
    merge.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    merge.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="log to write")
    merge.add_argument(
        "--rename", action="store_true", help="prefix channels that several logs have with the name of their log"
    )
    merge.add_argument(
        "--align",
        action="append",
        default=[],
        metavar="LOG=S[,RATE]",
        help="put LOG on the first log's clock: its time x RATE + S seconds (as printed by heft resync)",
    )
    merge.add_argument(
        "--in-turn",
        metavar="CHANNEL",
        help="recordings made in turn, e.g. an arm without its load and with it: CHANNEL is added, and is "
        "1 in the first, 2 in the second, ...: a phase channel",
    )
    add_json(merge)
    merge.set_defaults(command=_merge)


def _merge(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.rescue.merge import RecorderLog, in_turn, merge
    from onboard.recording.format.segments import flights, logs

    clocks = dict(_clock(text) for text in arguments.align)
    groups = flights(arguments.logs)
    names = [group[0].stem for group in groups]
    if unknown := sorted(set(clocks) - set(names)):
        raise ValueError(f"--align {unknown[0]}: the logs are {', '.join(names)}")
    if twice := sorted({name for name in clocks if names.count(name) > 1}):
        raise ValueError(f"--align {twice[0]}: two logs are called so; rename a file")
    whole = [one if isinstance(one, Path) else None for one in logs(arguments.logs)]
    parts = [
        RecorderLog(group, *clocks.get(name, (0, 1.0)), whole=one)
        for group, name, one in zip(groups, names, whole, strict=True)
    ]
    if arguments.in_turn and (arguments.rename or arguments.align):
        raise ValueError(
            "--in-turn joins recordings of the same channels, whose times are separate: leave the others out"
        )
    with progress() as bar:
        if arguments.in_turn:
            made = in_turn(parts, arguments.in_turn, arguments.output, progress=bar)
        else:
            made = merge(parts, arguments.output, rename=arguments.rename, progress=bar)
    write_json(arguments.json, made)
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
