"""A CAN port that is opened again after its adapter or interface has gone.

An unplugged adapter returns as another tty, an interface that was removed as another one of its name; the old socket or
tty never works again. An interface that is only down keeps its socket, and works again when it is up.
"""

import contextlib
import errno
from collections.abc import Callable
from typing import TypeVar

from drivers.errors import DriverError
from drivers.ports import CanFrame, CanPort

STILL_THERE = frozenset({errno.ENETDOWN, errno.ENOBUFS, errno.EAGAIN, errno.EINTR, errno.ETIMEDOUT})
FIRST_PAUSE_NS, LONGEST_PAUSE_NS = 20_000_000, 1_000_000_000  # before it is opened again
_NEVER = 1 << 63
Result = TypeVar("Result")


class ReopeningCanPort:
    """A ``CanPort`` over ports that ``open_port`` opens, one after the other.

    Every call raises OSError while there is none.

    Args:
        open_port: Opens the port; OSError or DriverError if it cannot.
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        OSError, DriverError: The port cannot be opened the first time.

    Attributes:
        reopened: Number of times the port was opened again.
    """

    def __init__(self, open_port: Callable[[], CanPort], clock: Callable[[], int]) -> None:
        self._open_port, self._clock = open_port, clock
        self._port: CanPort | None = open_port()
        self._lost_before = 0  # frames, on the ports before this one
        self._retry_ns, self._pause_ns = 0, FIRST_PAUSE_NS
        self.reopened = 0

    @property
    def lost_frames(self) -> int:
        """Frames that the ports could not deliver, as far as they count them."""
        return self._lost_before + int(getattr(self._port, "lost_frames", 0))

    @property
    def port(self) -> CanPort | None:
        """The port that is open."""
        return self._port

    def send(self, identifier: int, data: bytes) -> None:
        """See ``CanPort``. Raises OSError."""
        self._tried(lambda port: port.send(identifier, data))

    def request(self, identifier: int, size: int) -> None:
        """Send a remote frame. Raises OSError."""
        self._tried(lambda port: port.request(identifier, size))  # type: ignore[attr-defined]

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See ``CanPort``. Raises OSError."""
        return self._tried(lambda port: port.receive(timeout_s))

    def mute(self) -> None:
        """See ``CanPort``. Raises OSError."""
        self._tried(lambda port: port.mute())

    def close(self) -> None:
        """See ``CanPort``. It is not opened again."""
        self._drop()
        self._retry_ns = _NEVER

    def _drop(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            self._lost_before += int(getattr(port, "lost_frames", 0))
            with contextlib.suppress(OSError):
                port.close()

    def _tried(self, act: Callable[[CanPort], Result]) -> Result:
        port = self._port if self._port is not None else self._opened()
        try:
            return act(port)
        except OSError as error:
            if error.errno not in STILL_THERE:
                self._drop()
                self._wait()
            raise

    def _opened(self) -> CanPort:
        now_ns = self._clock()
        if now_ns < self._retry_ns:
            raise OSError(errno.ENODEV, "the CAN adapter is gone")
        try:
            self._port = port = self._open_port()
        except (OSError, DriverError) as error:
            self._wait()
            raise OSError(errno.ENODEV, f"the CAN adapter is gone: {error}") from error
        self.reopened += 1
        self._pause_ns = FIRST_PAUSE_NS
        return port

    def _wait(self) -> None:
        self._retry_ns = self._clock() + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
