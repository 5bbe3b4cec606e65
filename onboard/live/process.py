"""Process of the live server, and its start and end by the command line.

It starts before the flight, so that an unusable address is refused before take-off, and ends with the flight or on
request.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from onboard.flight.store import manifest
from onboard.live.server import LiveServer, parse_address

_LOOK_S = 0.02
_ASK_S = 0.5
_NICENESS = 10
_READY = "ready"


@contextlib.contextmanager
def serving(log: Path, address: str) -> Iterator[int]:
    """Run a server process for the flight recorded to ``log`` while the context lasts.

    Yields:
        The port it listens on.

    Raises:
        ValueError: the address is invalid or not available; the message gives the reason.
    """
    parse_address(address)
    command = [sys.executable, "-m", "onboard.live", str(log), address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            said = process.stdout.readline().split()
            if said[:1] != [_READY]:
                raise ValueError(f"--live {address}: {' '.join(said) or 'the server did not start'}")
            yield int(said[1])
        finally:
            process.terminate()


def main(arguments: Sequence[str]) -> int:
    """Body of the process; ``arguments`` are the log's path and the checked address."""
    log, address = Path(arguments[0]).absolute(), arguments[1]
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # the flight goes on without its terminal, and viewers with it
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)  # lower priority than the flight
    host, port = parse_address(address)
    try:
        server = LiveServer(log.stem, host, port)
    except (RuntimeError, OSError) as error:
        sys.stdout.write(f"{error}; give another address\n")
        return 2
    sys.stdout.write(f"{_READY} {server.port}\n")
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt):  # a terminal's ^C ends the flight, which ends this process
        _serve(server, log)
    server.close()
    return 0


def _serve(server: LiveServer, log: Path) -> None:
    directory: Path | None = None
    asked = 0.0
    while True:
        asked -= _LOOK_S
        if asked <= 0:
            asked = _ASK_S
            found = next((flight.directory for flight in manifest.running() if flight.log == log), None)
            if directory is not None and found is None:
                return  # the flight has ended
            directory = found
        if directory is not None:
            server.pump(directory)
        time.sleep(_LOOK_S)
