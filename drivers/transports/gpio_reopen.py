"""The sync line, in and out, opened again after its GPIO chip or PPS source has gone.

A chip on USB that is unplugged fails every call with ENODEV, and returns as another chip under its name; so does one
whose driver is bound anew. A line that another process has taken meanwhile is busy until it is free.
"""

from collections.abc import Callable

from drivers.ports import Driven, Edge, PulseOutputPort, PulsePort
from drivers.transports.clock import wait_until
from drivers.transports.reopening import Reopening


class ReopeningPulsePort(Reopening[PulsePort]):
    """A ``PulsePort`` over ports that ``open_port`` opens, one after the other; see :class:`Reopening`."""

    def __init__(self, open_port: Callable[[], PulsePort], clock: Callable[[], int]) -> None:
        super().__init__(open_port, clock, "the sync line")

    def receive(self, timeout_s: float) -> list[Edge]:
        """See ``PulsePort``. Raises OSError."""
        return self._tried(lambda port: port.receive(timeout_s))


class ReopeningPulseOutput(Reopening[PulseOutputPort]):
    """A ``PulseOutputPort`` over ports that ``open_port`` opens, one after the other; see :class:`Reopening`."""

    def __init__(self, open_port: Callable[[], PulseOutputPort], clock: Callable[[], int]) -> None:
        super().__init__(open_port, clock, "the sync line")

    def wait_until(self, instant_ns: int) -> None:
        """Return at ``instant_ns``, or at once when that has passed."""
        wait_until(instant_ns, self._clock)

    def drive(self, high: bool) -> Driven:
        """See ``PulseOutputPort``. Raises OSError."""
        return self._tried(lambda port: port.drive(high))
