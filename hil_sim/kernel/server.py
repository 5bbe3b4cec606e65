"""Tier T2: the buses of one flight computer behind kernel interfaces.

I2C on a CUSE node, CAN on a network interface, serial lines on pseudo-terminals, pulse edges as datagrams: this kernel
has no GPIO lines.

The simulated CAN bus on a network interface of the kernel (``vcan0``).

On a virtual interface a frame sent by one socket reaches every other socket, so this end acts for all nodes. Stamps are
the kernel's: later than the simulated wire by the lateness of the serving loop. Frames in close succession are sent
together; otherwise a delay of the loop between a SYNC and its answer would make the answer unrealistically late.
"""

import os
import re
import socket
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from drivers.ports import CanFrame
from hil_sim.buses.media import CanBus, I2cBus
from hil_sim.buses.ports import Port, Ports, open_ports
from hil_sim.faults import NEVER
from hil_sim.kernel.cuse import CuseNode
from hil_sim.kernel.i2c_node import I2cNode
from hil_sim.scenario import bus_tables
from hil_sim.serve import open_socket

_FRAME: Final = struct.Struct("=IB3x8s")  # struct can_frame: identifier and flags, length, data
_REMOTE: Final = 0x4000_0000
_FLAGS: Final = 0xA000_0000  # extended, error
_QUEUE_BYTES: Final = 1 << 20
_LIST_BYTES: Final = 1 << 14
_BURST_GAP_NS: Final = 1_000_000  # CAN frames nearer than this to the next go out with it
_BURST_NS: Final = 3_000_000  # but none waits longer


class SocketCan:
    """A ``CanLink`` on a raw CAN socket. What it is given leaves with ``flush``.

    Args:
        interface: Its name; it must be up.

    Attributes:
        lost: Frames that the interface did not take: it was down, or its queue full.

    Raises:
        OSError: No such interface, or a kernel without CAN.
    """

    def __init__(self, interface: str) -> None:
        self.lost = 0
        self._burst: list[CanFrame] = []
        self._interface = interface.encode()
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _QUEUE_BYTES)
            self._socket.bind((interface,))
            self._receivers = os.open("/proc/net/can/rcvlist_all", os.O_RDONLY)
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """Of the socket, to wait on."""
        return self._socket.fileno()

    def take(self) -> list[tuple[int, bytes | int]]:
        """Frames with 11-bit identifiers sent by others since the last call; see ``CanLink``."""
        frames: list[tuple[int, bytes | int]] = []
        while True:
            try:
                raw = self._socket.recv(_FRAME.size)
            except OSError:  # nothing there, or the interface went down: the flight computer's frames are nowhere
                return frames
            identifier, length, data = _FRAME.unpack(raw)
            if not identifier & _FLAGS:
                frames.append((identifier & ~_REMOTE, length if identifier & _REMOTE else data[:length]))

    @property
    def listening(self) -> bool:
        """Whether the kernel has a receiver of all frames of the interface besides ours."""
        receivers = os.pread(self._receivers, _LIST_BYTES, 0).splitlines()
        return sum(line.split()[:1] == [self._interface] for line in receivers) > 1

    @property
    def oldest_ns(self) -> int:
        """When the first of the frames that wait for ``flush`` ended on the simulated wire."""
        return self._burst[0].host_ns if self._burst else NEVER

    def give(self, frames: Sequence[CanFrame]) -> None:
        """Frames to send with the next ``flush``."""
        self._burst += frames

    def flush(self) -> None:
        """Send what waits."""
        burst, self._burst = self._burst, []
        for _, identifier, data, _ in burst:
            try:
                self._socket.send(_FRAME.pack(identifier, len(data), data))
            except OSError:
                self.lost += 1

    def close(self) -> None:
        """Leave the interface."""
        self._socket.close()
        os.close(self._receivers)


class _I2cPort(Port):
    """A transfer returns when it would have left real wires."""

    def __init__(self, node: str, bit_rate: int) -> None:
        self._wires = I2cBus()
        self._node = CuseNode(node, I2cNode(self._wires, bit_rate))
        super().__init__(self._wires, f"i2c:///dev/{node}")

    @property
    def files(self) -> list[int]:
        return self._node.files

    @property
    def due_ns(self) -> int:
        return self._node.due_ns

    def receive(self) -> None:
        self._node.receive()

    def advance(self, now_ns: int) -> None:
        self._node.advance(now_ns)

    def counts(self) -> dict[str, int]:
        wires = self._wires
        return {"transfers": wires.transfers, "refused": wires.refused, "abandoned": self._node.abandoned}

    def close(self) -> None:
        """Unplug it; open files of the node get ENOTCONN from here on."""
        self._node.close()


class _CanPort(Port):
    """Frames leave one after the other as on a real bus."""

    def __init__(self, interface: str, bit_rate: int, seed: int) -> None:
        self._link = SocketCan(interface)
        self._wire = CanBus(self._link, bit_rate, seed)
        super().__init__(self._wire, f"can+socketcan://{interface}?bitrate={bit_rate}")

    @property
    def files(self) -> list[int]:
        return [self._link.fileno()]

    def advance(self, now_ns: int) -> None:
        if self._wire.due_ns - now_ns > _BURST_GAP_NS or now_ns - self._link.oldest_ns > _BURST_NS:
            self._link.flush()

    def counts(self) -> dict[str, int]:
        return {"frames_dropped": self._wire.dropped, "frames_not_taken": self._link.lost}

    def close(self) -> None:
        self._link.close()


def open_nodes(
    tables: Mapping[str, bus_tables.BusTable],
    directory: Path,
    *,
    i2c_node: str = "i2c-9",
    can_interface: str = "vcan0",
    seed: int = 0,
) -> Ports:
    """Open every bus as what the kernel has for it.

    Args:
        tables: ``[bus.*]`` of a scenario.
        directory: Where the flight computer binds its pulse sockets, as ``BUS.sock``, and where the terminals are.
        i2c_node: Name of the first device node under ``/dev``; those of others count on from it.
        can_interface: The first CAN interface, that is up; others count on from it.
        seed: Of the jitter of all stamps.

    Raises:
        OSError: The kernel has no CUSE, no CAN or no such interface.
    """

    def open_port(bus: str, table: bus_tables.BusTable, place: int, seed: int) -> Port:
        match table:
            case bus_tables.I2cBusTable():
                return _I2cPort(_counted_on(i2c_node, place), table.bit_rate)
            case bus_tables.CanBusTable():
                return _CanPort(_counted_on(can_interface, place), table.bit_rate, seed)
            case _:
                return open_socket(directory, bus, table, seed)

    return open_ports(tables, open_port, seed)


def _counted_on(name: str, place: int) -> str:
    """``vcan0`` and 1 make ``vcan1``."""
    return re.sub(r"\d+$", lambda digits: str(int(digits[0]) + place), name)
