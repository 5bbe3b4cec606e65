"""The viewer's process, and how the command line starts and ends it.

It serves from before the flight begins, so that an address that cannot be had is refused while nothing flies, and goes
when the flight has gone or it is told to.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from onboard.flight import manifest
from onboard.live.server import Server, parse_address

_LOOK_S = 0.02
_ASK_S = 0.5
_NICENESS = 10
_READY = "ready"


@contextlib.contextmanager
def serving(log: Path, address: str) -> Iterator[int]:
    """A server for the flight that is recorded to ``log``, in a process of its own, for as long as the context lasts.

    Yields:
        The port it listens on.

    Raises:
        ValueError: the address is none or cannot be had, and why.
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
    """Body of the process: the log's path and the address, checked already."""
    log, address = Path(arguments[0]).absolute(), arguments[1]
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)  # the flight comes first
    host, port = parse_address(address)
    try:
        server = Server(log.stem, host, port)
    except (RuntimeError, OSError) as error:
        sys.stdout.write(f"{error}; give another address\n")
        return 2
    sys.stdout.write(f"{_READY} {server.port}\n")
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt):  # a terminal's ^C is for the flight, and ends it
        _serve(server, log)
    server.close()
    return 0


def _serve(server: Server, log: Path) -> None:
    directory: Path | None = None
    asked = 0.0
    while True:
        asked -= _LOOK_S
        if asked <= 0:
            asked = _ASK_S
            found = next((flight.directory for flight in manifest.running() if flight.log == log), None)
            if directory is not None and found is None:
                return  # it is over
            directory = found
        if directory is not None:
            server.pump(directory)
        time.sleep(_LOOK_S)
