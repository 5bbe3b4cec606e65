"""The simulated CAN bus on a network interface of the kernel (``vcan0``).

On a virtual interface a frame sent by one socket reaches every other socket, so this end acts for all nodes. Stamps are
the kernel's: later than the simulated wire by the lateness of the serving loop. Frames in close succession are sent
together; otherwise a delay of the loop between a SYNC and its answer would make the answer unrealistically late.
"""

import os
import socket
import struct
from collections.abc import Sequence
from typing import Final

from drivers.ports import CanFrame
from hil_sim.faults import NEVER

_FRAME: Final = struct.Struct("=IB3x8s")  # struct can_frame: identifier and flags, length, data
_REMOTE: Final = 0x4000_0000
_FLAGS: Final = 0xA000_0000  # extended, error
_QUEUE_BYTES: Final = 1 << 20
_LIST_BYTES: Final = 1 << 14


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
