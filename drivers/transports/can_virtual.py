"""CAN in one process, by python-can's ``virtual`` bus: where a simulator stands when time is simulated too."""

import errno
from collections.abc import Callable
from typing import Self

import can

from drivers.errors import UrlError
from drivers.ports import CanFrame
from drivers.transports.clock import realtime_minus_monotonic
from drivers.transports.url import BusUrl


class VirtualCanPort:
    """A ``CanPort`` on a python-can bus that stamps its messages.

    Attributes:
        foreign_frames: Remote and extended frames passed over.
    """

    def __init__(self, bus: can.BusABC, clock: Callable[[], int], monotonic_stamps: bool) -> None:
        self._bus = bus
        self._clock = clock
        self._monotonic_stamps = monotonic_stamps
        self.foreign_frames = 0

    @classmethod
    def open(cls, url: BusUrl, clock: Callable[[], int]) -> Self:
        """Join the channel named in ``url``.

        Raises:
            UrlError: ``timestamps`` is neither ``monotonic`` nor ``realtime``.
        """
        stamps = url.options.get("timestamps", "realtime")
        if stamps not in {"monotonic", "realtime"}:
            raise UrlError(f"bus URL {url.text!r}: timestamps={stamps} is unknown: use monotonic or realtime")
        bus = can.Bus(interface="virtual", channel=url.host, preserve_timestamps=True, ignore_config=True)
        return cls(bus, clock, stamps == "monotonic")

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame, stamped with our clock. Raises OSError."""
        stamp_s = self._clock() * 1e-9
        message = can.Message(stamp_s, identifier, is_extended_id=False, data=data)
        try:
            self._bus.send(message)
        except can.CanError as error:
            raise OSError(error.error_code or errno.EIO, f"CAN send failed: {error}") from error

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting; waits up to ``timeout_s`` for the first. Raises OSError."""
        messages: list[can.Message] = []
        try:
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
            frames.append(CanFrame(host_ns, message.arbitration_id, bytes(message.data), message.is_error_frame))
        return frames

    def mute(self) -> None:
        """Nothing to do: nothing arrives unless the one process here makes it."""

    def close(self) -> None:
        """Leave the channel."""
        self._bus.shutdown()
