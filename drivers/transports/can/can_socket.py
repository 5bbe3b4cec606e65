"""CAN through the kernel's raw sockets: python-can opens, sends and filters; frames are received here.

python-can's receive asserts that a frame carries one ancillary message, so SO_RXQ_OVFL (frames the kernel dropped for
want of buffer) cannot be switched on beside its time stamp, and it passes the stamp through a float that resolves
238 ns.
"""

import contextlib
import logging
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import Self

import can
from can.interfaces.socketcan import SocketcanBus
from can.typechecking import CanFilter

from drivers.ports import CanFrame
from drivers.transports.can.can_library import queue
from drivers.transports.clock import realtime_minus_monotonic

logging.getLogger("can").addHandler(logging.NullHandler())  # what it would print to stderr is in the OSError we raise

SO_TIMESTAMPNS = 35  # asm-generic/socket.h
SO_RXQ_OVFL = 40
CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h
# The opposite (CAN_INV_FILTER) of a filter that lets all frames through; an empty list is "all" for python-can
_NOTHING: CanFilter = {"can_id": 0x2000_0000, "can_mask": 0}
_FRAME = struct.Struct("=IB3x8s")  # linux/can.h, struct can_frame
_TIMESPEC = struct.Struct("@ll")
_DROPS = struct.Struct("=I")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size)
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_ALL_ERRORS = 0x1FFF_FFFF
_MOST_FRAMES = 4096


class _Bus(SocketcanBus):
    """python-can leaves the socket open of an interface that it cannot use: closed here."""

    def __init__(self, channel: str) -> None:
        try:
            super().__init__(channel)
        except OSError:
            with contextlib.suppress(AttributeError):  # a kernel without CAN has made no socket
                self.shutdown()
            raise


class SocketcanPort:
    """A ``CanPort`` on a SocketCAN interface.

    Frames are stamped by the kernel (software, CLOCK_REALTIME) and the stamp is moved to CLOCK_MONOTONIC by an offset
    taken at the receive. Error frames come as ``CanFrame(is_error=True)``; remote and extended frames are not CANopen
    and are counted in ``foreign_frames``.

    Attributes:
        lost_frames: Frames the kernel dropped because we did not read fast enough, since the port was opened.
        foreign_frames: Remote and extended frames passed over.
        receive_buffer: Bytes the kernel really granted; ``net.core.rmem_max`` limits them.
    """

    def __init__(self, bus: SocketcanBus, clock: Callable[[], int], receive_buffer: int) -> None:
        self._bus = bus
        self._socket = bus.socket
        self._clock = clock
        self.lost_frames = 0
        self.foreign_frames = 0
        with contextlib.suppress(OSError):  # what the kernel cannot grant shows in `receive_buffer`
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self.receive_buffer = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)

    @classmethod
    def open(cls, interface: str, clock: Callable[[], int], receive_buffer: int) -> Self:
        """Bind to ``interface`` (``can0``), with error frames, stamps and drop counts. Raises OSError."""
        return cls(_Bus(interface), clock, receive_buffer)

    def send(self, identifier: int, data: bytes) -> None:
        """Queue one frame. Raises OSError (ENOBUFS: the queue is full; ENETDOWN: the interface is down)."""
        queue(self._bus, can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def request(self, identifier: int, size: int) -> None:
        """Queue a remote frame that asks for ``size`` bytes. Raises OSError."""
        message = can.Message(arbitration_id=identifier, is_extended_id=False, is_remote_frame=True, dlc=size)
        queue(self._bus, message)

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting, up to 4096; waits up to ``timeout_s`` for the first. Raises OSError."""
        if timeout_s > 0.0:
            self._poll.poll(timeout_s * 1e3)
        stamped: list[tuple[int, int, bytes, bool]] = []
        while len(stamped) < _MOST_FRAMES:
            try:
                frame, ancillary, _, _ = self._socket.recvmsg(_FRAME.size, _ANCILLARY_BYTES)
            except BlockingIOError:
                break
            except OSError:
                if not stamped:
                    raise
                break  # what has been read is handed over first; the error comes again
            identifier, size, data = _FRAME.unpack(frame)
            if identifier & (_EXTENDED | _REMOTE) and not identifier & _ERROR:
                self.foreign_frames += 1
                continue
            realtime_ns = 0
            for level, kind, value in ancillary:
                if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack(value)
                    realtime_ns = seconds * 1_000_000_000 + nanoseconds
                elif level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL:
                    (self.lost_frames,) = _DROPS.unpack(value)
            is_error = bool(identifier & _ERROR)
            stamped.append((realtime_ns, identifier & (_ALL_ERRORS if is_error else 0x7FF), data[:size], is_error))
        if not stamped:
            return []
        offset = realtime_minus_monotonic(self._clock)
        return [CanFrame(stamp - offset, identifier, data, error) for stamp, identifier, data, error in stamped]

    def gather(self, seconds: float) -> list[CanFrame]:
        """See ``Gathers``: the kernel stamps and keeps them. Raises OSError."""
        time.sleep(seconds)
        return self.receive(0.0)

    def mute(self) -> None:
        """Have the kernel pass no more frames to us. Raises OSError."""
        self._bus.set_filters([_NOTHING])
        self._socket.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0)

    def close(self) -> None:
        """Close the socket."""
        self._bus.shutdown()
