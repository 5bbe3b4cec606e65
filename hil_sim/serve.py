"""Tier T1: the twins in a process of their own, in real time.

    python -m hil_sim.serve SCENARIO --seed N --directory DIR

I2C and pairs of GPIO lines are Unix stream sockets, CAN a Lawicel adapter on a pseudo-terminal, a serial line a
pseudo-terminal, the pulse line datagrams to a socket that the flight computer binds. When everything can be opened, one
JSON line says where, by the name of each bus, when mission time 0 is (``start_ns``) and how long the mission lasts
(``duration_s``). At the end of the mission, or on SIGTERM or SIGINT, a second line gives ``produced``, ``truth`` and
``server`` (what was lost on the way, and how late the loop ever was).

With ``--wait`` the first line has no ``start_ns``: the devices are powered up when a line comes on stdin, and a line
with ``start_ns`` answers. After ``duration_s`` the devices stay on for ``LINGER_S``, the arm at rest: a busy flight
computer stops late, and a device that was gone before would be missing samples. They end when stdin does, which is when
the process that started them is gone. With ``--segments`` each later line, ``ask SEGMENT``, is a motion that the flight
computer asks for.
"""

import argparse
import contextlib
import csv
import gc
import json
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from hil_sim.buses.can.slcan import SlcanAdapter
from hil_sim.buses.gpio.pair import PairBus
from hil_sim.buses.i2c_dev import I2cTarget
from hil_sim.buses.i2c_socket import I2cSocket
from hil_sim.buses.in_process import EdgePort
from hil_sim.buses.media import Bus, CanBus, I2cBus
from hil_sim.buses.network import NetworkBus
from hil_sim.buses.ports import Port, Ports, open_ports, serial_options
from hil_sim.buses.realtime import MissionServer
from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial
from hil_sim.buses.spi import SpiBus
from hil_sim.buses.tcp_ends import ListeningTcp
from hil_sim.buses.udp_ends import UdpEnd
from hil_sim.faults import parse
from hil_sim.scenario import bus_tables

_LEASH_PERIOD_S: Final = 0.1
_PRIORITY: Final = 10  # SCHED_FIFO, below a flight computer on the same machine
_USB_FRAME_NS: Final = 1_000_000  # no adapter hands characters over more often
LINGER_S: Final = 30.0


class _Wires(Bus, I2cTarget, Protocol):
    """Wires that are asked."""


class _WiresPort(Port):
    def __init__(self, scheme: str, path: Path, wires: _Wires, bit_rate: int) -> None:
        path.unlink(missing_ok=True)
        self._socket = I2cSocket(path, wires, bit_rate)
        super().__init__(wires, f"{scheme}+unix://{path}")

    @property
    def files(self) -> list[int]:
        return [self._socket.fileno()]

    @property
    def due_ns(self) -> int:
        return self._socket.due_ns

    def advance(self, now_ns: int) -> None:
        self._socket.advance(now_ns)

    def close(self) -> None:
        self._socket.close()


class _I2cPort(_WiresPort):
    def __init__(self, path: Path, bit_rate: int) -> None:
        self._wires = I2cBus()
        super().__init__("i2c", path, self._wires, bit_rate)

    def counts(self) -> dict[str, int]:
        return {"transfers": self._wires.transfers, "refused": self._wires.refused}


class PairPort(_WiresPort):
    """A clock line and a data line on a Unix socket; kernel tier and this one share it."""

    def __init__(self, path: Path) -> None:
        self._pair = PairBus()
        super().__init__("gpio-pair", path, self._pair, 400_000)

    def counts(self) -> dict[str, int]:
        """See ``Port``."""
        return {"pulses": self._pair.pulses}


class SpiSocketPort(_WiresPort):
    """SPI on a Unix socket for each of two select lines; kernel tier and this one share it."""

    def __init__(self, path: Path) -> None:
        other, self._others = path.with_suffix(".second"), SpiBus()
        self._second = _WiresPort("spi", other, self._others, 1_000_000)
        self._spi = SpiBus(self._others)
        super().__init__("spi", path, self._spi, 1_000_000)
        self.url += f"?second={other}"

    @property
    def files(self) -> list[int]:
        """See ``Port``."""
        return [*super().files, *self._second.files]

    @property
    def due_ns(self) -> int:
        """See ``Port``."""
        return min(super().due_ns, self._second.due_ns)

    def advance(self, now_ns: int) -> None:
        """See ``Port``."""
        super().advance(now_ns)
        self._second.advance(now_ns)

    def counts(self) -> dict[str, int]:
        """See ``Port``."""
        return {"frames": self._spi.frames + self._others.frames}

    def close(self) -> None:
        """See ``Port``."""
        super().close()
        self._second.close()


