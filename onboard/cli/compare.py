"""``heft compare`` shows flights side by side."""

import argparse
import json
from pathlib import Path

from onboard.cli.common import DAMAGED, OK, Commands, progress, show, warn


def add(commands: Commands) -> None:
    """Make the command known."""
    compare = commands.add_parser("compare", help="flights side by side: answers, whether they agree, trends")
    compare.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="in the order flown")
    compare.add_argument("--report", type=Path, metavar="FILE", help="write a page with intervals and trends too")
    compare.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON too")
    compare.set_defaults(command=_compare)


def _compare(arguments: argparse.Namespace) -> int:
    from onboard.offline.views.compare import compare, render
    from onboard.recording.reader import LogReader
    from onboard.recording.segments import flights

    groups = flights(arguments.logs)
    with progress() as bar:
        found = compare([LogReader(group[0] if len(group) == 1 else group) for group in groups], bar)
    show(render(found))
    if arguments.json:
        arguments.json.write_text(json.dumps(found.as_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if arguments.report:
        from onboard.offline.report import side_by_side

        side_by_side.write(found, arguments.report)
        print(arguments.report)
    warn(found.damage)
    return DAMAGED if found.damage else OK
