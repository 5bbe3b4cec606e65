"""The twins of a mission behind this kernel's own interfaces, in real time. Runs inside the guest.

    serve_mission.py SCENARIO --seed N --directory DIR [--i2c i2c-9] [--can vcan0]

One JSON line with the bus URLs when everything can be opened; the devices have no power then. They are powered up,
mission time 0, when the flight computer has bound its pulse socket. At the end of the mission, or on SIGTERM or SIGINT,
a second line gives ``produced``, ``truth`` and ``server``, as ``hil_sim.serve`` does.
"""

import argparse
import gc
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hil_sim.kernel.server import KernelServer
from hil_sim.mission import Mission
from hil_sim.scenario import ScenarioError, load

REALTIME_PRIORITY = 60  # above the flight computer's own: hardware waits for no program


class Unpowered:
    """Buses on which nobody answers, until ``socket`` is there."""

    end_ns = 1 << 62

    def __init__(self, socket: Path) -> None:
        self._socket = socket

    @property
    def finished(self) -> bool:
        """The flight computer is up."""
        return self._socket.exists()

    def advance(self, now_ns: int) -> None:
        """Nothing happens."""


def plain(value: object) -> object:
    """NumPy values as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a JSON line")


def say(content: dict[str, Any]) -> None:
    """One JSON line."""
    sys.stdout.write(json.dumps(content, default=plain) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Serve one scenario to its end."""
    parser = argparse.ArgumentParser(description="Serve simulated devices as kernel nodes.")
    parser.add_argument("scenario")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--directory", type=Path, required=True)
    parser.add_argument("--i2c", default="i2c-9")
    parser.add_argument("--can", default="vcan0")
    options = parser.parse_args()
    try:
        mission = Mission(load(options.scenario), options.seed)
    except ScenarioError as error:
        parser.error(str(error))
    stops: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: stops.append(number))
    server = KernelServer(options.directory, i2c_node=options.i2c, can_interface=options.can, seed=options.seed)
    with server:
        # MuJoCo times each stage of each step, and without a vDSO a look at the clock takes 12 us: 80 % of the CPU.
        mujoco.set_mjcb_time(lambda: 0.0)
        gc.collect()
        gc.freeze()
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
        say(dict(server.urls))
        server.run(Unpowered(options.directory / "sync_line.sock"), time.monotonic_ns, lambda: bool(stops))
        mission.attach(i2c=server.i2c, can=server.can, pulse=server.pulse, start_ns=time.monotonic_ns())
        server.run(mission, time.monotonic_ns, lambda: bool(stops))
        say({"produced": mission.produced(), "truth": mission.truth(), "server": server.summary()})


if __name__ == "__main__":
    main()
