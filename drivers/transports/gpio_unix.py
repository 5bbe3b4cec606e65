"""Edges of the sync line as datagrams ``<qI`` (edge ns, line sequence), in and out: the line of a simulator."""

import contextlib
import os
import select
import socket
import stat
import struct
from collections.abc import Callable

from drivers.ports import Driven, Edge
from drivers.transports.clock import wait_until

_EDGE = struct.Struct("<qI")
_MOST_EDGES = 1024


class UnixPulsePort:
    """A ``PulsePort`` that binds a Unix datagram socket; a socket left there by an earlier run is replaced.

    Attributes:
        damaged: Datagrams of the wrong size.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._path = path
        self._clock = clock
        self.damaged = 0
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(os.stat(path).st_mode):
                os.unlink(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(path)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)

    def receive(self, timeout_s: float) -> list[Edge]:
        """All edges waiting; waits up to ``timeout_s`` for the first. Raises OSError."""
        if timeout_s > 0.0:
            self._poll.poll(timeout_s * 1e3)
        edges: list[Edge] = []
        while len(edges) < _MOST_EDGES:
            try:
                data = self._socket.recv(64)
            except BlockingIOError:
                break
            if len(data) != _EDGE.size:
                self.damaged += 1
                continue
            edge_ns, line_sequence = _EDGE.unpack(data)
            edges.append(Edge(edge_ns, self._clock(), line_sequence))
        return edges

    def close(self) -> None:
        """Close and remove the socket."""
        self._socket.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)


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
