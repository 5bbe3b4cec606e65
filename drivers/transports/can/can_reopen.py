"""A CAN port that is opened again after its adapter or interface has gone.

An unplugged adapter returns as another tty, an interface that was removed as another one of its name; the old socket or
tty never works again. An interface that is only down keeps its socket, and works again when it is up.
"""

import errno
from collections.abc import Callable

from drivers.ports import CanFrame, CanPort, gathered
from drivers.transports.reopening import STILL_THERE, Reopening


class ReopeningCanPort(Reopening[CanPort]):
    """A ``CanPort`` over ports that ``open_port`` opens, one after the other; see :class:`Reopening`."""

    def __init__(self, open_port: Callable[[], CanPort], clock: Callable[[], int]) -> None:
        super().__init__(open_port, clock, "the CAN adapter", STILL_THERE | {errno.ENETDOWN, errno.ENOBUFS})
        self._lost_before = 0  # frames, on the ports before this one

    @property
    def lost_frames(self) -> int:
        """Frames that the ports could not deliver, as far as they count them."""
        return self._lost_before + int(getattr(self._port, "lost_frames", 0))

    def send(self, identifier: int, data: bytes) -> None:
        """See ``CanPort``. Raises OSError."""
        self._tried(lambda port: port.send(identifier, data))

    def request(self, identifier: int, size: int) -> None:
        """Send a remote frame. Raises OSError."""
        self._tried(lambda port: port.request(identifier, size))  # type: ignore[attr-defined]

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See ``CanPort``. Raises OSError."""
        return self._tried(lambda port: port.receive(timeout_s))

    def gather(self, seconds: float) -> list[CanFrame]:
        """See ``Gathers``; none by a port that does not. Raises OSError."""
        return self._tried(lambda port: gathered(port, seconds))

    def mute(self) -> None:
        """See ``CanPort``. Raises OSError."""
        self._tried(lambda port: port.mute())

    def _gone(self, port: CanPort) -> None:
        self._lost_before += int(getattr(port, "lost_frames", 0))
