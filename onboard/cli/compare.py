"""``heft compare`` shows flights side by side."""

import argparse
from pathlib import Path

from onboard.cli.common import DAMAGED, OK, Commands, add_json, progress, show, warn, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    compare = commands.add_parser("compare", help="flights side by side: answers, whether they agree, trends")
    compare.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="in the order flown")
    compare.add_argument("--report", type=Path, metavar="FILE", help="write a page with intervals and trends too")
    add_json(compare)
    compare.set_defaults(command=_compare)


def _compare(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.views.compare import compare, render
    from onboard.recording.format.segments import logs
    from onboard.recording.reader import LogReader

    with progress() as bar:
        found = compare([LogReader(one) for one in logs(arguments.logs)], bar)
    show(render(found))
    write_json(arguments.json, found.as_json())
    if arguments.report:
        from onboard.ground.report import side_by_side

        side_by_side.write(found, arguments.report)
        print(arguments.report)
    warn(found.damage)
    return DAMAGED if found.damage else OK
