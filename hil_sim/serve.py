"""Tier T1: the twins in a process of their own, in real time.

    python -m hil_sim.serve SCENARIO --seed N --directory DIR

I2C is a Unix stream socket, CAN a Lawicel adapter on a pseudo-terminal, the pulse line datagrams to a socket that the
flight computer binds. When everything can be opened, one JSON line says where (``i2c_1``, ``can_0``, ``sync_line``)
and when mission time 0 is (``start_ns``). At the end of the mission, or on SIGTERM or SIGINT, a second line gives
``produced``, ``truth`` and ``server`` (what was lost on the way, and how late the loop ever was).
"""

import argparse
import contextlib
import gc
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self

import numpy as np

from hil_sim.buses import CanBus, EdgeDatagrams, I2cBus, PulseLine
from hil_sim.i2c_socket import I2cSocket
from hil_sim.slcan import SlcanAdapter

_LONGEST_NAP_NS: Final = 5_000_000
_PRIORITY: Final = 10  # SCHED_FIFO, below a flight computer on the same machine
_SHORTEST_NAP_S: Final = 50e-6  # events closer than this go out together


class Mission(Protocol):
    """What is served: ``hil_sim.mission.Mission``, or a smaller one in a test."""

    @property
    def end_ns(self) -> int:
        """Its end, ``CLOCK_MONOTONIC`` ns."""

    @property
    def finished(self) -> bool:
        """Whether it has been advanced to its end."""

    def attach(self, *, i2c: I2cBus, can: CanBus, pulse: PulseLine, start_ns: int) -> None:
        """Plug its twins into the buses; mission time 0 is ``start_ns``."""

    def advance(self, now_ns: int) -> None:
        """Let world and twins go on to ``now_ns``."""

    def produced(self) -> dict[str, int]:
        """Samples made, per channel."""

    def truth(self) -> dict[str, Any]:
        """What an estimate is to be compared with."""


class Server:
    """The three buses of one flight computer, reachable from another process.

    Args:
        directory: Where the sockets are; made if it is not there.
        seed: Of the stamp jitter.
        i2c_bit_rate: bit/s; a reply waits for as long as the wires would be busy.
        can_bit_rate: bit/s.
    """

    def __init__(
        self, directory: Path, seed: int = 0, *, i2c_bit_rate: int = 400_000, can_bit_rate: int = 500_000
    ) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        i2c_path, edge_path = directory / "i2c_1.sock", directory / "sync_line.sock"
        i2c_path.unlink(missing_ok=True)
        self.i2c = I2cBus()
        self._i2c_socket = I2cSocket(i2c_path, self.i2c, i2c_bit_rate)
        self._adapter = SlcanAdapter(can_bit_rate)
        self.can = CanBus(self._adapter, can_bit_rate, seed)
        self._edges = EdgeDatagrams(edge_path)
        self.pulse = PulseLine(self._edges, seed)
        self.late_max_ns = 0
        self.turns = 0
        self.urls = {
            "i2c_1": f"i2c+unix://{i2c_path}",
            "can_0": f"can+slcan://{self._adapter.path}?bitrate={can_bit_rate}",
            "sync_line": f"gpio+unix://{edge_path}",
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Unplug everything."""
        self._i2c_socket.close()
        self._adapter.close()
        self._edges.close()

    def run(self, mission: Mission, stop: Callable[[], bool] = lambda: False) -> None:
        """Keep a mission, attached to these buses, in step with ``CLOCK_MONOTONIC`` until it ends or ``stop()``."""
        due_ns = time.monotonic_ns()
        while not mission.finished and not stop():
            now_ns = min(time.monotonic_ns(), mission.end_ns)
            self.turns += 1
            self.late_max_ns = max(self.late_max_ns, now_ns - due_ns)
            mission.advance(now_ns)
            self._i2c_socket.advance(now_ns)
            due_ns = min(self.can.due_ns, self._i2c_socket.due_ns, now_ns + _LONGEST_NAP_NS)
            nap_s = max((due_ns - time.monotonic_ns()) * 1e-9, _SHORTEST_NAP_S)
            files: list[Any] = [*self._i2c_socket.files]
            if not self._adapter.hung_up:
                files.append(self._adapter)
            select.select(files, [], [], nap_s)

    def summary(self) -> dict[str, float]:
        """What the server itself did and lost."""
        return {
            "turns": self.turns,
            "late_max_ms": self.late_max_ns * 1e-6,
            "can_frames_dropped": self.can.dropped,
            "can_frames_lost_in_adapter": self._adapter.lost,
            "edges_without_receiver": self._edges.lost,
            "edges_seen": self.pulse.seen,
            "i2c_transfers": self.i2c.transfers,
            "i2c_refused": self.i2c.refused,
        }


def _plain(value: object) -> object:
    """NumPy values as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a JSON line.")


def _say(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content, default=_plain) + "\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one scenario to its end; returns the exit status."""
    from hil_sim.mission import Mission as Flight  # noqa: PLC0415  (MuJoCo is loaded only where it is needed)
    from hil_sim.scenario import ScenarioError, load  # noqa: PLC0415

    parser = argparse.ArgumentParser(
        prog="python -m hil_sim.serve", description="Serve simulated devices in real time."
    )
    parser.add_argument("scenario", help="name of a packaged scenario, or a TOML file")
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    parser.add_argument("--directory", type=Path, required=True, help="where the sockets are to be")
    options = parser.parse_args(arguments)
    try:
        mission = Flight(load(options.scenario), options.seed)
    except ScenarioError as error:
        parser.error(str(error))
    stops: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: stops.append(number))
    with contextlib.suppress(OSError):  # devices do not wait for processes; without the right to this they may be late
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    with Server(options.directory, options.seed) as server:
        gc.collect()
        gc.freeze()
        start_ns = time.monotonic_ns()
        mission.attach(i2c=server.i2c, can=server.can, pulse=server.pulse, start_ns=start_ns)
        _say({**server.urls, "start_ns": start_ns})
        server.run(mission, lambda: bool(stops))
        _say({"produced": mission.produced(), "truth": mission.truth(), "server": server.summary()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
