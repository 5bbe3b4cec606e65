"""libgpiod's chip in this process whose lines are a clock line and a data line.

libgpiod is unmodified but for ``gpiod.request_lines``, which is replaced for the registered paths only.
"""

import errno
import os
from collections.abc import Callable
from typing import Any, Final

import gpiod
from gpiod.line import Direction, Value

from hil_sim.buses.gpio.pair import PairBus


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
