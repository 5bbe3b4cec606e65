"""Network ports as the byte stream that ``drivers.ports.SerialPort`` describes: a TCP connection, a UDP socket."""

import contextlib
import socket
from collections.abc import Mapping
from typing import Self

from drivers.errors import UrlError
from drivers.transports.url import parse

TCP_URLS = {"tcp": ("host",)}
UDP_URLS = {"udp": ("host",)}
CONNECT_S = 1.0  # a host that is off answers nothing: its bus, which has a thread of its own, waits as long
BUFFER = 4 << 20  # of datagrams, asked of the kernel, which doubles and limits it
_MOST = 1 << 16


def host_and_port(url: str, kinds: Mapping[str, tuple[str, ...]], example: str) -> tuple[str, int]:
    """Host and port of a URL.

    Args:
        url: ``SCHEME://HOST:PORT``.
        kinds: Schemes that it can have.
        example: One that is right.

    Raises:
        UrlError: The URL is not of this form.
    """
    host, _, port = parse(url, kinds).host.rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise UrlError(f"bus URL {url!r} needs a host and a port: write {example}")
    return host.strip("[]"), int(port)


class NetworkPort:
    """A socket with one peer. It does not wait.

    Args:
        connection: The connected socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._waiting = b""

    def read(self, size: int = 1) -> bytes:
        """See ``SerialPort``."""
        data, self._waiting = self._waiting[:size], self._waiting[size:]
        return data

    def write(self, data: bytes, /) -> int:
        """See ``SerialPort``; by UDP one datagram."""
        return self._connection.send(data)

    def close(self) -> None:
        """See ``SerialPort``."""
        self._connection.close()


class TcpPort(NetworkPort):
    """An open connection. An end that the other side closes is an OSError, after the bytes before it."""

    @classmethod
    def open(cls, url: str) -> Self:
        """Connect.

        Args:
            url: ``tcp://HOST:PORT``.

        Raises:
            UrlError: The URL is not of this form.
            OSError: Nobody answers there.
        """
        address = host_and_port(url, TCP_URLS, "tcp://192.168.0.10:30004")
        connection = socket.create_connection(address, CONNECT_S)
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return cls(connection)

    @property
    def in_waiting(self) -> int:
        """See ``SerialPort``."""
        with contextlib.suppress(BlockingIOError):
            while data := self._connection.recv(_MOST):
                self._waiting += data
                if len(self._waiting) >= _MOST:
                    break
            if not data and not self._waiting:
                raise ConnectionResetError("the other side closed the connection")
        return len(self._waiting)


class UdpPort(NetworkPort):
    """A socket with one peer, whose datagrams each follow their length, a big-endian uint16.

    Datagrams of others are not received. A peer that refuses is an OSError of the next call.
    """

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
