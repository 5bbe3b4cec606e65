"""Serial link that is reopened after a fault, and the base class of devices on one.

A USB adapter that was unplugged returns as another port, so a device gets a port factory instead of a port. The port
does not stamp data: the stamp is taken with the device's clock when a read returns.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from drivers import transports
from drivers.errors import ConfigurationError, DriverError, FrameError
from drivers.ports import SerialPort
from drivers.records import Batch, Severity
from drivers.reporter import Absence, Reporter
from drivers.serial_line.frames import FrameDecoder

Frame = TypeVar("Frame")
OpenPort = Callable[[], SerialPort]
Clock = Callable[[], int]
Channels = Mapping[str, np.dtype[Any]]

LONGEST_FRESH_READ_NS = 35_000_000
LARGEST_FRESH_READ = 4000
MOST_EXCHANGES = 32  # largest number of exchanges per pump
MS = 1_000_000
SILENT_AT_STOP_NS = 100 * MS
STOP_REST_S = 2e-3  # between two reads of what is still under way at a stop
STOP_SILENT_RESTS = 10  # without a byte, counted and not timed: the computer may stand still meanwhile
STOP_RESTS = 50  # at most, of a device that does not stop


class ReceivedBytes(NamedTuple):
    """Bytes of one read.

    Attributes:
        data: The bytes.
        host_ns: CLOCK_MONOTONIC ns when the read returned.
        fresh: The last byte had just arrived then. False if the stamp may be late (process preempted in the read) or
            the kernel may hold more (its line buffer, counted by ``in_waiting``, holds 4095 bytes).
    """

    data: bytes
    host_ns: int
    fresh: bool = True


class SerialLink:
    """Opens, reads, writes and reopens a serial port.

    An OSError closes the port and is reported once until valid data arrive again (``alive``); the port is reopened
    after a back-off that doubles up to one second.

    Args:
        open_port: Opens the port; raises OSError or DriverError when it cannot.
        clock: CLOCK_MONOTONIC, ns.
        report: Receives the events.
    """

    def __init__(self, open_port: OpenPort, clock: Clock, report: Reporter) -> None:
        self._open_port = open_port
        self._clock = clock
        self._report = report
        self._port: SerialPort | None = None
        self._retry_ns: int | None = None
        self._absence = Absence(report)

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._port is not None

    def connect(self, now_ns: int) -> bool:
        """Open the port if it is closed and the back-off is over; True if it was opened by this call."""
        if self._port is not None or (self._retry_ns is not None and now_ns < self._retry_ns):
            return False
        try:
            self._port = self._open_port()
        except (OSError, DriverError) as error:
            self.drop(now_ns, "bus_error", f"port cannot be opened: {error}: check cable and URL")
            return False
        return True

    def read(self, now_ns: int, at_least: int) -> ReceivedBytes | None:
        """Read all waiting bytes (``at_least`` as many if the port has a timeout); None: no data, or a fault."""
        if self._port is None:
            return None
        began_ns = self._clock()
        try:
            size = max(self._port.in_waiting, at_least)
            data = self._port.read(size) if size else b""
        except OSError as error:
            self.drop(now_ns, "bus_error", f"port cannot be read: {error}: check the cable")
            return None
        host_ns = self._clock()
        fresh = host_ns - began_ns <= LONGEST_FRESH_READ_NS and len(data) <= LARGEST_FRESH_READ
        return ReceivedBytes(data, host_ns, fresh) if data else None

    def write(self, now_ns: int, data: bytes) -> int | None:
        """Send ``data``; returns CLOCK_MONOTONIC ns just before, or None after a fault."""
        if self._port is None:
            return None
        before_ns = self._clock()
        try:
            sent = self._port.write(data)
            if sent is not None and sent != len(data):
                raise OSError(f"{sent} of {len(data)} bytes were taken")
        except OSError as error:
            self.drop(now_ns, "bus_error", f"port cannot be written: {error}: check the cable")
            return None
        return before_ns

    def drop(self, now_ns: int, code: str, text: str) -> None:
        """Close the port, report the reason (once per code) and schedule its reopening."""
        self.close()
        self._retry_ns = self._absence.begin(now_ns, code, text, kind=code)

    def alive(self, now_ns: int) -> None:
        """Valid data arrived: the fault is over."""
        self._absence.end(now_ns)

    def close(self) -> None:
        """Close the port, ignoring an error of the close."""
        port, self._port = self._port, None
        self._retry_ns = None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()


class SerialDevice(ABC):
    """A device on a serial port; satisfies ``drivers.device.Device``.

    ``period_ns`` is the configured poll period. With a period of 0 the port itself has to wait: open it with
    ``timeout_s`` in its URL, then ``pump`` returns when bytes have come or that time is over.

    Args:
        name: Source of its events, and channel or first part of the names of its channels.
        open_port: Opens its port.
        clock: CLOCK_MONOTONIC, ns, for the stamps of what is read.
        poll_period_ms: Time between two pumps, ms.
        silence_ms: Time without a valid frame, ms, after which the port is reopened.

    Raises:
        ConfigurationError: A time is out of range.

    Attributes:
        bad_frames: Number of runs of invalid bytes.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, poll_period_ms: float, silence_ms: float) -> None:
        if poll_period_ms < 0.0 or silence_ms <= 0.0:
            raise ConfigurationError(f"{name}: poll_period_ms is 0 or more, silence_ms more than 0: correct them")
        self.name = name
        self.bad_frames = 0
        self._report = Reporter(name)
        self._link = SerialLink(open_port, clock, self._report)
        self._now = clock
        self._period_ns = round(poll_period_ms * 1e6)
        self._silence_ns = round(silence_ms * 1e6)
        self._running = False
        self._connected = False
        self._heard_ns = self._started_ns = 0
        self._broken = True  # bytes were bad or lost since the last valid frame
        self._last_error = "not a byte"

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: the port waits."""
        return self._period_ns

    @property
    @abstractmethod
    def channels(self) -> Channels:
        """Dtype of every channel it writes, except ``gap`` and ``event``."""

    def start(self, now_ns: int) -> list[Batch]:
        """Open the port and begin. See ``drivers.device.Device``."""
        self._running = True
        self._heard_ns = self._started_ns = now_ns
        self._exchange(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Read the waiting bytes. The port's timeout applies; ``timeout_s`` is not used."""
        del timeout_s
        if self._running:
            self._exchange(now_ns)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Read the rest, end the device's stream and read what is still under way, record missing samples, close."""
        if self._running:
            self._read_rest(now_ns, self._wanted())
            if self._end_stream(now_ns):
                self._read_what_is_under_way(now_ns)
            self._finish(now_ns)
            self._link.close()
            self._connected = self._running = False
            self._report.event(now_ns, Severity.INFO, "stopped", f"stopped, {self.bad_frames} bad frames in all")
        self._report.flush(now_ns)
        return self._report.take()

    def _read_rest(self, now_ns: int, wanted: int = 0) -> bool:
        """Read what has come, and what comes meanwhile; whether there was anything."""
        for place in range(MOST_EXCHANGES):
            chunk = self._link.read(now_ns, wanted)
            if chunk is None:
                return place > 0
            self._receive(now_ns, chunk)
            wanted = 0
        return True

    def _read_what_is_under_way(self, now_ns: int) -> None:
        """Samples made before the device had the request to end its stream: read until nothing comes any more."""
        silent = 0
        for _ in range(STOP_RESTS):
            before_ns = self._now()
            transports.rest(STOP_REST_S)
            silent = 0 if self._read_rest(now_ns) else silent + 1
            if silent >= STOP_SILENT_RESTS or not self._link.is_open or self._now() == before_ns:  # a clock that stands
                return

    def _exchange(self, now_ns: int) -> None:
        link = self._link
        if link.connect(now_ns):
            self._connected = True
            self._heard_ns = now_ns
            self._broken = True
            self._last_error = "not a byte"
            self._opened(now_ns)
        for _ in range(MOST_EXCHANGES):
            chunk = link.read(now_ns, self._wanted())
            if chunk is not None:
                self._receive(now_ns, chunk)
            if not link.is_open or not self._act(now_ns):
                break
        if self._connected and not link.is_open:
            self._connected = False
            self._closed(now_ns)

    @abstractmethod
    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        """Convert the bytes read into rows."""

    def _opened(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """The port has just been opened."""

    def _closed(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """The port was lost."""

    def _wanted(self) -> int:
        """Number of bytes a port with a timeout waits for."""
        return 1

    def _act(self, now_ns: int) -> bool:
        """Do what is due; True if something was sent that may already be answered."""
        if now_ns - self._heard_ns > self._silence_ns:
            silent_ms = self._silence_ns // MS
            last = self._last_error
            text = f"no valid frame for {silent_ms} ms ({last}): check power, wiring, baud rate; port is reopened"
            self._link.drop(now_ns, "silent", text)
        return False

    def _end_stream(self, now_ns: int) -> bool:
        """Ask a device that streams to end that, at a stop; whether it was asked: what it sent before it heard is read.

        One that cannot be asked sends on; what it says after the last read is not of the flight.
        """
        del now_ns
        return False

    def _finish(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """Called before the port is closed."""

    def _misses_its_end(self, silent_ns: int, period_ns: float = 0.0) -> bool:
        """Whether samples of a stream are missing behind its last row.

        Bytes after it were bad, or it stopped long ago.

        Args:
            silent_ns: From the last row to the stop.
            period_ns: Between two rows.
        """
        return self._broken or silent_ns > max(SILENT_AT_STOP_NS, 3.0 * period_ns)

    def _heard(self, now_ns: int) -> None:
        """A valid frame arrived."""
        self._heard_ns = now_ns
        self._link.alive(now_ns)

    def _frames_in(self, chunk: ReceivedBytes, decoder: FrameDecoder[Frame]) -> Iterator[Frame]:
        """Valid frames that the bytes read complete; invalid bytes are reported."""
        decoder.receive(chunk.data)
        while True:
            try:
                frame = decoder.take()
            except FrameError as error:
                self._bad_frame(chunk.host_ns, error)
                continue
            if frame is None:
                return
            yield frame

    def _bad_frame(self, host_ns: int, error: FrameError) -> None:
        """Report invalid bytes, one event per run of them; the first run after opening is not reported."""
        self._last_error = str(error)
        if not self._broken:
            self._broken = True
            self.bad_frames += 1
            self._report.event(host_ns, Severity.WARNING, "bad_frame", self._last_error)
