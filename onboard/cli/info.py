"""``heft info``: summary of a log on a screen."""

import argparse
from pathlib import Path

from onboard.cli.common import Commands, add_json, progress, show, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    info = commands.add_parser("info", help="summary of a log on a screen")
    info.add_argument("log", type=Path)
    add_json(info)
    info.add_argument("--clocks", type=Path, metavar="PNG", help="plot each clock's residuals, rate and state")
    info.set_defaults(command=_info)


def _info(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.views import info, summary
    from onboard.recording.reader import LogReader

    log = LogReader(arguments.log)
    with progress() as bar:
        about = info.info(log, bar)
        said = summary.summary(log, bar)
    write_json(arguments.json, {**about.as_json(), **said.as_json()})
    show(info.render(about))
    show(summary.render(said))
    if arguments.clocks:
        from onboard.ground.report import clock_plot

        clock_plot(said.clocks, about.start_ns, about.duration_s, arguments.clocks)
    return about.exit_code
