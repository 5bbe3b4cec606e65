"""``heft recover`` copies the readable part of a damaged log into an intact one."""

import argparse
from pathlib import Path

from onboard.cli.common import DAMAGED, FAILED, Commands, add_json, complain, progress, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    recover = commands.add_parser("recover", help="copy the readable part of a damaged log, and list what is lost")
    recover.add_argument("log", type=Path, nargs="+", help="a log, a flight directory, or all segments of a flight")
    recover.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="log to write")
    add_json(recover)
    recover.set_defaults(command=_recover)


def _recover(arguments: argparse.Namespace) -> int:
    from onboard.recording.format.segments import flights, logs
    from onboard.recording.recover import recover

    groups = flights(arguments.log)
    if len(groups) > 1:
        names = ", ".join(group[0].name for group in groups)
        raise ValueError(f"{names} are logs of different flights: recover each by itself, then merge them")
    with progress() as bar:
        task = bar.add_task("recover", total=None)
        found = recover(
            logs(arguments.log)[0], arguments.output, lambda done, size: bar.update(task, completed=done, total=size)
        )
    write_json(arguments.json, found)
    for one in found.damage:
        print(f"damage: {one}")
    for gap in found.gaps:
        print(f"gap: {gap}")
    if found.exit_code == FAILED:
        complain(found.problem or "nothing of the log can be read")
        return FAILED
    for name, rows in found.rows.items():
        print(f"{name}: {rows} rows")
    if found.exit_code == DAMAGED:
        print("some of it is lost: see above")
    else:
        print("lossless: all that was recorded is there" if not found.others else "lossless, for a part of its flight")
    if found.others:
        print(f"segments of the flight that are not in it: {', '.join(path.name for path in found.others)}")
    print(arguments.output)
    return found.exit_code
