"""``heft telemetry`` writes the mission database of the downlink, reads its packets, and sends those of a log."""

import argparse
import json
import secrets
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config
    from onboard.config.telemetry import Telemetry
    from onboard.telemetry.commander import Commander
    from onboard.telemetry.link import Address

_FRAME_S = 0.25
_COMMANDS_S = 30.0  # that reports on commands are waited for


def add(commands: common.Commands) -> None:
    """Make the command known."""
    telemetry = commands.add_parser(
        "telemetry",
        help="mission database and packets of the downlink",
        description="Packets of heft fly --telemetry; docs/ground.md tells how.",
    )
    telemetry.add_argument(
        "of", nargs="?", metavar="VEHICLE|LOG", help="whose [telemetry] it is (default: that of an empty file)"
    )
    what = telemetry.add_mutually_exclusive_group(required=True)
    what.add_argument("--xtce", type=Path, metavar="DIR", help="write the mission database (XTCE 1.2) into DIR")
    what.add_argument("--decode", metavar="FILE|LINK", help="read packets of a file, udp://HOST:PORT or serial:///...")
    what.add_argument("--send", metavar="LINK", help="send what the downlink of LOG would have sent")
    telemetry.add_argument("--json-lines", action="store_true", help="with --decode: every packet as a line of JSON")
    telemetry.add_argument("--duration", type=float, metavar="S", help="with --decode of a port: end after S seconds")
    telemetry.add_argument(
        "--command",
        action="append",
        default=[],
        metavar="WHAT",
        dest="asked",
        help='with --decode of a port: ask it of the flight: "mark 3", stop, "span -60 -30" (s before now, or UTC); '
        "only what its [telemetry] commands arms",
    )
    telemetry.add_argument("--source", type=int, default=0, metavar="N", help="with --command: who asks (default 0)")
    common.add_page(telemetry, "with --decode what comes down")
    telemetry.set_defaults(command=_telemetry)


def _telemetry(arguments: argparse.Namespace) -> int:
    try:
        import spacepackets  # noqa: F401
        import yamcs.pymdb  # noqa: F401
    except ImportError as error:
        raise ValueError(f"heft telemetry needs more ({error}): pip install 'heft-flight[telemetry]'") from error
    if arguments.json_lines and not arguments.decode:
        raise ValueError("--json-lines goes with --decode")
    if arguments.asked and (not arguments.decode or _link(arguments.decode).kind == "file"):
        raise ValueError("--command is sent over a link: add --decode udp://HOST:PORT or serial:///...")
    if not 0 <= arguments.source < 1 << 16:
        raise ValueError(f"--source {arguments.source}: give 0 to 65535")
    if arguments.send is not None:
        return _send(arguments.of, arguments.send)
    if (shown := common.page_address(arguments)) is not None and (not arguments.decode or arguments.asked):
        raise ValueError("--page shows what comes down: add --decode, without --command")
    with _vehicle(arguments.of) as vehicle:
        if shown is not None:
            return _page(vehicle, arguments, shown)
        if arguments.xtce is not None:
            return _database(vehicle, arguments.xtce)
        return _decode(vehicle, arguments)


def watch(arguments: argparse.Namespace) -> int:
    """``heft watch LINK``: as ``heft telemetry --decode LINK``."""
    own = {"of": None, "decode": arguments.log, "xtce": None, "send": None, "asked": [], "source": 0}
    own |= {"json_lines": False, "duration": None}
    return _telemetry(argparse.Namespace(**vars(arguments) | own))


def _page(vehicle: "config.Vehicle | None", arguments: argparse.Namespace, shown: str) -> int:
    from onboard.page.follow import LogFrames
    from onboard.page.received import PacketFile, Received

    link, apids = _link(arguments.decode), _settings(vehicle).apids
    payload = "" if vehicle is None else vehicle.file.vehicle.payload_link or ""
    if link.kind != "file":
        source = Received(link, apids, payload, time.monotonic)
        common.show_page(arguments, shown, source)
        source.close()
        return common.OK
    file = PacketFile(Path(link.path), apids)
    common.show_page(arguments, shown, LogFrames(file))
    return common.OK if file.is_whole else common.DAMAGED


@contextmanager
def _vehicle(of: str | None) -> "Iterator[config.Vehicle | None]":
    """The vehicle named, or that of a log; None where none is."""
    from onboard.ground.log.tables.vehicle_file import vehicle_of
    from onboard.recording.reader import LogReader

    if of is None or not of.endswith(".mcap"):
        yield None if of is None else common.load_vehicle(of)
        return
    with tempfile.TemporaryDirectory() as directory:
        yield vehicle_of(LogReader(Path(of)), Path(directory))


def _settings(vehicle: "config.Vehicle | None") -> "Telemetry":
    from onboard.config.telemetry import Telemetry

    return Telemetry() if vehicle is None else vehicle.file.telemetry


def _database(vehicle: "config.Vehicle | None", directory: Path) -> int:
    from onboard.telemetry.xtce import database

    name, quantities = "heft", tuple[str, ...]()
    if vehicle is not None:
        from onboard.flight.estimate.estimator import Estimator

        with common.busy("the estimator is built, for the names of its answers"):
            name, quantities = vehicle.file.vehicle.name, Estimator(vehicle).online.quantity_names
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "heft.xml"
    settings = _settings(vehicle)
    taken = settings.command_apid if settings.commands else 0
    path.write_text(database(name, settings.apids, quantities, taken), encoding="utf-8")
    print(path)
    return common.OK


