"""A process beside a flight, which ends with it; it starts before, so that what it cannot use is refused in time.

The flight waits for it only until it says :func:`ready`. It reads the flight's rings, at a lower priority than the
flight, and goes on while the flight's terminal hangs up or is interrupted.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

_READY = "ready"
_NICENESS = 10


@contextlib.contextmanager
def beside(module: str, arguments: Sequence[str], option: str) -> Iterator[str]:
    """Run ``python -m module arguments`` while the context lasts.

    Args:
        module: whose process says :func:`ready`, or writes in a line why it cannot.
        arguments: its own.
        option: of the command line that asks for it, for the message.

    Yields:
        What it said with :func:`ready`.

    Raises:
        ValueError: it is not ready; the message gives the reason.
    """
    command = [sys.executable, "-m", module, *arguments]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            first, _, said = process.stdout.readline().strip().partition(" ")
            if first != _READY:
                raise ValueError(f"{option}: {f'{first} {said}'.strip() or 'its process did not start'}")
            yield said
        finally:
            process.terminate()


def settle() -> Callable[[], bool]:
    """Called first by such a process: lowers its priority, and leaves a terminal's signals to the flight.

    Linux divides cores among sessions before it looks at priorities (``sched(7)``, autogroup): in the flight's
    session the process would be paid from the flight's share.

    Returns:
        Whether who started it has ended without ending it.
    """
    for number in (signal.SIGINT, signal.SIGHUP):  # they end the flight, or its terminal; the flight ends this process
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    with contextlib.suppress(OSError):  # it leads a session, or there are no autogroups
        os.setsid()
        Path("/proc/self/autogroup").write_text(f"{_NICENESS}\n", encoding="ascii")
    parent = os.getppid()
    return lambda: os.getppid() != parent


def ready(said: str = "") -> None:
    """Say that the flight can begin, and what it has to know."""
    sys.stdout.write(f"{_READY} {said}".strip() + "\n")
    sys.stdout.flush()
