"""A clock line and a data line to one chip: the wires, and libgpiod's chip in this process that has them as lines.

libgpiod is unmodified but for ``gpiod.request_lines``, which is replaced for the registered paths only.
"""

import errno
import os
import struct
from collections.abc import Callable
from typing import Any, Final, Protocol

import gpiod
from gpiod.line import Direction, Value

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
            raise ValueError("There is a chip on these two lines; give the other one two lines of its own.")
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


class _Request:
    """What ``gpiod.request_lines`` returns, as far as two lines need it."""

    def __init__(self, bus: PairBus, clock: Callable[[], int], config: dict[int, gpiod.LineSettings]) -> None:
        self._bus, self._clock = bus, clock
        self._outputs = {line for line, settings in config.items() if settings.direction is Direction.OUTPUT}
        bus.level(clock())

    def set_value(self, line: int, value: Value) -> None:
        if line not in self._outputs:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        self._bus.drive(value is Value.ACTIVE, self._clock())

    def get_value(self, line: int) -> Value:
        del line
        return Value.ACTIVE if self._bus.level(self._clock()) else Value.INACTIVE

    def release(self) -> None:
        pass


_real: Final = gpiod.request_lines
_chips: dict[str, tuple[PairBus, Callable[[], int]]] = {}


def _request_lines(path: str, config: Any, **options: Any) -> Any:
    if path not in _chips:
        return _real(path, config, **options)
    return _Request(*_chips[path], config)


def install_pair(path: str, bus: PairBus, clock: Callable[[], int]) -> Callable[[], None]:
    """Serve the two lines as a GPIO chip for every ``gpiod.request_lines(path)`` of this process; returns the undoing.

    Args:
        path: For example ``/dev/gpiochip0``; it need not exist, and is hidden if it does.
        bus: The wires.
        clock: ``CLOCK_MONOTONIC`` ns, or a virtual clock; read at each edge and look.
    """
    _chips[path] = bus, clock
    vars(gpiod).update(request_lines=_request_lines)

    def uninstall() -> None:
        _chips.pop(path, None)
        if not _chips:
            vars(gpiod).update(request_lines=_real)

    return uninstall