WIRES: Final = {"pair": PairPort, "spi": SpiSocketPort}


class _CanPort(Port):
    def __init__(self, path: Path, bit_rate: int, seed: int) -> None:
        self._adapter = SlcanAdapter(bit_rate, path)
        self._wire = CanBus(self._adapter, bit_rate, seed)
        super().__init__(self._wire, f"can+slcan://{self._adapter.path}?bitrate={bit_rate}")

    @property
    def files(self) -> list[int]:
        return [] if self._adapter.hung_up else [self._adapter.fileno()]

    def counts(self) -> dict[str, int]:
        return {"frames_dropped": self._wire.dropped, "frames_lost_in_adapter": self._adapter.lost}

    def close(self) -> None:
        self._adapter.close()


class PseudoTerminal(Port):
    """A pseudo-terminal, linked to as ``path``; kernel tier and this one share it."""

    def __init__(self, path: Path, table: bus_tables.SerialBusTable, seed: int) -> None:
        self._terminal = PtySerial(path)
        self._line = SerialBus(self._terminal, seed, latency_ns=round(table.adapter_latency_ms * 1e6))
        super().__init__(self._line, f"serial://{path}?{serial_options(table)}")

    @property
    def files(self) -> list[int]:
        """See ``Port``."""
        return self._terminal.files

    @property
    def due_ns(self) -> int:
        """See ``Port``."""
        return -(-self._line.due_ns // _USB_FRAME_NS) * _USB_FRAME_NS

    def counts(self) -> dict[str, int]:
        """See ``Port``."""
        line = self._line
        return {"characters_to_host": line.to_host, "characters_to_device": line.to_device, "lost": line.lost}

    def close(self) -> None:
        """See ``Port``."""
        self._terminal.close()


class ServedPort(Port):
    """A port of this computer; kernel tier and this one share it.

    Args:
        table: Of the bus: TCP or UDP.
    """

    def __init__(self, table: bus_tables.TcpBusTable | bus_tables.UdpBusTable) -> None:
        self._listener = ListeningTcp() if isinstance(table, bus_tables.TcpBusTable) else UdpEnd()
        self._network = NetworkBus(self._listener)
        host, port = self._listener.address
        super().__init__(self._network, f"{table.kind}://{host}:{port}")

    @property
    def files(self) -> list[int]:
        """See ``Port``."""
        return self._listener.files

    def counts(self) -> dict[str, int]:
        """See ``Port``."""
        return {"bytes_to_host": self._network.to_host, "bytes_to_device": self._network.to_device}

    def close(self) -> None:
        """See ``Port``."""
        self._listener.close()


def open_socket(directory: Path, bus: str, table: bus_tables.BusTable, seed: int) -> Port:
    """A bus for another process: a socket or terminal in ``directory``, or a port of this host."""
    match table:
        case bus_tables.I2cBusTable():
            return _I2cPort(directory / f"{bus}.sock", table.bit_rate)
        case bus_tables.PairBusTable() | bus_tables.SpiBusTable():
            return WIRES[table.kind](directory / f"{bus}.sock")
        case bus_tables.CanBusTable():
            return _CanPort(directory / bus, table.bit_rate, seed)
        case bus_tables.PulseLineTable():
            return EdgePort(directory / f"{bus}.sock", seed)
        case bus_tables.SerialBusTable():
            return PseudoTerminal(directory / bus, table, seed)
        case bus_tables.TcpBusTable() | bus_tables.UdpBusTable():
            return ServedPort(table)


def open_sockets(tables: Mapping[str, bus_tables.BusTable], directory: Path, seed: int = 0) -> Ports:
    """Open every bus for another process.

    Args:
        tables: ``[bus.*]`` of a scenario.
        directory: Where the sockets and terminals are; made if it is not there.
        seed: Of the jitter of all stamps.
    """
    directory.mkdir(parents=True, exist_ok=True)

    return open_ports(tables, lambda bus, table, _, of_bus: open_socket(directory, bus, table, of_bus), seed)


def say(content: dict[str, Any]) -> None:
    """One JSON line, NumPy values as JSON has them; lost where nobody is left to read it."""

    def plain(value: object) -> object:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        raise TypeError(f"{type(value).__name__} has no place in a JSON line.")

    try:
        sys.stdout.write(json.dumps(content, default=plain) + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # else the interpreter reports it again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def stops_on_signals() -> list[int]:
    """Signals that ask for an end, as they come."""
    stops: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: stops.append(number))
    return stops


def do_not_wait() -> None:
    """Devices do not wait for processes: real-time priority. Without the right to it they may be late."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


class Leash:
    """Stdin of a process that whoever started it holds: a line lets it begin, the end of it asks for an end.

    Attributes:
        asked: Segments that lines have asked for since.
    """

    def __init__(self, stops: list[int]) -> None:
        self._begun, self._stops = threading.Event(), stops
        self.asked: deque[str] = deque()
        threading.Thread(target=self._watch, name="stdin", daemon=True).start()

    def _watch(self) -> None:
        if sys.stdin.readline():
            self._begun.set()
            while line := sys.stdin.readline():
                word, _, segment = line.rstrip("\n").partition(" ")
                if word == "ask":
                    self.asked.append(segment)
        self._stops.append(signal.SIGHUP)

    def wait(self) -> None:
        """Until it may begin, or is to end."""
        while not (self._stops or self._begun.wait(_LEASH_PERIOD_S)):
            pass


def motion_starts(path: Path, file: dict[str, Any]) -> dict[str, float]:
    """Where each joint stands at the beginning of a vehicle file's ``[drive] motion``, rad or m; empty without one."""
    motion = file.get("drive", {}).get("motion")
    if motion is None or not (path.parent / motion).is_file():
        return {}
    with (path.parent / motion).open(encoding="utf-8", newline="") as rows:
        first = next(csv.DictReader(rows), {})
    return {name: float(value) for name, value in first.items() if name != "time_s"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one scenario to its end; returns the exit status."""
    from hil_sim.devices.vehicle_file import scenario_of  # noqa: PLC0415  (MuJoCo is loaded only where it is needed)
    from hil_sim.mission import Mission  # noqa: PLC0415
    from hil_sim.plants.planned import with_segments  # noqa: PLC0415

    parser = argparse.ArgumentParser(
        prog="python -m hil_sim.serve", description="Serve simulated devices in real time."
    )
    parser.add_argument("scenario", help="name of a packaged scenario, or a TOML file of a scenario or a vehicle")
    parser.add_argument("--over", help="a scenario file whose tables lie over it")
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    parser.add_argument("--directory", type=Path, required=True, help="where the sockets are to be")
    parser.add_argument("--fault", action="append", default=[], help="KIND:DEVICE:START:END[:VALUE], repeatable")
    parser.add_argument("--wait", action="store_true", help="begin when a line comes on stdin")
    parser.add_argument(
        "--segments", type=Path, help="motions that lines on stdin ask for, in the longest swing's place"
    )
    parser.add_argument("--most", type=float, default=300.0, help="longest time for them, s (default 300)")
    options = parser.parse_args(arguments)
    try:
        scenario = scenario_of(options.scenario, options.over)
        if options.segments is not None:
            scenario = with_segments(scenario, options.segments, options.most)
        faults = [parse(text) for text in options.fault]
        mission = Mission(scenario, options.seed, faults, linger_s=LINGER_S if options.wait else 0.0)
    except ValueError as error:  # of the scenario or a fault in it
        parser.error(str(error))
    stops = stops_on_signals()
    do_not_wait()
    with open_sockets(mission.scenario.bus, options.directory, options.seed) as ports:
        gc.collect()
        gc.freeze()
        about = {**ports.urls, "duration_s": mission.duration_s}
        asked: deque[str] = deque()
        if options.wait:
            signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a terminal is gone: whoever started this goes on, or ends it
            leash = Leash(stops)
            asked = leash.asked
            say(about)
            about = {}
            leash.wait()
        start_ns = time.monotonic_ns()
        try:
            mission.attach(ports.buses, start_ns)
        except ValueError as error:
            parser.error(str(error))
        say({**about, "start_ns": start_ns})
        server = MissionServer(ports, time.monotonic_ns)

        def stop() -> bool:
            while asked:
                mission.ask(asked.popleft())
            return bool(stops)

        server.run(mission, stop)
        say({"produced": mission.produced(), "truth": mission.truth(), "server": server.summary()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
