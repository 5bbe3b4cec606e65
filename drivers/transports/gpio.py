"""The sync line as a GPIO line of the kernel, by libgpiod version 2."""

from collections.abc import Callable
from typing import Self

import gpiod
from gpiod.line import Clock, Direction
from gpiod.line import Edge as EdgeKind

from drivers.ports import Edge

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
