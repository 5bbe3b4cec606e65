"""Bodies of processes that the tests have forked: a fork server imports them by name."""

import os
import sys
from multiprocessing.connection import Connection

HEAVY = ("pinocchio", "scipy", "mujoco", "matplotlib", "pandas", "onboard.dynamics", "onboard.regressor")


def heavy() -> list[str]:
    """What this process has loaded that is slow to load."""
    return [name for name in HEAVY if name in sys.modules]


def tell(*arguments: object) -> None:
    """Send what was given, this process and its parent, and what is loaded; end with 3 when told to."""
    *given, pipe = arguments
    assert isinstance(pipe, Connection)
    pipe.send((len(given), os.getpid(), os.getppid(), heavy()))
    pipe.recv()
    sys.exit(3)
