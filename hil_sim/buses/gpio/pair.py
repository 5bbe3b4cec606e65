"""A clock line and a data line to one chip: the wires."""

import errno
import os
import struct
from typing import Final, Protocol

from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind

_CLOCKED: Final = struct.Struct("<II")
_HALF_PULSE_NS: Final = 1_000  # of a simulated flight computer that nothing interrupts: the data sheet's typical time


class ClockedChip(Protocol):
    """A chip on the two wires."""

    def advance(self, now_ns: int) -> None:
        """Do what is due."""

    def clock_line(self, high: bool, now_ns: int) -> None:
        """The clock line was set."""

    def data_line(self, now_ns: int) -> bool:
        """Whether the data line is high; so it is where the chip does not drive it."""


class PairBus:
    """The two wires. An edge is an instant."""

    def __init__(self) -> None:
        self.pulses = 0
        self._chip: ClockedChip | None = None
        self._faults = NO_FAULTS
        self._high = False

    @property
    def due_ns(self) -> int:
        """Never: the chip is asked."""
        return NEVER

    def add(self, chip: ClockedChip) -> None:
        """Connect the chip.

        Raises:
            ValueError: there is one already.
        """
        if self._chip is not None:
            raise ValueError("There is a chip on these two lines; give the other chip two other lines.")
        self._chip = chip

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that the GPIO chip cannot have.
        """
        self._faults = faults.require(FaultKind.UNPLUG)

    def advance(self, now_ns: int) -> None:
        """Let the chip do what is due."""
        if self._chip is not None:
            self._chip.advance(now_ns)

    def drive(self, high: bool, now_ns: int) -> None:
        """Set the clock line. Raises OSError."""
        self._check(now_ns)
        self.pulses += high and not self._high
        if self._chip is not None and high != self._high:
            self._chip.clock_line(high, now_ns)
        self._high = high

    def level(self, now_ns: int) -> bool:
        """Whether the data line is high. Raises OSError."""
        self._check(now_ns)
        return self._chip is None or self._chip.data_line(now_ns)

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """A request of a flight computer in another process, see ``I2cSocket``: as ``gpio-pair+unix`` sends it."""
        match (address, len(write), read_count):
            case (0, 0, 1):
                return bytes([self.level(now_ns)])
            case (0, 1, 0):
                self.drive(bool(write[0]), now_ns)
                return b""
            case (0, 1, _CLOCKED.size):
                return _CLOCKED.pack(self._clock_out(write[0], now_ns), _HALF_PULSE_NS)
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def _clock_out(self, pulses: int, now_ns: int) -> int:
        bits = 0
        for _ in range(pulses):
            self.drive(True, now_ns)
            now_ns += _HALF_PULSE_NS
            self.drive(False, now_ns)
            now_ns += _HALF_PULSE_NS
            bits = bits << 1 | self.level(now_ns)
        return bits & 0xFFFF_FFFF

    def _check(self, now_ns: int) -> None:
        if self._faults and self._faults.active(FaultKind.UNPLUG, now_ns) is not None:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
