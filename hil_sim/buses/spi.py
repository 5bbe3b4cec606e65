"""SPI with one chip on it: its wires, and the kernel's spidev nodes in this process, one for each select line.

A node is an empty file of a directory: ``fcntl.ioctl`` is replaced by one that answers spidev's requests (``'k'``, with
the numbers and the structure of ``uapi/linux/spi/spidev.h``) at such a file, and passes on all others.
"""

import ctypes
import errno
import fcntl
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind

_TYPE, _IS_MESSAGE, _IS_MODE, _IS_BITS, _IS_SPEED = 0x6B, 0, 1, 3, 4
_TRANSFER: Final = struct.Struct("<QQIIHBBBBBx")


class SpiChip(Protocol):
    """A chip on the wires; ``mode``: CPOL x 2 + CPHA."""

    mode: int

    def advance(self, now_ns: int) -> None:
        """Do what is due."""

    def exchange(self, frame: bytes, now_ns: int) -> bytes:
        """One frame: selected, so many bytes in and as many out, deselected."""


class SpiBus:
    """The wires. A frame is an instant; where no chip drives the line to the computer, it reads zeros.

    Args:
        second: The same wires with another select line, for a chip of two ``dies``.
    """

    def __init__(self, second: "SpiBus | None" = None) -> None:
        self.frames = 0
        self._second = second
        self._chip: SpiChip | None = None
        self._faults = NO_FAULTS

    @property
    def due_ns(self) -> int:
        """Never: the chip is asked."""
        return NEVER

    def add(self, chip: Any) -> None:
        """Connect the chip, an ``SpiChip``, or one with two of them as ``dies``.

        Raises:
            ValueError: there is one already.
        """
        first, *others = getattr(chip, "dies", (chip,))
        if self._chip is not None or (others and self._second is None):
            raise ValueError("There is a chip on this select line; give the other one a line of its own.")
        self._chip = first
        if others and self._second is not None:
            self._second.add(*others)

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that an SPI adapter cannot have.
        """
        self._faults = faults.require(FaultKind.UNPLUG)
        if self._second is not None:
            self._second.inject(faults)

    def advance(self, now_ns: int) -> None:
        """Let the chip do what is due."""
        if self._chip is not None:
            self._chip.advance(now_ns)

    def takes(self, mode: int) -> bool:
        """Whether the chip understands this mode."""
        return self._chip is None or mode == self._chip.mode

    def check(self, now_ns: int) -> None:
        """Raises OSError: the adapter is pulled out."""
        if self._faults and self._faults.active(FaultKind.UNPLUG, now_ns) is not None:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """Frames of ``address`` bytes, as ``spi+unix`` asks ``I2cSocket`` for them. Raises OSError."""
        self.check(now_ns)
        if not address or len(write) % address or read_count != len(write):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        answer = b""
        for at in range(0, len(write), address):
            self.frames += 1
            frame = write[at : at + address]
            answer += bytes(address) if self._chip is None else self._chip.exchange(frame, now_ns)
        return answer


_real: Final = fcntl.ioctl
_nodes: dict[tuple[int, int], tuple[SpiBus, Callable[[], int]]] = {}


def _ioctl(fd: Any, request: int, argument: Any = 0, *further: Any) -> Any:
    if request >> 8 & 0xFF != _TYPE or not isinstance(fd, int):
        return _real(fd, request, argument, *further)
    status = os.fstat(fd)
    node = _nodes.get((status.st_dev, status.st_ino))
    if node is None:
        return _real(fd, request, argument, *further)
    bus, clock = node
    bus.check(clock())
    match request & 0xFF:
        case code if code == _IS_MESSAGE:
            _message(bus, argument, clock)
        case code if code == _IS_MODE and bus.takes(argument[0]):
            pass
        case code if code in (_IS_BITS, _IS_SPEED):
            pass
        case _:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
    return 0


def _message(bus: SpiBus, argument: Any, clock: Callable[[], int]) -> None:
    transfers = list(_TRANSFER.iter_unpack(bytes(argument)))
    if any(bool(one[6]) == (number == len(transfers) - 1) for number, one in enumerate(transfers)):
        raise OSError(errno.EINVAL, "frames that are not deselected after each")
    for tx, rx, length, *_ in transfers:
        data = ctypes.string_at(tx, length)
        ctypes.memmove(rx, bus.transfer(length, data, length, clock()), length)


def install_spi(path: Path, bus: SpiBus, clock: Callable[[], int]) -> Callable[[], None]:
    """Make ``path``, and serve it as a spidev node to this process; returns the undoing.

    Args:
        path: Of the node, in a directory that is there.
        bus: The wires.
        clock: ``CLOCK_MONOTONIC`` ns, or a virtual clock; read at each frame.
    """
    path.touch()
    status = path.stat()
    key = status.st_dev, status.st_ino
    _nodes[key] = bus, clock
    vars(fcntl).update(ioctl=_ioctl)

    def uninstall() -> None:
        _nodes.pop(key, None)
        path.unlink(missing_ok=True)
        if not _nodes:
            vars(fcntl).update(ioctl=_real)

    return uninstall
