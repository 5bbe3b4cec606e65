"""A CAN adapter that speaks the Lawicel ASCII protocol over a pseudo-terminal (CANUSB manual; python-can ``slcan``).

Commands: ``Sn`` and ``sxxyy`` bit rate, ``O`` open, ``L`` listen only, ``C`` close, ``tIIIL..`` and ``TIIIIIIIIL..``
send, ``r`` and ``R`` remote frames (extended ones are not answered), ``V`` and ``v`` versions, ``N`` serial number,
``F`` status flags, ``Z`` time stamps, ``M`` and ``m`` acceptance filter (accepted without effect). CR acknowledges,
BELL refuses. As in the real adapter, open and close are refused when they change nothing, and an adapter at the wrong
bit rate neither receives nor sends.
"""

import errno
import os
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from drivers.ports import CanFrame
from hil_sim.buses.terminal import flush

_OK: Final = b"\r"
_NO: Final = b"\a"
_BIT_RATES: Final = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)
_BTR_BIT_RATES: Final = {0x001C: 500_000, 0x0014: 1_000_000, 0x011C: 250_000, 0x031C: 125_000}  # SJA1000, 16 MHz
_QUEUE_BYTES: Final = 8192
_MAX_COMMAND: Final = 32
_FLAG_RECEIVE_FULL: Final = 0x01


class SlcanAdapter:
    """One adapter; the far end of its pseudo-terminal is ``path``.

    Args:
        bit_rate: Of the bus that it hangs on, bit/s.
        link: The symbolic link to make, also after each ``plug``; None: ``path`` is the terminal's name.
    """

    def __init__(self, bit_rate: int = 500_000, link: Path | None = None) -> None:
        self._link = link
        self._master = -1
        self._slave: int | None = None
        self.lost = 0
        self._bus_bit_rate = bit_rate
        self._sent: list[tuple[int, bytes | int]] = []
        self.plug()

    def plug(self) -> None:
        """Put it in, as it comes from the factory, on a terminal of its own."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        self._slave = slave  # held until the first client is there
        self.hung_up = False  # no process has the terminal open
        self._bit_rate = 0
        self._open = self._listen_only = self._stamps = False
        self._flags = 0
        self._input = bytearray()
        self._output = bytearray()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.path)
            self.path = str(self._link)

    def unplug(self) -> None:
        """Pull it out: who has the terminal open gets an error."""
        self.close()
        self._open, self.hung_up = False, True
        self._output.clear()
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def fileno(self) -> int:
        """The adapter's side of the pseudo-terminal."""
        return self._master

    @property
    def is_open(self) -> bool:
        """Whether the channel is open at the bit rate of the bus."""
        return self._open and self._bit_rate == self._bus_bit_rate

    @property
    def listening(self) -> bool:
        """Whether a client has the channel open."""
        return self.is_open and not self.hung_up

    def take(self) -> list[tuple[int, bytes | int]]:
        """Frames the client sent since the last call; see ``CanLink``."""
        self._receive()
        sent, self._sent = self._sent, []
        return sent

    def give(self, frames: Sequence[CanFrame]) -> None:
        """Frames for the client; those that its queue cannot take are lost, counted, and flagged in ``F``."""
        if not self.is_open:
            return
        for host_ns, identifier, data, _ in frames:
            line = b"t%03X%d%s" % (identifier, len(data), data.hex().upper().encode())
            if self._stamps:
                line += b"%04X" % (host_ns // 1_000_000 % 60_000)
            if len(self._output) + len(line) < _QUEUE_BYTES:
                self._output += line + _OK
            else:
                self.lost += 1
                self._flags |= _FLAG_RECEIVE_FULL
        flush(self._master, self._output)

    def close(self) -> None:
        """Take its terminal away."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        if self._slave is not None:
            os.close(self._slave)
            self._slave = None

    def _receive(self) -> None:
        while data := self._read():
            self._input += data
            *commands, rest = self._input.split(_OK)
            self._input = bytearray() if len(rest) > _MAX_COMMAND else rest
            for command in commands:
                self._output += self._obey(bytes(command.strip(b"\n")))
        flush(self._master, self._output)

    def _read(self) -> bytes:
        if self._master < 0:
            return b""
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self.hung_up = True
            self._output.clear()  # what is sent goes nowhere
            self._input.clear()
            return b""
        self.hung_up = False
        if self._slave is not None:
            os.close(self._slave)
            self._slave = None
        return data

    def _obey(self, command: bytes) -> bytes:
        name, rest = command[:1], command[1:]
        try:
            if name in (b"t", b"T", b"r", b"R"):
                return self._send(name, rest)
            return self._settings(name, rest)
        except ValueError:  # digits that are none
            return _NO

    def _settings(self, name: bytes, rest: bytes) -> bytes:
        answer = _OK
        if name in (b"O", b"L"):
            answer = _NO if self._open or not self._bit_rate else _OK
            if answer == _OK:
                self._open, self._listen_only = True, name == b"L"
        elif name == b"C":
            answer = _OK if self._open else _NO
            self._open = False
        elif name in (b"S", b"s"):
            answer = self._set_bit_rate(name, rest)
        elif name == b"F":
            answer = b"F%02X\r" % self._flags if self._open else _NO
            self._flags = 0
        elif name == b"Z":
            self._stamps = bool(int(rest, 16))
        elif name in (b"V", b"v"):
            answer = name + (b"1013" if name == b"V" else b"0107") + _OK
        elif name == b"N":
            answer = b"NHIL0\r"
        elif name not in (b"", b"M", b"m"):
            answer = _NO
        return answer

    def _set_bit_rate(self, name: bytes, rest: bytes) -> bytes:
        code = int(rest, 16)
        if self._open or (name == b"S" and code >= len(_BIT_RATES)):
            return _NO
        self._bit_rate = _BIT_RATES[code] if name == b"S" else _BTR_BIT_RATES.get(code, 1)
        return _OK

    def _send(self, name: bytes, rest: bytes) -> bytes:
        digits = 3 if name in (b"t", b"r") else 8
        identifier, length = int(rest[:digits], 16), int(rest[digits : digits + 1], 16)
        data = bytes.fromhex(rest[digits + 1 :].decode("ascii"))
        expected = length if name in (b"t", b"T") else 0
        if not self._open or self._listen_only or length > 8 or len(data) != expected or identifier >> 29:
            return _NO
        if digits == 3 and self.is_open:
            self._sent.append((identifier & 0x7FF, data if name == b"t" else length))
        return b"z\r" if digits == 3 else b"Z\r"
