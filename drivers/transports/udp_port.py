"""UDP as the byte stream of ``drivers.ports.SerialPort``: each datagram follows its length, a big-endian uint16."""

import contextlib
import socket
from typing import Self

from drivers.transports.tcp_port import host_and_port

UDP_URLS = {"udp": ("host",)}
BUFFER = 4 << 20  # asked of the kernel, which doubles and limits it: a quarter of a second at the fastest sensor's rate
_MOST = 1 << 16


class UdpPort:
    """A socket with one peer; datagrams of others are not received. A peer that refuses is an OSError of the next call.

    Args:
        connection: The connected socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._waiting = b""

    @classmethod
    def open(cls, url: str) -> Self:
        """Open a port of this computer for one peer.

        Args:
            url: ``udp://HOST:PORT`` of the peer.

        Raises:
            UrlError: The URL is not of this form.
            OSError: No such host, or no port is free.
        """
        host, port = host_and_port(url, UDP_URLS, "udp://192.168.1.1:49152")
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        connection = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            connection.connect(address)
        except OSError:
            connection.close()
            raise
        return cls(connection)

    @property
    def in_waiting(self) -> int:
        """See ``SerialPort``."""
        with contextlib.suppress(BlockingIOError):
            while len(self._waiting) < _MOST:
                data = self._connection.recv(_MOST)
                self._waiting += len(data).to_bytes(2, "big") + data
        return len(self._waiting)

    def read(self, size: int = 1) -> bytes:
        """See ``SerialPort``; it does not wait."""
        data, self._waiting = self._waiting[:size], self._waiting[size:]
        return data

    def write(self, data: bytes, /) -> int:
        """See ``SerialPort``: one datagram."""
        return self._connection.send(data)

    def close(self) -> None:
        """See ``SerialPort``."""
        self._connection.close()
