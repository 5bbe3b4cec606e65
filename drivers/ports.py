"""Protocols of the buses, as used by the device drivers.

``drivers.transports`` implements them for real ports; of our packages ``hil_sim`` may import this module only. Ports
stamp arriving data; the layers above do not read a clock.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol


class I2cReply(NamedTuple):
    """Bytes read, and CLOCK_MONOTONIC ns when the transfer had ended."""

    data: bytes
    host_ns: int


class I2cPort(Protocol):
    """An I2C master. Raises OSError with the kernel's errno (EREMOTEIO, ENXIO, ETIMEDOUT, EIO) when it fails."""

    def write(self, address: int, data: bytes) -> None:
        """START, address+W, ``data``, STOP."""

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """START, address+W, ``data``, repeated START, address+R, ``count`` bytes, STOP: one indivisible transfer."""

    def close(self) -> None:
        """Release the bus."""


class SpiPort(Protocol):
    """An SPI master with the select line of one chip. Raises OSError when it is gone; that a chip is, it cannot see."""

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """Exchange ``data`` in frames of ``size`` bytes, the chip deselected after each; what came back."""

    def close(self) -> None:
        """Release it."""


class CanFrame(NamedTuple):
    """A received classic CAN frame. ``identifier`` is the 11-bit COB-ID, or the error class bits of an error frame."""

    host_ns: int
    identifier: int
    data: bytes
    is_error: bool = False


class CanPort(Protocol):
    """A CAN controller. Raises OSError when the bus is gone."""

    def send(self, identifier: int, data: bytes) -> None:
        """Queue one frame for sending."""

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting; waits up to ``timeout_s`` for the first. Empty when none came."""

    def mute(self) -> None:
        """Take no more frames from the bus; those already received can still be read."""

    def close(self) -> None:
        """Release the bus."""


class Gathers(Protocol):
    """A CAN port that can take the frames of some time at once, for less than if each wakes its reader."""

    def gather(self, seconds: float) -> list[CanFrame]:
        """The frames of the next so many seconds, stamped as ``receive`` stamps them. Raises OSError."""


def gathered(port: CanPort, seconds: float) -> list[CanFrame]:
    """The frames of the next so many seconds where ``port`` is one that :class:`Gathers`; else none, at once."""
    gather: Callable[[float], list[CanFrame]] | None = getattr(port, "gather", None)  # isinstance takes 20 us
    return [] if gather is None else gather(seconds)


class Look(NamedTuple):
    """Whether a data line is high, and CLOCK_MONOTONIC ns when that had been read."""

    high: bool
    host_ns: int


class Clocked(NamedTuple):
    """Level of a data line after each pulse of its clock line, the first one in the highest bit.

    ``high_ns``: longest time for which the clock line may have been high; ``host_ns``: when the last pulse had ended.
    """

    bits: int
    high_ns: int
    host_ns: int


class ClockedPort(Protocol):
    """A clock line out and a data line in. Raises OSError when they are gone."""

    def look(self) -> Look:
        """Level of the data line."""

    def drive(self, high: bool) -> None:
        """Set the clock line."""

    def clock_out(self, pulses: int) -> Clocked:
        """Pulses of the clock line, as short as they can be."""

    def close(self) -> None:
        """Release both lines."""


class Edge(NamedTuple):
    """A rising edge of the sync line: when the kernel saw it, when we read it, and its number on the line."""

    edge_ns: int
    host_ns: int
    line_sequence: int


class PulsePort(Protocol):
    """An input line with edge events. Raises OSError when the line is gone."""

    def receive(self, timeout_s: float) -> list[Edge]:
        """All edges waiting; waits up to ``timeout_s`` for the first."""

    def close(self) -> None:
        """Release the line."""


class Driven(NamedTuple):
    """An output line was set between these two instants, CLOCK_MONOTONIC ns."""

    before_ns: int
    after_ns: int


class PulseOutputPort(Protocol):
    """An output line that can be set at a given instant. Raises OSError when the line is gone."""

    def wait_until(self, instant_ns: int) -> None:
        """Return at CLOCK_MONOTONIC ``instant_ns``, or at once when that has passed."""

    def drive(self, high: bool) -> Driven:
        """Set the level."""

    def close(self) -> None:
        """Set the line low and release it."""


class SerialAdapter(NamedTuple):
    """A serial port that exists: a bus URL with a usual speed, and the name that the adapter reports."""

    url: str
    what: str


class Station(NamedTuple):
    """Who answers on a serial line: its number, its name in words, and whether the driver that asked reads it."""

    number: int
    what: str
    is_read: bool = True


class SerialPort(Protocol):
    """The part of ``serial.Serial`` that the drivers use."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Send ``data``."""

    def close(self) -> None:
        """Release the port."""
