"""A GPIO line of the kernel as the output that drives the sync line, by libgpiod version 2."""

from collections.abc import Callable
from typing import Self

import gpiod
from gpiod.line import Direction, Value

from drivers.ports import Driven
from drivers.transports.clock import wait_until


class GpiodOutput:
    """A ``PulseOutputPort`` on one line, low when opened."""

    def __init__(self, request: gpiod.LineRequest, line: int, clock: Callable[[], int]) -> None:
        self._request = request
        self._line = line
        self._clock = clock

    @classmethod
    def open(cls, chip: str, line: int, clock: Callable[[], int]) -> Self:
        """Request ``line`` of ``chip`` (``/dev/gpiochip0``) as an output. Raises OSError."""
        settings = gpiod.LineSettings(direction=Direction.OUTPUT, output_value=Value.INACTIVE)
        return cls(gpiod.request_lines(chip, {line: settings}, consumer="heft"), line, clock)

    def wait_until(self, instant_ns: int) -> None:
        """Return at ``instant_ns``, or at once when that has passed."""
        wait_until(instant_ns, self._clock)

    def drive(self, high: bool) -> Driven:
        """Set the level, between two stamps. Raises OSError."""
        value = Value.ACTIVE if high else Value.INACTIVE
        before_ns = self._clock()
        self._request.set_value(self._line, value)
        return Driven(before_ns, self._clock())

    def close(self) -> None:
        """Set the line low and release it."""
        try:
            self._request.set_value(self._line, Value.INACTIVE)
        finally:
            self._request.release()
