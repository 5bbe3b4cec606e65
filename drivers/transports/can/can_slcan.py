"""CAN over a tty: the ASCII protocol of Lawicel's CAN232 adapters ("slcan"), codec and port.

Our own codec and not python-can's: that one reads byte by byte (60 us a frame against 4) and raises ValueError, the
bytes gone, on a damaged line. Here a damaged line is counted and the next one is read.
"""

import contextlib
import errno
import os
import re
import select
import time
from binascii import unhexlify
from collections.abc import Callable
from typing import Self

from drivers.errors import FrameError
from drivers.ports import CanFrame, SerialPort
from drivers.transports.serial_port import open_port
from drivers.transports.url import SLCAN_BITRATES, BusUrl

_LONGEST_LINE = 30  # a full extended frame with its time stamp
_GATHER_S = 0.002  # between two reads while frames are gathered: how much later their stamps are
_MOST_BYTES = 65536
_DATA_FRAME = re.compile(rb"t([0-7][0-9A-Fa-f]{2})([0-8])([0-9A-Fa-f]*)")


def encode_line(identifier: int, data: bytes) -> bytes:
    """A standard data frame as the line that makes the adapter send it.

    Raises:
        FrameError: The identifier or the length is not one of classic CAN.
    """
    if not 0 <= identifier <= 0x7FF or len(data) > 8:
        raise FrameError(f"no standard CAN frame: identifier {identifier:#x}, {len(data)} bytes: give 11 bits, 0..8")
    return f"t{identifier:03X}{len(data)}{data.hex().upper()}\r".encode()


def encode_request(identifier: int, size: int) -> bytes:
    """A standard remote frame as the line that makes the adapter send it.

    Raises:
        FrameError: The identifier or the size is not one of classic CAN.
    """
    if not 0 <= identifier <= 0x7FF or not 0 <= size <= 8:
        raise FrameError(f"no standard CAN frame: identifier {identifier:#x}, {size} bytes: give 11 bits, 0..8")
    return f"r{identifier:03X}{size}\r".encode()


def decode_line(line: bytes) -> tuple[int, bytes] | None:
    """A line of the adapter, without its end: identifier and data of a standard data frame.

    A trailing time stamp (four digits, the adapter's milliseconds) is allowed and left. None for everything that
    is no standard data frame: acknowledgements, remote and extended frames, answers to V, N and F.

    Raises:
        FrameError: It begins as a data frame and is none.
    """
    match = _DATA_FRAME.fullmatch(line)
    if match is not None:
        identifier, count, digits = match.groups()
        size = 2 * int(count)
        if len(digits) == size:
            return int(identifier, 16), unhexlify(digits)
        if len(digits) == size + 4:
            return int(identifier, 16), unhexlify(digits[:size])
    if line[:1] != b"t":
        return None
    raise FrameError(f"{line!r} is no slcan frame: check the adapter's baud rate")


class SlcanDecoder:
    """Bytes of the adapter in any pieces, frames out.

    Attributes:
        damaged_lines: Lines that began as a frame and were none.
        refusals: BEL characters: the adapter refused a command or could not queue a frame.
        foreign_frames: Remote and extended frames passed over.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.damaged_lines = 0
        self.refusals = 0
        self.foreign_frames = 0

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Identifier and data of every frame that ``data`` completes."""
        self.refusals += data.count(b"\a")
        *lines, self._rest = (self._rest + data.replace(b"\a", b"\r")).split(b"\r")
        if len(self._rest) > _LONGEST_LINE:
            self._rest = self._rest[-_LONGEST_LINE:]
            self.damaged_lines += 1
        frames = []
        for line in lines:
            try:
                frame = decode_line(line)
            except FrameError:
                self.damaged_lines += 1
                continue
            if frame is not None:
                frames.append(frame)
            elif line[:1] in {b"T", b"r", b"R"}:
                self.foreign_frames += 1
        return frames


class SlcanPort:
    """A ``CanPort`` on an slcan adapter. Stamps are our clock's at the read: they lag the bus by what the tty takes.

    Args:
        port: The tty, non-blocking.
        clock: CLOCK_MONOTONIC, ns.
        wait: Waits so many seconds for bytes.
        descriptor: The tty's, to read it by one system call; None: by ``port`` alone.

    Attributes:
        decoder: Its counters say what did not come through.
    """

    def __init__(
        self, port: SerialPort, clock: Callable[[], int], wait: Callable[[float], object], descriptor: int | None = None
    ) -> None:
        self._port, self._descriptor = port, descriptor
        self._clock = clock
        self._wait = wait
        self.decoder = SlcanDecoder()

    @property
    def lost_frames(self) -> int:
        """Lines that began as a frame and could not be read."""
        return self.decoder.damaged_lines

    @classmethod
    def open(cls, url: BusUrl, clock: Callable[[], int]) -> Self:
        """Open the tty and put the adapter on the bus at the URL's bit rate.

        Raises:
            UrlError: The tty has no such rate.
            OSError: The tty cannot be opened.
        """
        command = SLCAN_BITRATES[url.integer("bitrate")]
        port = open_port(BusUrl(url.text, url.kind, "", url.path, {"baud": str(url.integer("baud", 115_200))}))
        port.write(f"C\r{command}\rO\r".encode())
        return cls(port, clock, lambda timeout_s: select.select([port], [], [], timeout_s), port.fileno())

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame. Raises OSError."""
        self._put(encode_line(identifier, data))

    def request(self, identifier: int, size: int) -> None:
        """Send a remote frame that asks for ``size`` bytes. Raises OSError."""
        self._put(encode_request(identifier, size))

    def _put(self, line: bytes) -> None:
        if self._port.write(line) != len(line):
            raise OSError(errno.EIO, "the tty did not take the whole slcan line")

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting; waits up to ``timeout_s`` for the first bytes. Raises OSError."""
        waiting = self._port.in_waiting
        if waiting == 0 and timeout_s > 0.0:
            self._wait(timeout_s)
            waiting = self._port.in_waiting
        if waiting == 0:
            return []
        data = self._port.read(waiting)
        host_ns = self._clock()
        return [CanFrame(host_ns, identifier, payload) for identifier, payload in self.decoder.feed(data)]

    def gather(self, seconds: float) -> list[CanFrame]:
        """See ``Gathers``: read every 2 ms, so much later are the stamps; decoded at the end. Raises OSError."""
        end_ns = self._clock() + round(seconds * 1e9)
        read: list[tuple[int, bytes]] = []
        while not read or read[-1][0] < end_ns:
            time.sleep(_GATHER_S)
            try:
                data = self._read()
            except OSError:
                if not read:
                    raise
                break  # what has been read is handed over first; the error comes again
            read.append((self._clock(), data))
        return [
            CanFrame(host_ns, identifier, payload)
            for host_ns, data in read
            for identifier, payload in self.decoder.feed(data)
        ]

    def _read(self) -> bytes:
        """Waiting bytes, by one system call; where there are none, by pyserial, which checks that the tty is there.

        Raises:
            OSError: The tty is gone.
        """
        if self._descriptor is not None:
            with contextlib.suppress(OSError):
                if data := os.read(self._descriptor, _MOST_BYTES):
                    return data
        return self._port.read(_MOST_BYTES)

    def mute(self) -> None:
        """Take the adapter off the bus. Raises OSError."""
        self._port.write(b"C\r")

    def close(self) -> None:
        """Take the adapter off the bus, if it still listens, and close the tty."""
        with contextlib.suppress(OSError):
            self._port.write(b"C\r")
        self._descriptor = None
        self._port.close()
