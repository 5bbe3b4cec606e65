"""Rising edges as datagrams ``<qI`` (edge ns, line sequence): the sync line driven into a simulator, or a loop."""

import socket
import struct
from collections.abc import Callable

from drivers.ports import Driven
from drivers.transports.clock import wait_until

_EDGE = struct.Struct("<qI")


class UnixPulseOutput:
    """A ``PulseOutputPort`` whose rising edges go to the Unix datagram socket that a ``gpio+unix`` port has bound.

    Edges are sent without waiting for a receiver; those not delivered are counted.

    Args:
        path: The socket.
        clock: CLOCK_MONOTONIC, ns.

    Attributes:
        untaken: Edges that found no socket, or a full one.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._path = path
        self._clock = clock
        self.untaken = 0
        self._edges = 0
        self._high = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def wait_until(self, instant_ns: int) -> None:
        """Return at ``instant_ns``, or at once when that has passed."""
        wait_until(instant_ns, self._clock)

    def drive(self, high: bool) -> Driven:
        """Set the level. Raises OSError."""
        before_ns = self._clock()
        if high and not self._high:
            self._edges += 1
            try:
                self._socket.sendto(_EDGE.pack(before_ns, self._edges % (1 << 32)), self._path)
            except (ConnectionError, FileNotFoundError, BlockingIOError):
                self.untaken += 1
        self._high = high
        return Driven(before_ns, self._clock())

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
