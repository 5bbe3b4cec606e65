"""CAN port wrapper: turns faults, lost frames and error frames of a ``CanPort`` into events; never raises."""

from typing import Protocol, runtime_checkable

from drivers.ports import CanFrame, CanPort, gathered
from drivers.records import Severity
from drivers.reporter import Reporter

RETRY_NS = 20_000_000  # between two pumps while the port fails
DRAINS, DRAIN_S = 16, 0.03  # receives at a stop, of a muted port, until one is empty
ERROR_CLASSES = {  # linux/can/error.h
    0x001: "transmit timeout",
    0x002: "arbitration lost",
    0x004: "controller state",
    0x008: "protocol violation",
    0x010: "transceiver",
    0x020: "no acknowledgement",
    0x040: "bus off",
    0x080: "bus error",
    0x100: "restarted",
}
BUS_OFF = 0x040


@runtime_checkable
class CountsLostFrames(Protocol):
    """A port that counts frames it could not deliver."""

    @property
    def lost_frames(self) -> int:
        """Frames lost since the port was opened."""


@runtime_checkable
class AsksForFrames(Protocol):
    """A port that can send remote frames."""

    def request(self, identifier: int, size: int) -> None:
        """Send a remote frame that asks for ``size`` bytes. Raises OSError."""


class BusPort:
    """A ``CanPort`` whose faults become events instead of exceptions.

    Args:
        port: The port.
        report: Receives events for faults, losses and error frames.

    Attributes:
        now_ns: CLOCK_MONOTONIC of the current pump, the time of its events.
    """

    def __init__(self, port: CanPort, report: Reporter) -> None:
        self.now_ns = 0
        self._port = port
        self._report = report
        self._failing_since_ns: int | None = None
        self._counting: CountsLostFrames | None = None
        self._lost_frames = 0

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: ``receive`` waits for frames. Non-zero only while the port fails."""
        return 0 if self._failing_since_ns is None else RETRY_NS

    @property
    def can_request(self) -> bool:
        """Whether the port can send remote frames."""
        return isinstance(self._port, AsksForFrames)

    def start(self) -> None:
        """Reset the fault state; frames are received from now on."""
        self._counting = self._port if isinstance(self._port, CountsLostFrames) else None

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        try:
            self._port.send(identifier, data)
        except OSError as error:
            self._failed(error)

    def request(self, identifier: int) -> None:
        """Send a remote frame of one byte, if the port ``can_request``."""
        if isinstance(self._port, AsksForFrames):
            try:
                self._port.request(identifier, 1)
            except OSError as error:
                self._failed(error)

    def mute(self) -> None:
        """Take no more frames from the bus; those already received can still be read."""
        try:
            self._port.mute()
        except OSError as error:
            self._failed(error)

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """The frames waiting; waits up to ``timeout_s`` for the first."""
        try:
            frames = self._port.receive(timeout_s)
        except OSError as error:
            self._failed(error)
            return []
        if self._counting is not None and self._counting.lost_frames != self._lost_frames:
            lost = self._counting.lost_frames - self._lost_frames
            self._lost_frames += lost
            text = f"the port lost {lost} frames: raise net.core.rmem_max, or check the adapter's baud rate"
            self._report.event(self.now_ns, Severity.WARNING, "frames_lost", text)
        if self._failing_since_ns is not None and frames:
            down_ms = (self.now_ns - self._failing_since_ns) // 1_000_000
            self._failing_since_ns = None
            self._report.event(self.now_ns, Severity.INFO, "bus_recovered", f"CAN frames again after {down_ms} ms")
        return frames

    def gather(self, seconds: float) -> list[CanFrame]:
        """The frames of the next so many seconds, where the port can gather them; else none."""
        try:
            return gathered(self._port, seconds)
        except OSError as error:
            self._failed(error)
            return []

    def report_error_frame(self, host_ns: int, classes: int, data: bytes) -> None:
        """Report an error frame as an event."""
        named = [text for bit, text in ERROR_CLASSES.items() if classes & bit]
        severity = Severity.ERROR if classes & BUS_OFF else Severity.WARNING
        text = f"CAN error frame: {', '.join(named) or hex(classes)} ({data.hex()}): check wiring, ends and bit rate"
        self._report.event(host_ns, severity, f"can_error_{classes & 0x1FF:03X}", text)

    def _failed(self, error: OSError) -> None:
        if self._failing_since_ns is None:
            self._failing_since_ns = self.now_ns
            text = f"CAN bus fails ({error}): check that the interface is up; retrying"
            self._report.event(self.now_ns, Severity.ERROR, "bus_error", text)
