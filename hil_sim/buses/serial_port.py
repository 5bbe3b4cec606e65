"""The flight computer's ends of a serial bus: a port object in this process (T0), and a pseudo-terminal (T1).

``VirtualSerial`` behaves as pyserial 3.5 does on Linux with ``timeout=0``: ``read`` returns what is there, a port whose
adapter is unplugged raises ``serial.SerialException`` with pyserial's text, and opening discards earlier input.
Characters that arrive while the port is closed are lost.
"""

import errno
import fcntl
import os
import select
import struct
import termios
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Self

import serial

from hil_sim.buses.terminal import flush
from hil_sim.devices.serial_wire import LineFormat

_QUEUE_BYTES: Final = 65_536  # a tty's buffers, before it throws characters away
_FLUSHREAD: Final = 1  # linux asm-generic/ioctls.h: TIOCPKT_FLUSHREAD
_TCGETS2: Final = 0x802C_542A  # linux asm-generic/ioctls.h
_TERMIOS2: Final = struct.Struct("=IIIIB19sII")  # iflag, oflag, cflag, lflag, line, cc, ispeed, ospeed


class VirtualSerial:
    """An adapter in this process.

    Args:
        path: Its name, as of a tty.
        on_dtr: Told when the open port's DTR line changes.

    Attributes:
        look: Called before anything is done with it: what is on the line is to be as it is now.
    """

    is_live = False

    def __init__(self, path: str, on_dtr: Callable[[bool], None] | None = None) -> None:
        self.path = path
        self.look: Callable[[], None] = lambda: None
        self.asks: Callable[[bytes], int] = bool
        self.messages = 0  # written to the port, that ask for a sample
        self.discarded = 0  # opening throws away what came before it
        self.overrun = 0  # characters for which there was no room
        self._on_dtr = on_dtr
        self._port: VirtualPort | None = None
        self._unread = 0
        self._plugged = True

    @property
    def line(self) -> LineFormat | None:
        """Speed and format of the open port; None when no process has it open."""
        return None if self._port is None else self._port.line

    def open(self, line: LineFormat) -> "VirtualPort":
        """Open it for one user.

        Raises:
            serial.SerialException: it is not plugged in, or open already.
        """
        self.look()
        if not self._plugged:
            text = f"[Errno {errno.ENOENT}] could not open port {self.path}: [Errno 2] No such file or directory"
            raise serial.SerialException(errno.ENOENT, text)
        if self._port is not None:
            raise serial.SerialException(errno.EAGAIN, f"Could not exclusively lock port {self.path}")
        self._port = VirtualPort(self, line)
        return self._port

    def take(self) -> bytes:
        """Characters the port sent since the last call."""
        if self._port is None:
            return b""
        sent = bytes(self._port.outgoing)
        self._port.outgoing.clear()
        return sent

    def give(self, data: bytes) -> None:
        """Characters it received."""
        if self._port is not None:
            room = _QUEUE_BYTES - len(self._port.incoming)
            self._port.incoming += data[:room]
            self.overrun += max(0, len(data) - room)

    def unread(self) -> int:
        """Characters that it had not read when it closed the port."""
        return self._unread

    def unplug(self) -> None:
        """Pull the adapter out: the open port is dead from now on."""
        self._plugged = False
        self._unread = 0
        if self._port is not None:
            self._port.gone = True
            self._port = None

    def plug(self) -> None:
        """Put it back in."""
        self._plugged = True

    def release(self, port: "VirtualPort") -> None:
        """``port`` is closed."""
        self.look()
        if self._port is port:
            self._port, self._unread = None, len(port.incoming)

    def spoke(self, data: bytes) -> None:
        """``data`` was written to the open port."""
        self.messages += self.asks(data)

    def drive_dtr(self, level: bool) -> None:
        """The open port drives its DTR line."""
        if self._on_dtr is not None:
            self._on_dtr(level)


