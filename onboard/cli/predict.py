"""``heft predict``: base motion predicted from the joints beside what the gyro measured (figure 4.14)."""

import argparse
import math
import tempfile
from pathlib import Path

from onboard.cli.common import DAMAGED, OK, Commands, add_json, busy, load_vehicle, show, warn, write_json

_METHODS = ("exiddm", "virtual_manipulator", "generalized_jacobian")


def add(commands: Commands) -> None:
    """Make the command known."""
    predict = commands.add_parser("predict", help="predict a log's base motion from its joints, beside the gyro")
    predict.add_argument("log", type=Path, metavar="LOG")
    predict.add_argument("--method", choices=_METHODS, action="append", help="derivation; repeatable (default: all)")
    predict.add_argument("--vehicle", help="vehicle.toml, or a packaged vehicle (default: that of the log)")
    which = predict.add_mutually_exclusive_group()
    which.add_argument(
        "--urdf", type=Path, metavar="FILE", help="bodies to predict with, as heft identify --urdf writes"
    )
    which.add_argument("--drawn", action="store_true", help="predict with the vehicle's URDF, whatever was identified")
    predict.add_argument("--seconds", type=float, default=30.0, metavar="S", help="of the interval (default 30)")
    add_json(predict)
    predict.add_argument("--figure", type=Path, metavar="FILE", help="also draw it, as SVG or PNG by its ending")
    predict.set_defaults(command=_predict)


def _predict(arguments: argparse.Namespace) -> int:
    from onboard.dynamics.mechanics.momentum_form import Method
    from onboard.dynamics.model.errors import ModelError
    from onboard.ground.identify.base_motion.flown import predict
    from onboard.ground.log.tables.vehicle_file import vehicle_of
    from onboard.ground.report import base_motion as view
    from onboard.recording.reader import LogReader

    seconds: float = arguments.seconds
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ValueError(f"--seconds {seconds:g}: give how long, above 0")
    if arguments.figure and arguments.figure.suffix not in (".svg", ".png"):
        raise ValueError(f"--figure {arguments.figure}: name a .svg or a .png file")
    log = LogReader(arguments.log)
    with tempfile.TemporaryDirectory() as directory:
        vehicle = load_vehicle(arguments.vehicle) if arguments.vehicle else vehicle_of(log, Path(directory))
        methods = [Method(name) for name in dict.fromkeys(arguments.method or _METHODS)]
        try:
            with busy(f"predict {arguments.log.name}"):
                found = predict(vehicle, log, methods, seconds, arguments.urdf, drawn=arguments.drawn)
        except ModelError as error:
            raise ValueError(str(error)) from error
    show(view.render(found))
    write_json(arguments.json, found.as_json())
    if arguments.figure:
        view.draw(found, arguments.figure)
        print(arguments.figure)
    warn(log.damage)
    return DAMAGED if log.damage else OK
