"""heft's command line. Thin: arguments in, one call, an exit code out.

Exit codes: 0 done; 1 it ran and failed (nothing identified, a replay that differs, a worker that died); 2 the input
cannot be used (arguments, vehicle file, mapping, no such file); 3 the log is truncated or damaged, and what could be
read was.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

OK, FAILED, BAD_INPUT, DAMAGED = 0, 1, 2, 3


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``heft`` and return its exit code."""
    arguments = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        return command(arguments)
    except KeyboardInterrupt:
        return 130
    except (OSError, ValueError) as error:
        # every error that bad input can cause is one of these by its second parent; a bug is anything else
        if isinstance(error, BrokenPipeError):
            return OK
        sys.stderr.write(f"heft: {error}\n")
        return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="heft",
        description="Weigh what an arm holds: acquisition, log and inertial identification for free-flying servicers.",
        epilog="exit codes: 0 done, 1 ran and failed, 2 bad input, 3 log damaged but read",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    fly = commands.add_parser("fly", help="fly a vehicle: acquire, record, estimate")
    fly.add_argument("vehicle", type=Path, help="vehicle.toml")
    fly.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    fly.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds")
    fly.add_argument("--url", action="append", default=[], metavar="BUS=URL", help="open BUS at URL instead")
    fly.set_defaults(command=_fly)

    hil = commands.add_parser("hil", help="fly a scenario against simulated devices")
    hil.add_argument("scenario", help="a packaged scenario: rocksat")
    hil.add_argument("--seed", type=int, default=1, help="of everything random in the scenario (default 1)")
    hil.add_argument("--realtime", action="store_true", help="devices and flight app as processes, on the real clock")
    hil.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON too")
    hil.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    hil.set_defaults(command=_hil)

    info = commands.add_parser("info", help="what a log holds, on one screen")
    info.add_argument("log", type=Path)
    info.set_defaults(command=_info)

    dump = commands.add_parser("dump", help="a log as files for other programs")
    dump.add_argument("log", type=Path)
    dump.add_argument("--to", nargs=2, metavar=("FORMAT", "DIR"), required=True, help="csv DIR: one file a channel")
    dump.add_argument("--channel", action="append", help="only this channel (may be repeated)")
    dump.set_defaults(command=_dump)

    replay = commands.add_parser("replay", help="estimate again from a log and compare bit for bit")
    replay.add_argument("log", type=Path)
    replay.set_defaults(command=_replay)

    identify = commands.add_parser("identify", help="identify from logs, with the estimator that flies")
    identify.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    identify.add_argument("--vehicle", required=True, help="vehicle.toml, or the name of a packaged vehicle")
    identify.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON too")
    identify.set_defaults(command=_identify)

    importer = commands.add_parser("import", help="bring recordings from elsewhere into logs")
    importer.add_argument("mapping", help="mapping TOML, or the name of a packaged one: tudelft")
    importer.add_argument("source", type=Path, help="a recording, or a directory of them")
    importer.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    importer.set_defaults(command=_import)
    return parser


def _console() -> "Console":
    from rich.console import Console

    return Console()


def _next_log(directory: str, name: str) -> Path:
    """The first free ``NAME-NNN.mcap``."""
    return next(path for n in range(1, 100_000) if not (path := Path(directory) / f"{name}-{n:03d}.mcap").exists())


def _fly(arguments: argparse.Namespace) -> int:
    from onboard import config
    from onboard.flight import runner

    urls = dict(_bus_and_url(text) for text in arguments.url)
    vehicle = config.load(arguments.vehicle).with_urls(urls)
    log = arguments.log or _next_log(vehicle.file.recording.directory, vehicle.file.vehicle.name)
    try:
        flight = runner.fly(vehicle, log, duration_s=arguments.duration)
    except runner.FlightError as error:
        sys.stderr.write(f"heft: {error}\n")
        return FAILED
    print(flight.log)
    for name in flight.died:
        sys.stderr.write(f"heft: the {name} worker died; its message stands above, and an event in the log\n")
    return FAILED if flight.died else OK


def _bus_and_url(text: str) -> tuple[str, str]:
    bus, separator, url = text.partition("=")
    if not separator:
        raise ValueError(f"--url {text}: write BUS=URL, e.g. can_0=can+socketcan://can0?bitrate=500000")
    return bus, url


def _hil(arguments: argparse.Namespace) -> int:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from hil_sim.mission import open_in_process
    from onboard import config
    from onboard.flight import hil, runner
    from onboard.offline import table

    console = _console()
    name, seed = arguments.scenario, arguments.seed
    vehicle = config.load(config.packaged(name))
    log = arguments.log or _next_log(vehicle.file.recording.directory, name)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(f"{name}, seed {seed}", total=1.0)
        if arguments.realtime:
            serve = ["-m", "hil_sim.serve", name, "--seed", str(seed)]
            try:
                flown = hil.fly_realtime(vehicle, serve, log, lambda done: progress.update(task, completed=done))
            except runner.FlightError as error:
                sys.stderr.write(f"heft: {error}\n")
                return FAILED
        else:
            world, urls = open_in_process(name, seed)
            with world:
                flown = hil.fly_simulated(vehicle, world, urls, log, lambda done: progress.update(task, completed=done))
    result = table.result(flown)
    console.print(table.render(result))
    console.print(f"log: {log}", soft_wrap=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return OK if result["identified"] and result["accounted"] else FAILED


def _info(arguments: argparse.Namespace) -> int:
    from onboard.offline import info, summary
    from onboard.recording.reader import LogReader

    about = info.info(arguments.log)
    _console().print(info.render(about))
    _console().print(summary.render(LogReader(arguments.log)))
    return about.exit_code


def _dump(arguments: argparse.Namespace) -> int:
    from rich.progress import Progress

    from onboard.offline.dump import dump

    kind, directory = arguments.to
    if kind != "csv":
        raise ValueError(f"--to {kind}: known formats: csv")
    with Progress(console=_console(), transient=True) as progress:
        result = dump(arguments.log, Path(directory), arguments.channel, progress=progress)
    for path in result.files:
        print(path)
    _warn(result.damage)
    return result.exit_code


def _replay(arguments: argparse.Namespace) -> int:
    from onboard.offline.replay import replay

    result = replay(arguments.log)
    print(result.summary)
    _warn(result.damage)
    if not result.identical:
        return FAILED
    return DAMAGED if result.damage else OK


def _identify(arguments: argparse.Namespace) -> int:
    from rich.progress import Progress

    from onboard import config
    from onboard.offline import identify

    path = Path(arguments.vehicle)
    vehicle = config.load(path if path.suffix == ".toml" else config.packaged(arguments.vehicle))
    console = _console()
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("identify", total=len(arguments.logs))
        found = identify.identify(vehicle, arguments.logs, lambda done: progress.update(task, completed=done))
    console.print(identify.render(found))
    if arguments.json:
        arguments.json.write_text(json.dumps(found.as_json(), indent=1) + "\n", encoding="utf-8")
    _warn(found.damage)
    if not found.supported:
        return FAILED
    return DAMAGED if found.damage else OK


def _import(arguments: argparse.Namespace) -> int:
    from rich.progress import Progress

    from onboard.offline.importer import import_recordings

    with Progress(console=_console(), transient=True) as progress:
        imported = import_recordings(arguments.mapping, arguments.source, arguments.output, progress=progress)
    for one in imported:
        print(f"{one.path}  {one.rows} rows")
    return OK


def _warn(damage: Sequence[object]) -> None:
    for one in damage:
        sys.stderr.write(f"heft: warning: {one}\n")


if __name__ == "__main__":
    sys.exit(main())
