"""The twins of a mission behind this kernel's own interfaces, in real time. Runs inside the guest.

    serve_mission.py SCENARIO --seed N --directory DIR [--i2c i2c-9] [--can vcan0]

One JSON line with the bus URLs when everything can be opened; the devices have no power then. They are powered up,
mission time 0, when the flight computer has bound its pulse socket, and stay on after the mission, as ``hil_sim.serve``
has it with ``--wait``. On SIGTERM or SIGINT a second line gives ``produced``, ``truth`` and ``server``, as there.
"""

import argparse
import gc
import os
import time
from collections.abc import Mapping
from pathlib import Path

import mujoco

from hil_sim.buses.realtime import MissionServer
from hil_sim.kernel.server import open_nodes
from hil_sim.mission import Mission
from hil_sim.scenario.load import load
from hil_sim.serve import LINGER_S, say, stops_on_signals

REALTIME_PRIORITY = 60  # above the flight computer's own: hardware waits for no program


class Unpowered:
    """Buses without devices, until the pulse sockets exist."""

    end_ns = 1 << 62

    def __init__(self, urls: Mapping[str, str]) -> None:
        scheme = "gpio+unix://"
        self._sockets = [Path(url.removeprefix(scheme)) for url in urls.values() if url.startswith(scheme)]

    @property
    def finished(self) -> bool:
        """The flight computer is up."""
        return all(socket.exists() for socket in self._sockets)

    def advance(self, now_ns: int) -> None:
        """Nothing happens."""


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
        mission = Mission(load(options.scenario), options.seed, linger_s=LINGER_S)
    except ValueError as error:  # of the scenario or a fault in it
        parser.error(str(error))
    stops = stops_on_signals()
    tables, node, interface = mission.scenario.bus, options.i2c, options.can
    with open_nodes(tables, options.directory, i2c_node=node, can_interface=interface, seed=options.seed) as ports:
        # MuJoCo times each stage of each step, and without a vDSO a look at the clock takes 12 us: 80 % of the CPU.
        mujoco.set_mjcb_time(lambda: 0.0)
        gc.collect()
        gc.freeze()
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
        say(dict(ports.urls))
        server = MissionServer(ports, time.monotonic_ns)
        server.run(Unpowered(ports.urls), lambda: bool(stops))
        mission.attach(ports.buses, time.monotonic_ns())
        server.run(mission, lambda: bool(stops))
        say({"produced": mission.produced(), "truth": mission.truth(), "server": server.summary()})


if __name__ == "__main__":
    main()
