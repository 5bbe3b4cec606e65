"""The sync line as a GPIO line of the kernel, in and out, by libgpiod version 2."""

from collections.abc import Callable
from typing import Self

import gpiod
from gpiod.line import Clock, Direction, Value
from gpiod.line import Edge as EdgeKind

from drivers.ports import Driven, Edge
from drivers.transports.clock import wait_until

_EVENT_BUFFER = 256  # events queued by the kernel: a minute of pulses


class GpiodPort:
    """A ``PulsePort``: rising edges of one line, stamped in the interrupt with CLOCK_MONOTONIC.

    ``line_sequence`` is the kernel's ``line_seqno``, which also counts the events it had to drop.
    """

    def __init__(self, request: gpiod.LineRequest, clock: Callable[[], int]) -> None:
        self._request = request
        self._clock = clock

    @classmethod
    def open(cls, chip: str, line: int, clock: Callable[[], int]) -> Self:
        """Request ``line`` of ``chip`` (``/dev/gpiochip0``) as an input. Raises OSError."""
        settings = gpiod.LineSettings(
            direction=Direction.INPUT, edge_detection=EdgeKind.RISING, event_clock=Clock.MONOTONIC
        )
        request = gpiod.request_lines(chip, {line: settings}, consumer="heft", event_buffer_size=_EVENT_BUFFER)
        return cls(request, clock)

    def receive(self, timeout_s: float) -> list[Edge]:
        """All edges waiting; waits up to ``timeout_s`` for the first. Raises OSError."""
        if not self._request.wait_edge_events(timeout_s):
            return []
        events = self._request.read_edge_events(_EVENT_BUFFER)
        host_ns = self._clock()
        return [Edge(event.timestamp_ns, host_ns, event.line_seqno) for event in events]

    def close(self) -> None:
        """Release the line."""
        self._request.release()


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
