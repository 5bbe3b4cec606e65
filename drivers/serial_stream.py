"""A serial port that comes and goes, and what all devices on one have in common.

A USB adapter that was pulled is another port when it comes back, so a device is given a factory and not a port. The
port does not stamp: the stamp is taken with the device's clock when a read returns.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, DriverError, FrameError
from drivers.ports import SerialPort
from drivers.records import Batch, Severity
from drivers.reporter import Reporter

OpenPort = Callable[[], SerialPort]
Clock = Callable[[], int]
Channels = Mapping[str, np.dtype[Any]]

BACKOFF_NS = 20_000_000
LONGEST_BACKOFF_NS = 1_000_000_000
LONGEST_FRESH_READ_NS = 35_000_000
LARGEST_FRESH_READ = 4000
TURNS = 32  # exchanges in one pump, at most
MS = 1_000_000


class Chunk(NamedTuple):
    """Bytes of one read.

    Attributes:
        data: The bytes.
        host_ns: CLOCK_MONOTONIC ns when the read returned.
        fresh: The last byte had just come then. Not so when the stamp is late (we were preempted in the read) or the
            kernel may hold more (its line buffer, which is what ``in_waiting`` counts, ends at 4095 bytes).
    """

    data: bytes
    host_ns: int
    fresh: bool = True


class SerialLink:
    """Opens, reads, writes, and opens again.

    An OSError of the port closes it, is told once until bytes of sense have come again (``alive``), and the port is
    opened anew after a back-off that doubles up to a second.

    Args:
        open_port: Opens the port; raises OSError or DriverError when it cannot.
        clock: CLOCK_MONOTONIC, ns.
        report: Where faults are told.
    """

    def __init__(self, open_port: OpenPort, clock: Clock, report: Reporter) -> None:
        self._open_port = open_port
        self._clock = clock
        self._report = report
        self._port: SerialPort | None = None
        self._retry_ns: int | None = None
        self._backoff_ns = BACKOFF_NS
        self._away_since_ns: int | None = None
        self._told = ""

    @property
    def is_open(self) -> bool:
        """There is a port, as far as we know."""
        return self._port is not None

    def connect(self, now_ns: int) -> bool:
        """Open the port if it is closed and its time has come; whether it was opened just now."""
        if self._port is not None or (self._retry_ns is not None and now_ns < self._retry_ns):
            return False
        try:
            self._port = self._open_port()
        except (OSError, DriverError) as error:
            self.drop(now_ns, "bus_error", f"serial port cannot be opened: {error}: check cable and URL")
            return False
        return True

    def read(self, now_ns: int, at_least: int) -> Chunk | None:
        """All bytes waiting; ``at_least`` as many where the port was opened to wait. None: nothing, or a fault."""
        if self._port is None:
            return None
        began_ns = self._clock()
        try:
            size = max(self._port.in_waiting, at_least)
            data = self._port.read(size) if size else b""
        except OSError as error:
            self.drop(now_ns, "bus_error", f"serial port cannot be read: {error}: check the cable")
            return None
        host_ns = self._clock()
        fresh = host_ns - began_ns <= LONGEST_FRESH_READ_NS and len(data) <= LARGEST_FRESH_READ
        return Chunk(data, host_ns, fresh) if data else None

    def write(self, now_ns: int, data: bytes) -> int | None:
        """Send ``data``. CLOCK_MONOTONIC ns just before, or None after a fault."""
        if self._port is None:
            return None
        before_ns = self._clock()
        try:
            sent = self._port.write(data)
            if sent is not None and sent != len(data):
                raise OSError(f"{sent} of {len(data)} bytes were taken")
        except OSError as error:
            self.drop(now_ns, "bus_error", f"serial port cannot be written: {error}: check the cable")
            return None
        return before_ns

    def drop(self, now_ns: int, code: str, text: str) -> None:
        """Close the port, say why (once for the same code) and open it again later."""
        self.close()
        if code != self._told:
            self._report.event(now_ns, Severity.ERROR, code, text)
            self._told = code
        if self._away_since_ns is None:
            self._away_since_ns = now_ns
        self._retry_ns = now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, LONGEST_BACKOFF_NS)

    def alive(self, now_ns: int) -> None:
        """Bytes that make sense have come: whatever was wrong is over."""
        if self._away_since_ns is not None:
            away_ms = (now_ns - self._away_since_ns) // MS
            self._report.event(now_ns, Severity.INFO, "bus_recovered", f"answers again after {away_ms} ms")
            self._away_since_ns = None
        self._told = ""
        self._backoff_ns = BACKOFF_NS

    def close(self) -> None:
        """Give the port back; that it will not close is no reason to keep it."""
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
        silence_ms: Without a valid frame for so long, ms, the port is opened anew.

    Raises:
        ConfigurationError: A time is out of range.

    Attributes:
        bad_frames: Stretches of bytes that were no frame.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, poll_period_ms: float, silence_ms: float) -> None:
        if poll_period_ms < 0.0 or silence_ms <= 0.0:
            raise ConfigurationError(f"{name}: poll_period_ms is 0 or more, silence_ms more than 0: correct them")
        self.name = name
        self.bad_frames = 0
        self._report = Reporter(name)
        self._link = SerialLink(open_port, clock, self._report)
        self._period_ns = round(poll_period_ms * 1e6)
        self._silence_ns = round(silence_ms * 1e6)
        self._running = False
        self._connected = False
        self._heard_ns = 0
        self._broken = True  # bytes were bad or lost since the last valid frame
        self._last_error = "not a byte"

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: the port waits."""
        return self._period_ns

    @property
    @abstractmethod
    def channels(self) -> Channels:
        """Dtype of every channel it writes, ``gap`` and ``event`` aside."""

    def start(self, now_ns: int) -> list[Batch]:
        """Open the port and begin. See ``drivers.device.Device``."""
        self._running = True
        self._heard_ns = now_ns
        self._turn(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Take what has come. How long to wait is the port's own setting; ``timeout_s`` is not used."""
        del timeout_s
        if self._running:
            self._turn(now_ns)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Take what is left, silence the device, name what is missing, close the port."""
        if self._running:
            wanted = self._wanted()
            for _ in range(TURNS):  # what came while the rest was made rows of, too
                chunk = self._link.read(now_ns, wanted)
                if chunk is None:
                    break
                self._receive(now_ns, chunk)
                wanted = 0
            self._finish(now_ns)
            self._link.close()
            self._connected = self._running = False
            self._report.event(now_ns, Severity.INFO, "stopped", f"stopped, {self.bad_frames} bad frames in all")
        self._report.flush(now_ns)
        return self._report.take()

    def _turn(self, now_ns: int) -> None:
        link = self._link
        if link.connect(now_ns):
            self._connected = True
            self._heard_ns = now_ns
            self._broken = True
            self._last_error = "not a byte"
            self._opened(now_ns)
        for _ in range(TURNS):
            chunk = link.read(now_ns, self._wanted())
            if chunk is not None:
                self._receive(now_ns, chunk)
            if not link.is_open or not self._act(now_ns):
                break
        if self._connected and not link.is_open:
            self._connected = False
            self._closed(now_ns)

    @abstractmethod
    def _receive(self, now_ns: int, chunk: Chunk) -> None:
        """Make rows of what was read."""

    def _opened(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """The port has just been opened."""

    def _closed(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """The port was lost."""

    def _wanted(self) -> int:
        """How many bytes a port that waits should wait for."""
        return 1

    def _act(self, now_ns: int) -> bool:
        """Whatever is due; True when something was sent that may already be answered."""
        if now_ns - self._heard_ns > self._silence_ns:
            silent_ms = self._silence_ns // MS
            last = self._last_error
            text = f"no valid frame for {silent_ms} ms ({last}): check power, wiring, baud rate; port is opened anew"
            self._link.drop(now_ns, "silent", text)
        return False

    def _finish(self, now_ns: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """The last act, before the port is closed."""

    def _heard(self, now_ns: int) -> None:
        """A valid frame came."""
        self._heard_ns = now_ns
        self._link.alive(now_ns)

    def _bad_frame(self, host_ns: int, error: FrameError) -> None:
        """Bytes were no frame. One event for a stretch of them; the stretch a port is opened into is not told."""
        self._last_error = str(error)
        if not self._broken:
            self._broken = True
            self.bad_frames += 1
            self._report.event(host_ns, Severity.WARNING, "bad_frame", self._last_error)
