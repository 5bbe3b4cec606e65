"""``heft info`` and ``heft report``."""

import argparse
import json
from pathlib import Path
from typing import Any

from onboard.cli.common import DAMAGED, OK, console, progress, warn

Commands = Any


def add(commands: Commands) -> None:
    """Make the commands known."""
    info = commands.add_parser("info", help="what a log holds, on one screen")
    info.add_argument("log", type=Path)
    info.add_argument("--json", type=Path, metavar="FILE", help="write it as JSON too; - writes nothing else to stdout")
    info.add_argument("--clocks", type=Path, metavar="PNG", help="plot each clock's residuals, rate and state")
    info.set_defaults(command=_info)

    report = commands.add_parser("report", help="a flight as one self-contained HTML page")
    report.add_argument("log", type=Path)
    report.add_argument("-o", "--output", type=Path, metavar="FILE", help="page to write (default: LOG.html)")
    report.set_defaults(command=_report)


def _info(arguments: argparse.Namespace) -> int:
    from onboard.offline import info, summary
    from onboard.recording.reader import LogReader

    log = LogReader(arguments.log)
    about = info.info(log)
    said = summary.summary(log)
    if arguments.json:
        text = json.dumps({**about.as_json(), **said.as_json()}, indent=1, allow_nan=False) + "\n"
        if str(arguments.json) == "-":
            print(text, end="")
        else:
            arguments.json.write_text(text, encoding="utf-8")
    if str(arguments.json) != "-":
        console().print(info.render(about))
        console().print(summary.render(said))
    if arguments.clocks:
        from onboard.offline.report import clock_plot

        clock_plot(said.clocks, about.start_ns, about.duration_s, arguments.clocks)
    return about.exit_code


def _report(arguments: argparse.Namespace) -> int:
    from onboard.offline.report import report

    output = arguments.output or arguments.log.with_suffix(".html")
    with progress() as bar:
        damage = report(arguments.log, output, bar)
    print(output)
    warn(damage)
    return DAMAGED if damage else OK
