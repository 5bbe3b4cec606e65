"""``heft report`` writes a self-contained HTML page about a flight."""

import argparse
from pathlib import Path

from onboard.cli.common import DAMAGED, OK, Commands, complain, load_vehicle, progress, warn


def add(commands: Commands) -> None:
    """Make the command known."""
    report = commands.add_parser("report", help="write a self-contained HTML page about a flight")
    report.add_argument("log", type=Path)
    report.add_argument("-o", "--output", type=Path, metavar="FILE", help="page to write (default: LOG.html)")
    report.add_argument("--vehicle", metavar="VEHICLE", help="file or name, for a log that carries none")
    report.set_defaults(command=_report)


def _report(arguments: argparse.Namespace) -> int:
    from onboard.ground.drawing.gallery import zooms
    from onboard.ground.report import report

    output = arguments.output or arguments.log.with_suffix(".html")
    if output.suffix not in (".html", ".htm"):
        raise ValueError(f"{output}: a report is an HTML page; give -o FILE.html")
    vehicle = load_vehicle(arguments.vehicle) if arguments.vehicle else None
    with progress() as bar:
        damage = report(arguments.log, output, bar, vehicle)
    print(output)
    if not zooms():
        complain("the figures are drawings that do not zoom; for those that do: pip install bokeh")
    warn(damage)
    return DAMAGED if damage else OK
