"""Edges of the sync line as datagrams ``<qI`` (edge ns, line sequence): the line of a simulator."""

import contextlib
import os
import select
import socket
import stat
import struct
from collections.abc import Callable

from drivers.ports import Edge

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