class VirtualPort:
    """An open port: what of ``serial.Serial`` a driver may use.

    Args:
        adapter: What it is a port of.
        line: Speed and format.
    """

    def __init__(self, adapter: VirtualSerial, line: LineFormat) -> None:
        self.line = line
        self.incoming = bytearray()
        self.outgoing = bytearray()
        self.gone = False
        self.is_open = True
        self.port = adapter.path
        self.timeout: float | None = 0.0
        self._adapter = adapter
        self._dtr = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def in_waiting(self) -> int:
        """Characters that can be read.

        Raises:
            OSError: EIO when the adapter is gone.
        """
        self._adapter.look()
        self._check_open()
        if self.gone:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return len(self.incoming)

    @property
    def baudrate(self) -> int:
        """Speed; it can be changed while open."""
        return self.line.baud_rate

    @baudrate.setter
    def baudrate(self, value: int) -> None:
        self._adapter.look()
        self.line = self.line._replace(baud_rate=value)

    @property
    def dtr(self) -> bool:
        """The DTR line."""
        return self._dtr

    @dtr.setter
    def dtr(self, level: bool) -> None:
        self._adapter.look()
        self._dtr = level
        self._adapter.drive_dtr(level)

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` characters, without waiting.

        Raises:
            serial.SerialException: the port is closed, or its adapter gone.
        """
        self._adapter.look()
        self._check_open()
        if self.gone:
            raise serial.SerialException(
                "device reports readiness to read but returned no data "
                "(device disconnected or multiple access on port?)"
            )
        data = bytes(self.incoming[:size])
        del self.incoming[:size]
        return data

    def write(self, data: bytes, /) -> int:
        """Send.

        Raises:
            serial.SerialException: the port is closed, or its adapter gone.
        """
        self._adapter.look()
        self._check_open()
        if self.gone:
            raise serial.SerialException(f"write failed: [Errno {errno.EIO}] {os.strerror(errno.EIO)}")
        self.outgoing += data
        self._adapter.spoke(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Throw away what was received."""
        self._adapter.look()
        self._check_open()
        self.incoming.clear()

    def reset_output_buffer(self) -> None:
        """Throw away what was not sent yet."""
        self._adapter.look()
        self._check_open()
        self.outgoing.clear()

    def flush(self) -> None:
        """There is nothing to wait for: the line takes everything at once and paces it."""
        self._check_open()

    def set_low_latency_mode(self, enabled: bool) -> None:
        """There is no latency timer here."""
        del enabled

    def close(self) -> None:
        """Give the port back."""
        self.is_open = False
        self._adapter.release(self)

    def _check_open(self) -> None:
        if not self.is_open:
            raise serial.PortNotOpenError


_adapters: Final[dict[str, VirtualSerial]] = {}
_real: Final[Any] = serial.Serial


class _Serial(_real):  # type: ignore[misc]  # pyserial picks its base by platform at run time
    """``serial.Serial`` that knows the simulated paths."""

    def __new__(cls, port: str | None = None, baudrate: int = 9600, *args: Any, **options: Any) -> Any:
        adapter = _adapters.get(port) if port is not None else None
        if adapter is None:
            return super().__new__(cls)
        line = LineFormat(baudrate, options.get("parity", "N"), int(options.get("stopbits", 1)))
        return adapter.open(line)


class InstalledSerial:
    """Paths that ``serial.Serial`` opens in this process until ``uninstall``."""

    def __init__(self, paths: tuple[str, ...]) -> None:
        self._paths = paths

    def uninstall(self) -> None:
        """Take the paths away; with the last one, ``serial.Serial`` is pyserial's own again."""
        for path in self._paths:
            _adapters.pop(path, None)
        if not _adapters:
            serial.Serial = _real  # type: ignore[misc]  # as it was


def install_serial(*adapters: VirtualSerial) -> InstalledSerial:
    """Let ``serial.Serial(path, ...)`` open ``adapters`` by their paths; all other paths stay what they were.

    Raises:
        ValueError: something is installed at one of the paths already.
    """
    for adapter in adapters:
        if adapter.path in _adapters:
            raise ValueError(f"A simulated adapter is at {adapter.path} already; uninstall it first.")
    _adapters.update({adapter.path: adapter for adapter in adapters})
    serial.Serial = _Serial  # type: ignore[misc]  # for the length of a simulated run
    return InstalledSerial(tuple(adapter.path for adapter in adapters))


class PtySerial:
    """An adapter whose far end is a pseudo-terminal, found under a symbolic link as by ``/dev/serial/by-id``.

    Args:
        link: The symbolic link to make, also after each ``plug``; None: ``path`` is the terminal's name.
    """

    is_live = True

    def __init__(self, link: Path | None = None) -> None:
        self.asks: Callable[[bytes], int] = bool
        self.messages = 0  # taken, that ask for a sample
        self.discarded = 0  # times that the user emptied the terminal's input
        self.overrun = 0  # characters for which there was no room
        self._link = link
        self._output = bytearray()
        self._master = -1
        self._terminal = ""
        self.plug()

    @property
    def path(self) -> str:
        """What to open."""
        return self._terminal if self._link is None else str(self._link)

    @property
    def line(self) -> LineFormat | None:
        """Speed that the user has set; None while no process has the terminal open."""
        if self._master < 0 or self._is_hung_up():
            return None
        settings = _TERMIOS2.unpack(fcntl.ioctl(self._master, _TCGETS2, bytes(_TERMIOS2.size)))
        return LineFormat(max(settings[-1], 1))

    @property
    def files(self) -> list[int]:
        """File descriptors worth waiting for; none while no process has the terminal open."""
        return [] if self._master < 0 or self._is_hung_up() else [self._master]

    def take(self) -> bytes:
        """Characters the user sent since the last call."""
        if self._master < 0:
            return b""
        flush(self._master, self._output)
        try:
            status, *data = os.read(self._master, _QUEUE_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:  # EIO: no process has it open
                raise
            self._output.clear()
            return b""
        self.discarded += status & _FLUSHREAD
        self.messages += self.asks(bytes(data))
        return bytes(data)

    def give(self, data: bytes) -> None:
        """Characters for the user."""
        room = _QUEUE_BYTES - len(self._output)
        self._output += data[:room]
        self.overrun += max(0, len(data) - room)
        flush(self._master, self._output)

    def unread(self) -> int:
        """Characters that the user, who has closed the terminal, had not read: they stay in it."""
        if self._master < 0:
            return 0
        try:
            terminal = os.open(self._terminal, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:  # somebody else has it, and wants it alone
            return 0
        try:
            (waiting,) = struct.unpack("i", fcntl.ioctl(terminal, termios.FIONREAD, bytes(4)))
        finally:
            os.close(terminal)
        return int(waiting) + len(self._output)

    def unplug(self) -> None:
        """Pull the adapter out: who has the terminal open gets an end of file."""
        self.close()

    def plug(self) -> None:
        """Put it back in, on a terminal of its own."""
        self.close()
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 1))  # every read begins with a status
        self._terminal = os.ttyname(slave)
        os.close(slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self._terminal)

    def close(self) -> None:
        """Take it away."""
        if self._master >= 0:
            if self._link is not None:  # first: who sees the end of file may look for it at once
                self._link.unlink(missing_ok=True)
            os.close(self._master)
            self._master = -1
            self._output.clear()

    def _is_hung_up(self) -> bool:
        terminal = select.poll()  # a thread at a time may use one: whoever asks for the line has its own
        terminal.register(self._master, 0)
        return any(events & select.POLLHUP for _, events in terminal.poll(0))