def _link(text: str) -> "Address":
    """A link, or a path."""
    from onboard.telemetry.link import parse

    return parse(text if "://" in text else f"file://{text}")


def _decode(vehicle: "config.Vehicle | None", arguments: argparse.Namespace) -> int:
    from onboard.telemetry.board import PacketBoard
    from onboard.telemetry.link import received
    from onboard.telemetry.packets import Packet, plain
    from onboard.telemetry.stream import Series, Splitter

    address = _link(arguments.decode)
    stream, series = Splitter(_settings(vehicle).apids), Series()
    board = PacketBoard(stream, series)
    commander, out = _commander(vehicle, arguments)
    duration_s = arguments.duration or (_COMMANDS_S if arguments.asked else None)
    until = None if duration_s is None else time.monotonic() + duration_s
    heard = time.monotonic()

    def take(packets: list[Packet]) -> None:
        nonlocal heard
        heard = time.monotonic() if packets else heard
        for packet in packets:
            place = series.place(packet)
            if not place.new:
                continue
            board.add(packet)
            commander.heard(packet)
            if arguments.json_lines:
                print(json.dumps(plain(packet) | {"missing_before": place.missing}), flush=address.kind != "file")

    with _screen(board, quiet=arguments.json_lines or bool(arguments.asked)) as show, suppress(KeyboardInterrupt):
        try:
            for piece in received(address, out):
                take(stream.feed(piece))
                show(time.monotonic() - heard)
                is_over = arguments.asked and commander.over
                if is_over or (until is not None and time.monotonic() >= until):
                    break
        except OSError as error:
            if not board.packets or isinstance(error, BrokenPipeError):
                raise
            common.complain(f"{arguments.decode}: {error}")  # what came is shown
    silent_s = 0.0 if address.kind == "file" else time.monotonic() - heard
    take(stream.finish())
    if not board.packets:
        said = "; ".join(board.losses()[1:]) or "it is empty"
        raise ValueError(f"{arguments.decode}: no packet of this downlink: {said}")
    if arguments.json_lines:
        for line in board.losses():
            sys.stderr.write(f"heft: {line}\n")
    elif not arguments.asked:
        common.console().print(board.render(silent_s))
    if arguments.asked and not (commander.over and all(commander.done)):
        told = f"{sum(commander.done)} of {len(arguments.asked)} commands are reported to be done"
        common.complain(told if commander.over else f"{told} within {duration_s:g} s")
        return common.FAILED
    return common.OK if board.is_whole or arguments.asked else common.DAMAGED


def _commander(vehicle: "config.Vehicle | None", arguments: argparse.Namespace) -> "tuple[Commander, deque[bytes]]":
    """What asks ``--command`` of the flight, and the packets that it wants sent."""
    from onboard.telemetry.commander import Commander, parse
    from onboard.telemetry.packets import COUNTS

    out: deque[bytes] = deque()
    asked = [parse(text) for text in arguments.asked]
    apid = _settings(vehicle).command_apid
    count = secrets.randbelow(COUNTS)  # none that has come before
    return Commander(asked, apid, arguments.source, count, out, print), out


@contextmanager
def _screen(board: Any, *, quiet: bool) -> Iterator[Any]:
    """Shows the board while packets come, on a terminal."""
    from rich.live import Live

    shown = common.console()
    if quiet or not shown.is_terminal:
        yield lambda silent_s: None
        return
    drawn = time.monotonic()

    def draw(silent_s: float) -> None:
        nonlocal drawn
        if time.monotonic() - drawn > _FRAME_S:
            drawn = time.monotonic()
            view.update(board.render(silent_s), refresh=True)

    with Live(board.render(), console=shown, screen=True, auto_refresh=False) as view:
        yield draw


def _send(of: str | None, link: str) -> int:
    """Packets of a log: into a file at once, over a port at the pace of the flight."""
    from onboard.recording.reader import LogReader
    from onboard.telemetry.link import parse, sink
    from onboard.telemetry.replay import packets_of

    if of is None or not of.endswith(".mcap"):
        raise ValueError("--send sends what was flown: name a log, heft telemetry LOG --send LINK")
    address = parse(link)
    with _vehicle(of) as vehicle:
        assert vehicle is not None
        log, opened = LogReader(Path(of)), sink(address)
        first_ns, started, count = 0, time.monotonic(), 0
        with closing(opened), common.busy("packets are sent") as told:
            for at_ns, packet in packets_of(log, vehicle.file.telemetry):
                first_ns = first_ns or at_ns
                if address.kind != "file":
                    time.sleep(max(0.0, started + (at_ns - first_ns) * 1e-9 - time.monotonic()))
                while not opened.ready():
                    time.sleep(0.01)
                opened.send(packet)
                count += 1
                told(f"{count} packets are sent, {(at_ns - first_ns) * 1e-9:.0f} s of the flight")
            while not opened.ready():
                time.sleep(0.01)
    print(f"{count} packets")
    common.warn(log.damage)
    return common.DAMAGED if log.damage else common.OK
