"""``heft identify``: identification from logs with the onboard estimator."""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli import common

if TYPE_CHECKING:
    from collections.abc import Sequence

    from onboard import config
    from onboard.ground.identify.kinds.identified import Identified
    from onboard.recording.reader import LogReader


def add(commands: common.Commands) -> None:
    """Make the command known."""
    identify = commands.add_parser("identify", help="identify from logs with the onboard estimator")
    identify.add_argument("logs", type=Path, nargs="*", metavar="LOG")
    identify.add_argument(
        "--vehicle", help="vehicle.toml, or the name of a packaged vehicle (default: that of the logs)"
    )
    identify.add_argument(
        "--parameters", action="store_true", help="show the base parameters of the vehicle in symbols"
    )
    identify.add_argument(
        "--method",
        choices=("rows", "exiddm"),
        help="by rows, or by maximum likelihood (default: the vehicle file's)",
    )
    identify.add_argument(
        "--from", dest="earlier", type=Path, metavar="LOG", help="start from the last estimate of LOG"
    )
    identify.add_argument(
        "--predict", type=Path, action="append", default=[], metavar="LOG", help="predict LOG's rows from the first log"
    )
    identify.add_argument("--urdf-in", type=Path, metavar="FILE", help="the vehicle's URDF, in place of its file's")
    identify.add_argument("--urdf", type=Path, metavar="FILE", help="write a log's bodies into its URDF")
    identify.add_argument(
        "--fit-drawing",
        type=Path,
        metavar="DIR",
        help="write vehicle.toml and URDF with a log's estimate of the arm's links, with sigmas, for other recordings",
    )
    identify.add_argument("--budget", action="store_true", help="show what the interval of each answer is made of")
    common.add_json(identify)
    identify.add_argument("--report", type=Path, metavar="FILE", help="also write a page with the residuals")
    identify.set_defaults(command=_identify)


def _identify(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.tables.vehicle_file import flown_by
    from onboard.recording.reader import LogReader

    if arguments.vehicle:
        return _identify_with(common.load_vehicle(arguments.vehicle, arguments.urdf_in), arguments)
    if arguments.urdf_in:
        raise ValueError("--urdf-in is the URDF of the --vehicle; logs that carry their vehicle carry its URDF too")
    if not arguments.logs:
        raise ValueError("name a log to identify from, or the --vehicle whose --parameters to show")
    with tempfile.TemporaryDirectory() as directory:
        logs = [LogReader(log, kept=1.0 / len(arguments.logs)) for log in arguments.logs]
        return _identify_with(flown_by(logs, Path(directory)), arguments, logs)


def _identify_with(
    vehicle: "config.Vehicle", arguments: argparse.Namespace, logs: "Sequence[Path | LogReader]" = ()
) -> int:
    from onboard.ground.identify import identify, identify_view
    from onboard.ground.identify.replay import warm_start as carrying
    from onboard.recording.reader import LogReader

    if arguments.method:
        vehicle = identify.by_method(vehicle, arguments.method)
    if arguments.earlier:
        vehicle = carrying.go_on(vehicle, LogReader(arguments.earlier))
    if arguments.parameters:
        return _parameters(vehicle, arguments)
    if not arguments.logs:
        raise ValueError("no log to identify from; name a log, or ask for --parameters")
    _check_outputs(vehicle, arguments)
    with common.progress() as bar:
        task = bar.add_task("identify", total=len(arguments.logs) if len(arguments.logs) > 1 else None)
        found = identify.identify(vehicle, logs or arguments.logs, lambda done: bar.update(task, completed=done))
    if arguments.predict:
        made = tuple((log, identify.predict(found.vehicle, found.logs[0], log)) for log in arguments.predict)
        found = replace(found, predicted=made)
    common.show(identify_view.render(found))
    if arguments.budget:
        common.show(identify_view.budgets(found))
    common.write_json(arguments.json, found.as_json())
    if arguments.report:
        from onboard.ground.report import identified

        identified.write(found, arguments.report)
        print(arguments.report)
    common.warn(found.damage)
    if found.usable:
        _write_vehicles(vehicle, found.logs[0], arguments)
    if not found.usable:
        return common.FAILED
    return common.DAMAGED if found.damage else common.OK


def _check_outputs(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> None:
    if arguments.urdf and len(arguments.logs) > 1:
        raise ValueError("a URDF holds the result of a single log; give --urdf with a single log")
    if arguments.fit_drawing:
        if len(arguments.logs) > 1:
            raise ValueError("a drawing is fitted to a single log; give only that, or heft merge the logs first")
        from onboard.ground.identify import fitted_file

        fitted_file.require_fittable(vehicle, arguments.fit_drawing)


def _write_vehicles(vehicle: "config.Vehicle", found: "Identified", arguments: argparse.Namespace) -> None:
    if arguments.urdf:
        from onboard.ground.identify import identify

        arguments.urdf.write_text(identify.urdf(vehicle, found), encoding="utf-8")
    if arguments.fit_drawing:
        from onboard.ground.identify import fitted_file

        for path in fitted_file.write(vehicle, found, arguments.fit_drawing):
            print(path)
        print(f"note: for other recordings of this arm; by that file {arguments.logs[0]} would count twice")


def _parameters(vehicle: "config.Vehicle", arguments: argparse.Namespace) -> int:
    from onboard.ground.before.mechanics import parameters

    if arguments.logs:
        raise ValueError("--parameters depend on the vehicle only; leave the logs out")
    found = parameters.parameters(vehicle)
    common.show(parameters.render(found))
    common.write_json(arguments.json, found.as_json())
    return common.OK
