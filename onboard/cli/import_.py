"""``heft import`` converts foreign recordings to logs."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from onboard.cli.common import OK, Commands, add_json, busy, load_vehicle, progress, write_json

if TYPE_CHECKING:
    from onboard.ground.log.bring_in.guess.propose import Names


def add(commands: Commands) -> None:
    """Make the command known."""
    importer = commands.add_parser(
        "import",
        help="convert foreign recordings to logs, or propose a mapping (--guess)",
        description="Two steps: --guess FILE -o mapping.toml; look at it; then mapping.toml FILE -o logs.",
    )
    importer.add_argument(
        "mapping", nargs="?", help="mapping TOML, or the name of a packaged mapping: tudelft, staubli_tx40, kuka_lwr4"
    )
    importer.add_argument("source", type=Path, nargs="?", help="a recording, or a directory of them")
    importer.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="of the logs; the mapping's file with --guess"
    )
    importer.add_argument(
        "--guess", type=Path, metavar="FILE", help="propose a mapping for a CSV, MAT, NPZ, ROS bag, MCAP or ULog"
    )
    importer.add_argument("--vehicle", metavar="FILE", help="with --guess: name the channels like its devices")
    add_json(importer)
    importer.set_defaults(command=_import)


def _import(arguments: argparse.Namespace) -> int:
    from onboard.ground.log.bring_in.importer import import_recordings

    if arguments.guess is not None:
        return _guess(arguments)
    if arguments.mapping is None or arguments.source is None or arguments.output is None:
        raise ValueError("give MAPPING SOURCE -o DIR, or --guess FILE for a mapping to begin with")
    if arguments.vehicle is not None:
        raise ValueError("--vehicle names the channels that --guess proposes: give it with --guess")
    with progress() as bar:
        imported = import_recordings(arguments.mapping, arguments.source, arguments.output, progress=bar)
    write_json(arguments.json, imported)
    for one in imported:
        print(f"{one.path}  {one.rows} rows")
        for text in one.left_out:
            print(f"note: {text}")
    return OK


def _guess(arguments: argparse.Namespace) -> int:
    import os

    from onboard.ground.log.bring_in.guess.propose import Names, propose

    if arguments.mapping is not None:
        raise ValueError("--guess FILE makes the mapping: give no mapping beside it")
    named = _names(arguments.vehicle) if arguments.vehicle is not None else Names()
    with busy(f"{arguments.guess} is looked at"):
        found = propose(arguments.guess, named)
    if arguments.output is None:
        sys.stdout.write(found.text)
    else:
        mode = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        with os.fdopen(os.open(arguments.output, mode, 0o666), "w", encoding="utf-8") as file:
            file.write(found.text)
        print(f"{arguments.output}: {len(found.channels)} channels: {', '.join(found.channels)}")
        for doubt in found.doubts:
            print(f"doubtful: {doubt}")
        print(f"next: look at it, then heft import {arguments.output} {arguments.guess} -o logs")
    write_json(arguments.json, found._asdict())
    return OK


def _names(vehicle: str) -> "Names":
    from onboard.devices.recorded import PoseKeys, thrusters_among
    from onboard.devices.roles import TorqueKeys
    from onboard.flight.estimate.readings.roles import roles_of
    from onboard.ground.identify.replay.as_recorded import IN_TURN
    from onboard.ground.log.bring_in.guess.body import BodyChannels
    from onboard.ground.log.bring_in.guess.propose import Names
    from onboard.ground.log.bring_in.guess.wheels import WheelChannels

    loaded = load_vehicle(vehicle)
    roles, devices = roles_of(loaded), loaded.file.device
    thrusters, phases = thrusters_among(devices), loaded.file.estimation.phases
    torques = [(cell.channel, cell.keys) for cell in roles.cells if isinstance(cell.keys, TorqueKeys)]
    gains = [(keys.gain_N_m_A, keys.relative_sigma) for _, keys in torques]
    return Names(
        tuple(imu.channels[0] for imu in roles.imus),
        tuple(joint.channel for joint in roles.joints if not joint.is_rate),
        tuple(channel for channel, _ in torques),
        tuple((gain, sigma) for gain, sigma in gains if gain) if torques and all(gain for gain, _ in gains) else (),
        BodyChannels(
            tuple(thrusters),
            any(one.reads == "on_time" for one in thrusters.values()),
            next((name for name, one in devices.items() if isinstance(one, PoseKeys)), ""),
        ),
        WheelChannels(
            tuple(joint.channel for joint in roles.joints if joint.is_rate),
            phases.channel if phases else "",
            IN_TURN if torques and phases is None and IN_TURN not in devices else "",
        ),
    )
