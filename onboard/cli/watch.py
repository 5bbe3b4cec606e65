"""``heft watch``: updates the board from a log or from the rings of a flight, which it only reads."""

import argparse
import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard.flight.store.manifest import Manifest
    from onboard.ground.log.views.watch import Board
    from onboard.page.follow import Followed, LogFrames
    from onboard.recording.reader import LogReader
    from onboard.ring import RingReader

_FRAME_S = 0.2


def add(commands: common.Commands) -> None:
    """Make the command known."""
    watch = commands.add_parser(
        "watch", help="rates, gaps, clocks, gates, the estimate: a running flight, or a log played"
    )
    watch.add_argument(
        "log",
        type=_log_or_link,
        nargs="?",
        metavar="LOG|LINK",
        help="log to play, or where a downlink comes in: udp://HOST:PORT, serial:///..., file://PATH",
    )
    watch.add_argument("--live", action="store_true", help="the flight running on this machine")
    watch.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="play X times as fast (0: as fast as possible)"
    )
    common.add_page(watch, "it")
    watch.add_argument(
        "--page-meshes",
        type=Path,
        metavar="URDF",
        help="draw on it the mesh files that lie beside this URDF; a log has the URDF alone",
    )
    watch.set_defaults(command=_watch)


def _watch(arguments: argparse.Namespace) -> int:
    if arguments.live == (arguments.log is not None):
        raise ValueError("watch what? Give a log to play, or --live for the flight that is running")
    if arguments.speed < 0:
        raise ValueError(f"--speed {arguments.speed:g}: give 0 or more")
    if arguments.page_meshes is not None and not arguments.page_meshes.is_file():
        raise ValueError(f"--page-meshes {arguments.page_meshes}: there is no such file; give the vehicle's URDF")
    if isinstance(arguments.log, str):
        from onboard.cli.telemetry import watch

        return watch(arguments)
    if (address := common.page_address(arguments)) is not None:
        log, source = (None, _followed()) if arguments.live else _recorded(arguments.log)
        common.show_page(arguments, address, source, arguments.page_meshes)
        common.warn([] if log is None else log.damage)
        return common.OK if log is None or not log.damage else common.DAMAGED
    return _live() if arguments.live else _play(arguments.log, arguments.speed)


def _log_or_link(text: str) -> Path | str:
    return text if "://" in text else Path(text)


def _recorded(path: Path) -> "tuple[LogReader, LogFrames]":
    from onboard.page.follow import LogFrames
    from onboard.recording.reader import LogReader

    log = LogReader(path)
    with common.busy(f"{path.name} is read") as told:
        return log, LogFrames(log, lambda done: told(f"{path.name} is read, {100 * done // max(1, log.size)} %"))


def _followed() -> "Followed":
    from onboard.page.follow import Followed

    return Followed(_running().log)


@contextlib.contextmanager
def _screen(board: "Board") -> Iterator[Any]:
    """Show the board on the terminal, and leave its last state; without a terminal only the latter."""
    from rich.live import Live

    shown = common.console()
    if not shown.is_terminal:
        yield lambda: None
        shown.print(board.render())
        return
    view = Live(board.render(), console=shown, screen=True, auto_refresh=False)
    with view, contextlib.suppress(KeyboardInterrupt):
        yield lambda: view.update(board.render(), refresh=True)
    shown.print(board.render())


def _play(path: Path, speed: float) -> int:
    from onboard.ground.log.views.watch import Board
    from onboard.recording.reader import LogReader

    log = LogReader(path)
    board = Board(path.name)
    with _screen(board) as show:
        started, shown, first_ns = time.monotonic(), 0.0, None
        for batch in log.batches():
            first_ns = int(batch.rows["host_ns"][0]) if first_ns is None else first_ns
            if speed:
                due = started + (int(batch.rows["host_ns"][0]) - first_ns) * 1e-9 / speed
                while (wait := due - time.monotonic()) > 0:
                    show()
                    time.sleep(min(wait, _FRAME_S))
            board.add(batch)
            if time.monotonic() - shown > _FRAME_S:
                shown = time.monotonic()
                show()
        show()
    common.warn(log.damage)
    return common.DAMAGED if log.damage else common.OK


def _live() -> int:
    from onboard.ground.log.views.watch import Board

    flight = _running()
    board = Board(f"{flight.vehicle}  {flight.log}")
    rings: dict[Path, RingReader] = {}
    with _screen(board) as show:
        while True:
            look(board, flight.directory, rings)
            show()
            if not flight.directory.exists():
                break
            time.sleep(_FRAME_S)
    return common.OK


def _running() -> "Manifest":
    """The flight of this user that is running, the last by name.

    Raises:
        ValueError: there is none.
    """
    from onboard.flight.store import manifest

    flights = manifest.running()
    if not flights:
        raise ValueError("no flight of yours is running on this machine; heft watch LOG plays a recorded flight")
    return flights[-1]


def look(board: "Board", directory: Path, rings: "dict[Path, RingReader]") -> None:
    """Read new rows of the rings; rings of a restarted flight are added as they appear."""
    from drivers.records import Batch
    from onboard.ring import RingReader

    for path in sorted(directory.glob("*.ring")):
        if path not in rings:
            try:
                rings[path] = RingReader(path)
            except (OSError, ValueError):
                continue  # under construction: retried in the next pass
            # not from the oldest row, which is being overwritten
            rings[path].position = max(0, rings[path].published - rings[path].capacity * 9 // 10)
    for reader in rings.values():
        rows, lost = reader.read()
        board.lost += lost
        board.add(Batch(reader.name, rows))
