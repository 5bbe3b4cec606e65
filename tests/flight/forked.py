"""Bodies of processes that the tests have forked: a fork server imports them by name.

A test never forks its own process: a child that leaves the test by an exception would go on as a second pytest.
"""

import os
import signal
import sys
import time
from multiprocessing.connection import Connection

HEAVY = ("pinocchio", "scipy", "mujoco", "matplotlib", "pandas", "onboard.dynamics.model.vehicle", "onboard.regressor")
NOT_IN_FLIGHT = tuple(f"scipy.{part}" for part in ("interpolate", "ndimage", "optimize", "signal", "spatial", "stats"))


def heavy() -> list[str]:
    """What this process has loaded that is slow to load."""
    return [name for name in (*HEAVY, *NOT_IN_FLIGHT) if name in sys.modules]


def tell(*arguments: object) -> None:
    """Send what was given, this process and its parent, and what is loaded; end with 3 when told to."""
    *given, pipe = arguments
    assert isinstance(pipe, Connection)
    pipe.send((len(given), os.getpid(), os.getppid(), heavy()))
    pipe.recv()
    sys.exit(3)


def fail(pipe: Connection) -> None:
    """Meet an error of the system's."""
    raise OSError("no space left on device")


def refuse(pipe: Connection) -> None:
    """End with a sentence."""
    raise SystemExit("why it cannot go on")


def answer(pipe: Connection) -> None:
    """Say that it is at work, and end when told to."""
    pipe.send(True)
    pipe.recv()


def work_long(pipe: Connection) -> None:
    """Say that it is at work, then work and say nothing."""
    pipe.send(True)
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        sum(range(1000))


def stand(pipe: Connection) -> None:
    """Say that it is at work, then stop."""
    pipe.send(True)
    os.kill(os.getpid(), signal.SIGSTOP)
