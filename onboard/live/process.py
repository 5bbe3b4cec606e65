"""Process of the live server, and its start by the command line."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from onboard.flight.store import manifest
from onboard.flight.supervise.companion import beside, ready, settle
from onboard.live.server import LiveServer, parse_address

_LOOK_S = 0.02
_ASK_S = 0.5


@contextlib.contextmanager
def serving(log: Path, address: str) -> Iterator[int]:
    """Run a server process for the flight recorded to ``log`` while the context lasts.

    Yields:
        The port it listens on.

    Raises:
        ValueError: the address is invalid or not available; the message gives the reason.
    """
    parse_address(address)
    with beside("onboard.live", [str(log), address], f"--live {address}") as port:
        yield int(port)


def main(arguments: Sequence[str]) -> int:
    """Body of the process; ``arguments`` are the log's path and the checked address."""
    log, address = Path(arguments[0]).absolute(), arguments[1]
    left = settle()
    host, port = parse_address(address)
    try:
        server = LiveServer(log.stem, host, port)
    except (RuntimeError, OSError) as error:
        sys.stdout.write(f"{error}; give another address\n")
        return 2
    ready(str(server.port))
    _serve(server, log, left)
    server.close()
    return 0


def _serve(server: LiveServer, log: Path, left: Callable[[], bool]) -> None:
    directory: Path | None = None
    asked = 0.0
    while True:
        asked -= _LOOK_S
        if asked <= 0:
            asked = _ASK_S
            found = next((flight.directory for flight in manifest.running() if flight.log == log), None)
            if found is None and (directory is not None or left()):
                return  # the flight has ended, or does not begin any more
            directory = found
        if directory is not None:
            server.pump(directory)
        time.sleep(_LOOK_S)
