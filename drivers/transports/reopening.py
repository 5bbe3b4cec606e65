"""A port that is opened again after what it was on has gone: the base of such ports of every kind of bus."""

import contextlib
import errno
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from drivers.errors import DriverError

STILL_THERE = frozenset({errno.EAGAIN, errno.EINTR, errno.ETIMEDOUT})  # errors after which a port works again
FIRST_PAUSE_NS, LONGEST_PAUSE_NS = 20_000_000, 1_000_000_000  # before it is opened again
_NEVER = 1 << 63


class _Closable(Protocol):
    def close(self) -> None: ...


Port = TypeVar("Port", bound=_Closable)
Result = TypeVar("Result")


class Reopening(Generic[Port]):
    """One port after the other, each opened by ``open_port`` when the one before has failed.

    Every call raises OSError while there is none. It is opened again after 20 ms, then ever later, up to every second.

    Args:
        open_port: Opens the port; OSError or DriverError if it cannot.
        clock: CLOCK_MONOTONIC, ns.
        what: Its name in messages.
        still_there: Error numbers after which the same port works again.

    Raises:
        OSError, DriverError: The port cannot be opened the first time.

    Attributes:
        reopened: Number of times the port was opened again.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        clock: Callable[[], int],
        what: str,
        still_there: frozenset[int] = STILL_THERE,
    ) -> None:
        self._open_port, self._clock, self._what, self._still_there = open_port, clock, what, still_there
        self._port: Port | None = open_port()
        self._retry_ns, self._pause_ns = 0, FIRST_PAUSE_NS
        self.reopened = 0

    @property
    def port(self) -> Port | None:
        """The port that is open."""
        return self._port

    def close(self) -> None:
        """Close the port. It is not opened again."""
        self._drop()
        self._retry_ns = _NEVER

    def _gone(self, port: Port) -> None:
        """A port is about to be closed."""

    def _drop(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            self._gone(port)
            with contextlib.suppress(OSError):
                port.close()

    def _tried(self, act: Callable[[Port], Result]) -> Result:
        port = self._port if self._port is not None else self._opened()
        try:
            return act(port)
        except OSError as error:
            if error.errno not in self._still_there:
                self._drop()
                self._wait()
            raise

    def _opened(self) -> Port:
        now_ns = self._clock()
        if now_ns < self._retry_ns:
            raise OSError(errno.ENODEV, f"{self._what} is gone")
        try:
            self._port = port = self._open_port()
        except (OSError, DriverError) as error:
            self._wait()
            raise OSError(errno.ENODEV, f"{self._what} is gone: {error}") from error
        self.reopened += 1
        self._pause_ns = FIRST_PAUSE_NS
        return port

    def _wait(self) -> None:
        self._retry_ns = self._clock() + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
