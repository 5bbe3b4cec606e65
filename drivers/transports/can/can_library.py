"""CAN through python-can: every adapter it has an interface for, and its in-process ``virtual`` bus.

SocketCAN and ASCII adapters have ports of their own (``can_socket``, ``can_slcan``), which can count what was dropped
and read faster; this one is for what they do not reach (PCAN, Kvaser, IXXAT, gs_usb ...), and for a simulator that
stands in the same process where time is simulated too.
"""

import errno
from collections.abc import Callable
from typing import Protocol, Self, runtime_checkable

import can

from drivers.ports import CanFrame
from drivers.transports.clock import realtime_minus_monotonic
from drivers.transports.url import BusUrl


@runtime_checkable
class HasFrames(Protocol):
    """A bus that returns stamped frames without making messages of them: a simulator's."""

    def frames(self) -> list[CanFrame] | None:
        """All waiting frames; None where they must be read as messages. Raises ``can.CanError``."""


def queue(bus: can.BusABC, message: can.Message) -> None:
    """Send ``message``; what python-can raises becomes an OSError, without a code ENOBUFS: the bus takes no more."""
    try:
        bus.send(message)
    except can.CanError as error:
        raise OSError(error.error_code or errno.ENOBUFS, f"CAN send failed: {error}") from error


class LibraryCanPort:
    """A ``CanPort`` on a python-can bus that stamps its messages.

    Attributes:
        foreign_frames: Remote and extended frames passed over.
    """

    def __init__(self, bus: can.BusABC, clock: Callable[[], int], *, monotonic_stamps: bool) -> None:
        self._bus = bus
        self._clock = clock
        self._monotonic_stamps = monotonic_stamps
        self._has_frames = bus if isinstance(bus, HasFrames) and monotonic_stamps else None
        self.foreign_frames = 0
        self._muted_ns: int | None = None

    @classmethod
    def open(cls, url: BusUrl, clock: Callable[[], int]) -> Self:
        """Open the interface named in ``url``, or join the virtual channel.

        Raises:
            OSError: the interface cannot be opened.
        """
        if url.kind == "can+python":
            return cls(_interface(url), clock, monotonic_stamps=False)
        stamps = url.options.get("timestamps", "realtime")
        try:
            bus = can.Bus(interface="virtual", channel=url.host, preserve_timestamps=True, ignore_config=True)
        except can.CanError as error:
            raise OSError(error.error_code or errno.ENODEV, f"python-can cannot open {url.host}: {error}") from error
        return cls(bus, clock, monotonic_stamps=stamps == "monotonic")

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame, stamped with our clock. Raises OSError."""
        stamp_s = self._clock() * 1e-9
        queue(self._bus, can.Message(stamp_s, identifier, is_extended_id=False, data=data))

    def request(self, identifier: int, size: int) -> None:
        """Send a remote frame that asks for ``size`` bytes. Raises OSError."""
        stamp_s = self._clock() * 1e-9
        queue(self._bus, can.Message(stamp_s, identifier, is_extended_id=False, is_remote_frame=True, dlc=size))

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting; waits up to ``timeout_s`` for the first. Raises OSError."""
        messages: list[can.Message] = []
        try:
            if self._has_frames is not None and (ready := self._has_frames.frames()):
                return ready if self._muted_ns is None else [one for one in ready if one.host_ns <= self._muted_ns]
            message = self._bus.recv(timeout_s)
            while message is not None:
                messages.append(message)
                message = self._bus.recv(0.0)
        except can.CanError as error:
            raise OSError(error.error_code or errno.EIO, f"CAN receive failed: {error}") from error
        if not messages:
            return []
        offset = 0 if self._monotonic_stamps else realtime_minus_monotonic(self._clock)
        frames = []
        for message in messages:
            if (message.is_extended_id or message.is_remote_frame) and not message.is_error_frame:
                self.foreign_frames += 1
                continue
            host_ns = round(message.timestamp * 1e9) - offset
            if self._muted_ns is None or host_ns <= self._muted_ns:
                frames.append(CanFrame(host_ns, message.arbitration_id, bytes(message.data), message.is_error_frame))
        return frames

    def mute(self) -> None:
        """Pass over what is stamped later than now."""
        self._muted_ns = self._clock()

    def close(self) -> None:
        """Leave the channel."""
        self._bus.shutdown()


def _interface(url: BusUrl) -> can.BusABC:
    """The python-can bus of a ``can+python`` URL."""
    name, _, channel = url.path.strip("/").partition("/")
    bitrate = url.integer("bitrate")
    try:
        return can.Bus(interface=name, channel=channel, bitrate=bitrate, ignore_config=True)
    except (can.CanError, ValueError, ImportError, NotImplementedError) as error:
        raise OSError(errno.ENODEV, f"python-can cannot open {name} {channel}: {error}") from error
