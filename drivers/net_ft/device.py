"""The sensor as a stream of SCALAR rows: asked once, lost and repeated records found by their numbers."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, FrameError
from drivers.net_ft.record import ERROR, RECORD, START, STOP, RecordStream, request
from drivers.ports import SerialPort, Station
from drivers.records import SampleStatus, Severity
from drivers.serial_line.device import MS, Clock, OpenPort, ReceivedBytes
from drivers.serial_line.frames import frames_heard
from drivers.serial_line.scalars import COMPONENTS, ScalarStream, StreamConfig

LARGEST_RATE_HZ = 8000.0  # a Net F/T sends up to 7000 records a second, an Axia 7912
FASTER = 1.1  # than ``rate_hz``, at most: records of a stream may not be numbered ahead of what can have been sent
ARRIVES_WITHIN_S = 0.2  # and so much later a record may arrive
SETTLES_NS = 5 * MS  # between two requests: as long as OnRobot's example waits
ANSWERED_NS = 500 * MS
_NUMBERS = 1 << 32


class NetFtChannel(NamedTuple):
    """A channel of SCALAR rows.

    Attributes:
        channel: Its name.
        component: Which of the six: 0 to 2 force along x, y, z, 3 to 5 torque about them.
        scale: ``unit`` per count of the rows.
        unit: SI.
    """

    channel: str
    component: int
    scale: float
    unit: str


@dataclass(frozen=True)
class NetFtConfig(StreamConfig):
    """How a sensor is read.

    Attributes:
        rate_hz: Records a second: *RDT Output Rate* of the sensor's configuration page.
        set_up: Requests before the one that starts it.
        errors: Bits of its status that make its rows not valid.

    Raises:
        ConfigurationError: A value out of range.
    """

    rate_hz: float = 1000.0
    set_up: tuple[bytes, ...] = ()
    errors: int = ERROR

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate_hz <= LARGEST_RATE_HZ:
            raise ConfigurationError(f"rate_hz = {self.rate_hz:g}: a sensor sends 1 to 8000 records a second")


class NetFt(ScalarStream[NetFtChannel]):
    """Components of one sensor as SCALAR rows; all channels of a record have its number.

    ``tick`` is that number, ``device_status`` the high byte of the sensor's status. ``status`` is NOT_VALID where the
    sensor says that it has an error, AFTER_RESET where it was asked anew: its numbers begin at 1 then, and how many
    were lost is estimated by the time that has passed.

    Args:
        name: Source of its events.
        channels: At least one, with different names.
        open_port: Opens the port: of a UDP port, see ``drivers.transports.network``.
        clock: CLOCK_MONOTONIC, ns.
        config: How it is read.

    Raises:
        ConfigurationError: No channel, or two with one name.
    """

    def __init__(
        self,
        name: str,
        channels: Sequence[NetFtChannel],
        open_port: OpenPort,
        clock: Clock,
        config: NetFtConfig | None = None,
    ) -> None:
        self.config = NetFtConfig() if config is None else config
        super().__init__(name, channels, open_port, clock, self.config)
        self._stream = RecordStream()
        self._number: int | None = None  # of the last record of this stream
        self._last_ns: int | None = None  # arrival of the last record
        self._last_sample = 0  # internal, of the last record
        self._requests = deque[bytes]()  # still to be sent
        self._request_ns = 0  # when the next one may be

    def _opened(self, now_ns: int) -> None:
        self._stream = RecordStream()
        self._broken = False  # a datagram is whole, or it is not there
        self._number = None
        self._requests, self._request_ns = deque([*self.config.set_up, request(START)]), now_ns

    def _act(self, now_ns: int) -> bool:
        if self._requests and now_ns >= self._request_ns:
            self._link.write(now_ns, self._requests.popleft())
            self._request_ns = now_ns + SETTLES_NS
        return super()._act(now_ns)

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        data = b"".join(self._frames_in(chunk, self._stream))
        if data:
            self._hand_over(chunk.host_ns, np.frombuffer(data, RECORD))

    def _hand_over(self, host_ns: int, table: NDArray[np.void]) -> None:
        """Rows of records that came together; those that came before, or cannot be, are left out."""
        used, numbers, status = [], [], []
        for place, number in enumerate(table["rdt_sequence"].tolist()):
            if self._number is None:
                ahead = 1
                status.append(self._began(host_ns, int(table["ft_sequence"][place])))
            else:
                ahead = (number - self._number + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2
                if ahead <= 0:
                    text = "a record came twice, or after a later record, and is left out"
                    self._report.event(host_ns, Severity.WARNING, "repeated", text)
                    continue
                if ahead - 1 > self._most_lost(host_ns):
                    text = f"record {number} after {self._number}: more than can have been sent"
                    self._bad_frame(host_ns, FrameError(text))
                    continue
                self._lose(host_ns, ahead - 1, "records_lost", counted=True)
                status.append(0)
            self._number, self._last_ns, self._broken = number, host_ns, False
            used.append(place)
            numbers.append(self._next)
            self._next += 1
        if not used:
            return
        self._heard(host_ns)
        table = table[used]
        self._last_sample = int(table["ft_sequence"][-1])
        self._tell_status(host_ns, table["status"])
        bad = np.where(table["status"] & self.config.errors, np.uint8(SampleStatus.NOT_VALID), np.uint8(0))
        for one in self._channels.values():
            rows = self._rows(one, host_ns, numbers, numbers)
            rows["value_raw"] = table["counts"][:, one.component]
            rows["scale"] = one.scale
            rows["device_status"] = table["status"] >> 24
            rows["status"] = bad | np.array(status, np.uint8)
            self._report.rows(one.channel, rows)

    def _began(self, host_ns: int, sample: int) -> int:
        """A stream begins: count what was lost before it; the status of its first row."""
        if self._last_ns is None:
            self._report.event(host_ns, Severity.INFO, "started", "receiving data")
            return 0
        if sample < self._last_sample:
            self._report.event(host_ns, Severity.WARNING, "restarted", "the sensor has been without power")
        self._lose(host_ns, round((host_ns - self._last_ns) / self._frame_ns) - 1, "silent")
        return int(SampleStatus.AFTER_RESET)

    def _most_lost(self, host_ns: int) -> float:
        """Records that can be missing since the last one."""
        assert self._last_ns is not None
        return FASTER * (host_ns - self._last_ns + 1e9 * ARRIVES_WITHIN_S) / self._frame_ns

    def _tell_status(self, host_ns: int, status: NDArray[np.uint32]) -> None:
        """Changes of the sensor's status; one that is over within one read is reported, too."""
        for code in [*np.unique(status).tolist(), int(status[-1])]:
            if code != self._status:
                self._status = code
                if code & self.config.errors:
                    text = f"status {code:08x}h: see the table of status codes in its manual; its rows are not used"
                    self._report.event(host_ns, Severity.ERROR, "sensor_error", text)
                elif code:
                    self._report.event(host_ns, Severity.WARNING, "sensor_status", f"status {code:08x}h")
                else:
                    self._report.event(host_ns, Severity.INFO, "sensor_normal", "it has no error any more")

    def _end_stream(self, now_ns: int) -> bool:
        return self._link.write(now_ns, request(STOP)) is not None

    def _finish(self, now_ns: int) -> None:
        if self._last_ns is not None:
            silent_ns = now_ns - self._last_ns
            lost = int(silent_ns / self._frame_ns)
            if lost and self._misses_its_end(silent_ns, self._frame_ns):
                self._lose(now_ns, lost, "silent", counted=False)


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The components of a sensor that answers; none: nobody answers, or it sends something else.

    A single record is asked for; a stream that goes to somebody else would end by it.

    Raises:
        OSError: The peer refuses.
    """
    port.write(request(START, records=1))
    for _ in frames_heard(port, wait, RecordStream(), ANSWERED_NS):
        for number, what in enumerate(COMPONENTS, 1):
            yield Station(number, f'RDT sensor, {what}: component = {number}; of OnRobot: kind = "onrobot_hex"')
        return
