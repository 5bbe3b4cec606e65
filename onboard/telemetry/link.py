"""Where packets go and come from: a UDP port, a serial line, a file.

A sink never waits: what it does not take at once is kept, and until that is gone no other packet is made. So what is
sent next is always of what is newest.
"""

import contextlib
import os
import socket
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from drivers.transports.serial_port import open_port
from drivers.transports.url import parse as parse_bus

FORMS = "udp://HOST:PORT, serial:///dev/ttyS0?baud=19200, file://PATH, or udp://HOST:PORT?commands=PORT"
_SERIAL = {"serial": ("path", "baud", "parity", "stop_bits")}
_BITS = 10  # of a byte on a serial line: start, eight, stop
_SHARE = 0.95  # of what a line carries: its clock is not exact
_DATAGRAM = 65536
_MOST_DATAGRAMS = 16  # in a step


class LinkError(ValueError):
    """A link that cannot be used, with the remedy."""


class Address(NamedTuple):
    """A link, parsed."""

    text: str
    kind: str  # udp, serial, file
    host: str
    port: int
    path: str
    bytes_s: float | None  # what it carries; None: anything
    commands: int = 0  # port that commands are taken at; 0: any


def parse(text: str) -> Address:
    """Parse a link's URL.

    Raises:
        LinkError: it is none; the message gives the forms.
        UrlError: a serial line's option has no such value.
    """
    kind, separator, rest = text.partition("://")
    if kind == "serial" and separator:
        bus = parse_bus(text, _SERIAL)
        bits = _BITS + (bus.options.get("parity", "N") != "N") + (bus.integer("stop_bits", 1) - 1)
        return Address(text, kind, "", 0, bus.path, _SHARE * bus.integer("baud") / bits)
    if kind == "file" and rest and separator:
        return Address(text, kind, "", 0, rest, None)
    with contextlib.suppress(ValueError):  # not an address, or not a port
        parts = urlsplit(text)
        if kind == "udp" and parts.hostname and parts.port and parts.path in ("", "/"):
            name, _, own = parts.query.partition("=")
            if (name, own) == ("", "") or (name == "commands" and 0 < int(own) < 1 << 16):
                return Address(text, kind, parts.hostname, parts.port, "", None, int(own or 0))
    raise LinkError(f"{text}: give {FORMS}")


class _Bytes:
    """A file or tty: what is written in part goes on with the rest. From a file nothing comes."""

    def __init__(self, descriptor: int, owner: object, origin: str = "") -> None:
        self._descriptor, self._owner, self._rest, self._origin = descriptor, owner, b"", origin

    def ready(self) -> bool:
        """Whether it takes a packet now; hands on what it kept."""
        while self._rest:
            try:
                written = os.write(self._descriptor, self._rest)
            except BlockingIOError:
                return False
            self._rest = self._rest[written:]
        return True

    def send(self, packet: bytes) -> None:
        """Take a packet; only when ready."""
        self._rest = packet
        self.ready()

    def receive(self) -> tuple[bytes, str]:
        """Bytes that came from the other end since the last call, and where from."""
        try:
            return (os.read(self._descriptor, _DATAGRAM) if self._origin else b""), self._origin
        except BlockingIOError:
            return b"", self._origin

    def close(self) -> None:
        self._owner.close()  # type: ignore[attr-defined]


class _Datagrams:
    """A UDP port: a packet a datagram. Nobody need listen."""

    def __init__(self, address: Address) -> None:
        [family, _, _, _, target], *_ = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._target = target
        if address.commands:
            self._socket.bind(("::" if family == socket.AF_INET6 else "", address.commands))

    def ready(self) -> bool:
        return True

    def send(self, packet: bytes) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):  # lost: its count is missing
            self._socket.sendto(packet, self._target)

    def receive(self) -> tuple[bytes, str]:
        """Of the host that packets are sent to; those of others are thrown away."""
        found = b""
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            for _ in range(_MOST_DATAGRAMS):
                data, origin = self._socket.recvfrom(_DATAGRAM)
                found += data if origin[0] == self._target[0] else b""
        return found[:_DATAGRAM], str(self._target[0])

    def close(self) -> None:
        self._socket.close()


Sink = _Bytes | _Datagrams  # takes packets


def sink(address: Address) -> Sink:
    """Open the sending end.

    Raises:
        OSError: it cannot be opened.
    """
    if address.kind == "udp":
        return _Datagrams(address)
    if address.kind == "serial":
        port = open_port(parse_bus(address.text, _SERIAL))
        return _Bytes(port.fileno(), port, address.path)
    file = Path(address.path).open("ab", buffering=0)  # noqa: SIM115
    return _Bytes(file.fileno(), file)


def received(address: Address, commands: deque[bytes] | None = None) -> Iterator[bytes]:
    """Bytes as they come: of a file all, of a port without end, with an empty piece twice a second of silence.

    Args:
        address: to read from.
        commands: packets that are sent to where the others come from, as soon as that is known; those sent are taken
            out. Not to a file.

    Raises:
        OSError: it cannot be opened, or is gone.
    """
    waiting: deque[bytes] = deque() if commands is None else commands
    if address.kind == "file":
        with Path(address.path).open("rb") as file:
            while piece := file.read(_DATAGRAM):
                yield piece
    elif address.kind == "serial":
        port = open_port(parse_bus(address.text, _SERIAL))
        port.timeout = 0.5
        with port:
            while True:
                yield port.read(1) + port.read(port.in_waiting)
                while waiting:
                    port.write(waiting.popleft())
    else:
        [family, _, _, _, own], *_ = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        with socket.socket(family, socket.SOCK_DGRAM) as bound:
            bound.settimeout(0.5)
            bound.bind(own)
            while True:
                try:
                    data, origin = bound.recvfrom(_DATAGRAM)
                except TimeoutError:
                    yield b""
                    continue
                yield data
                while waiting:
                    bound.sendto(waiting.popleft(), origin)
