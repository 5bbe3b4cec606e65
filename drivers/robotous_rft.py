"""Six-axis force-torque sensors of Robotous, RFT series, with a serial interface (RS-232, RS-422, USB).

Sources: the maker's "RFT Series Installation and Operation Manual", revision 1.8, sections 3.3 and 3.4 (easymanua.ls);
commands, packets and the overload byte by the maker's ``RFT_IF_PACKET_Rev1.2`` (github.com/zhanibekrysbek/
rft_sensor_serial) and by two clients that others wrote from the manual, which agree. Code 6 of the output rate is
333 Hz by revision 1.8 and 300 Hz by the maker's header of 2017; codes of the filter run the other way round in that
header, and no filter is used here.

A packet is 55h, a data field of 8 bytes (command) or 16 (response), the low byte of its sum, AAh. A response begins
with the number of its command. Start is answered by the data; stop and bias are not answered. While it sends data it
takes stop and bias alone. Data: 6 x int16, big-endian, Fx to Tz, and the overload byte.

Packets have no number and no time: they are counted. Bytes that make no packet are packets lost, 19 each; after a
pause they are counted by the time passed. Known limits: whole packets that vanish within less than ``LATE_NS`` are
not seen; the sensor's delay is not published.
"""

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from drivers.errors import ConfigurationError, FrameError
from drivers.ports import SerialPort, Station
from drivers.records import SampleStatus, Severity
from drivers.serial_line.device import MS, Clock, OpenPort, ReceivedBytes
from drivers.serial_line.frames import FrameSplitter, frames_heard
from drivers.serial_line.scalars import ScalarStream, StreamConfig, WrenchChannel

SOP, EOP, PACKET_BYTES = 0x55, 0xAA, 19
NAME, SET_FILTER, FILTER, START, STOP, SET_RATE, RATE, BIAS = 1, 8, 9, 11, 12, 15, 16, 17
RATES = {200.0: 0, 10.0: 1, 20.0: 2, 50.0: 3, 100.0: 4, 333.0: 6, 500.0: 7, 1000.0: 8}
FIELD = np.dtype([("command", "u1"), ("counts", ">i2", (6,)), ("overload", "u1"), ("rest", "u1", (2,))])
COUNTS_PER_N = 50.0
MODELS = {  # counts a newton metre
    **dict.fromkeys(("RFT40-SA01", "RFT44-SB01", "RFT60-HA01", "RFT64-SB01"), 2000.0),
    **dict.fromkeys(("RFT64-6A01", "RFT80-6A01", "RFT80-6A02"), 1000.0),
}
ERRORS = {1: "command not supported", 2: "value out of range", 3: "not stored"}
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")  # of the overload byte, from bit 5 to bit 0
HIGHEST, LOWEST = (1 << 15) - 1, -(1 << 15)
STOPS_NS = 100 * MS  # from stop to the first question: as long as clients of others wait
ANSWERS_NS = 500 * MS  # as the maker's node for ROS waits
UNBIASED_NS = 200 * MS  # from bias off to the first valid sample: as long as clients of others wait
LATE_NS = 50 * MS  # three times the 16 ms for which an FTDI adapter holds bytes: a longer pause has lost packets


@dataclass(frozen=True)
class RftConfig(StreamConfig):
    """How a sensor is read.

    Attributes:
        rate_hz: Packets a second: 10, 20, 50, 100, 200, 333, 500 or 1000; set and stored where it has another.
        counts_per_N_m: Divider of its model: 2000 or 1000.

    Raises:
        ConfigurationError: A rate that it has not.
    """

    rate_hz: float = 200.0
    counts_per_N_m: float = 2000.0  # noqa: N815

    def __post_init__(self) -> None:
        if self.rate_hz not in RATES:
            raise ConfigurationError(f"rate_hz = {self.rate_hz:g}: it is 10, 20, 50, 100, 200, 333, 500 or 1000")


def command(*field: int) -> bytes:
    """The packet of a command and its parameters."""
    data = bytes(field).ljust(8, b"\0")
    return bytes([SOP, *data, sum(data) & 0xFF, EOP])


def decode_packet(data: bytes) -> bytes:
    """The data field of a response, (16,) bytes.

    Raises:
        FrameError: It is none, or its sum is wrong.
    """
    if len(data) != PACKET_BYTES or data[0] != SOP or data[-1] != EOP:
        raise FrameError("no packet of 19 bytes from 55h to AAh: check the baud rate and the wiring")
    field = data[1:-2]
    if sum(field) & 0xFF != data[-2]:
        raise FrameError(f"sum {data[-2]:#04x} is not {sum(field) & 0xFF:#04x}: bytes were lost or changed")
    return field


def rft_stream() -> FrameSplitter[bytes]:
    """Splits a byte stream into data fields."""
    return FrameSplitter(SOP, lambda _: PACKET_BYTES, decode_packet)


class _RefusedError(Exception):
    """The sensor is not as configured, and cannot be set so."""


class _Phase(Enum):
    STOPPING = auto()  # till what it still sent has come
    ASKING = auto()
    STARTING = auto()
    RUNNING = auto()


class RobotousRft(ScalarStream[WrenchChannel]):
    """Components of a sensor as SCALAR rows; all of a packet have its number, which is ``tick``, too.

    ``device_status`` is the overload byte. ``status`` is SATURATED where a component is overloaded, for all of them
    (the manual wants all six within their ratings), and at the ends of a number; NOT_VALID until its bias is off;
    AFTER_RESET where packets before it were counted by the time passed.

    Args:
        name: Source of its events.
        channels: At least one, with different names.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: How it is read.

    Raises:
        ConfigurationError: No channel, or two with the same name.
    """

    def __init__(
        self,
        name: str,
        channels: Sequence[WrenchChannel],
        open_port: OpenPort,
        clock: Clock,
        config: RftConfig | None = None,
    ) -> None:
        self.config = RftConfig() if config is None else config
        super().__init__(name, channels, open_port, clock, self.config)
        self._stream = rft_stream()
        self._discarded = 0  # by the stream, up to the last packet
        self._phase = _Phase.STOPPING
        self._questions = self._set_up()
        self._asked = STOP
        self._due_ns = self._unbiased_ns = 0
        self._last_ns: int | None = None  # arrival of the last packet
        self._was_set_up = False  # since the last packet

    # Set-up

    def _opened(self, now_ns: int) -> None:
        self._stream, self._discarded = rft_stream(), 0
        self._questions = self._set_up()
        self._send(now_ns, _Phase.STOPPING, command(STOP), STOPS_NS)

    def _set_up(self) -> Generator[bytes, bytes, None]:
        """Questions, each of which is sent its answer; what is stored in it is written where it differs only."""
        name = (yield command(NAME))[1:].partition(b"\0")[0].decode("ascii", "replace").strip()
        counts = MODELS.get(name[:10], self.config.counts_per_N_m)
        if counts != self.config.counts_per_N_m:
            raise _RefusedError(f"it is {name}, of {counts:g} counts a newton metre: write counts_per_N_m = {counts:g}")
        code = RATES[self.config.rate_hz]
        if (yield command(RATE))[1] != code:
            self._check("output rate", (yield command(SET_RATE, code)))
        if (yield command(FILTER))[1]:
            self._check("no filter", (yield command(SET_FILTER, 0, 0)))

    def _check(self, what: str, field: bytes) -> None:
        if field[1] != 1:
            text = ERRORS.get(field[2], "no reason that is published")
            raise _RefusedError(f"{what} is refused with code {field[2]} ({text}): another sensor or firmware")

    def _send(self, now_ns: int, phase: _Phase, packet: bytes, within_ns: int) -> bool:
        self._phase, self._asked, self._due_ns = phase, packet[1], now_ns + within_ns
        return self._link.write(now_ns, packet) is not None

    def _act(self, now_ns: int) -> bool:
        if self._phase is _Phase.RUNNING:
            return super()._act(now_ns)
        if now_ns < self._due_ns:
            return False
        if self._phase is _Phase.STOPPING:
            return self._send(now_ns, _Phase.ASKING, next(self._questions), ANSWERS_NS)
        text = f"command {self._asked} is not answered ({self._last_error}): check power, wiring, baud rate"
        self._link.drop(now_ns, "no_answer", f"{text}; port is reopened")
        return False

    def _answered(self, now_ns: int, field: bytes) -> None:
        """An answer of the set-up, or the first data."""
        if self._phase is _Phase.STARTING:
            self._phase, self._was_set_up = _Phase.RUNNING, True
            self._unbiased_ns, self._discarded = now_ns + UNBIASED_NS, self._stream.discarded
            self._link.write(now_ns, command(BIAS, 0))
            return
        try:
            self._send(now_ns, _Phase.ASKING, self._questions.send(field), ANSWERS_NS)
        except StopIteration:
            self._send(now_ns, _Phase.STARTING, command(START), ANSWERS_NS)
        except _RefusedError as error:
            self._link.drop(now_ns, "refused", f"{error}; port is reopened")

    # Data

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        fields, damaged = [], []
        for field in self._frames_in(chunk, self._stream):
            if self._phase in (_Phase.ASKING, _Phase.STARTING) and field[0] == self._asked:
                self._answered(now_ns, field)
            if not self._link.is_open and self._phase is not _Phase.RUNNING:
                return
            if self._phase is _Phase.RUNNING and field[0] == START:
                fields.append(field)
                damaged.append(math.ceil((self._stream.discarded - self._discarded) / PACKET_BYTES))
                self._discarded = self._stream.discarded
        if fields:
            self._hand_over(chunk.host_ns, fields, damaged)

    def _hand_over(self, host_ns: int, fields: list[bytes], damaged: list[int]) -> None:
        """Rows of packets that came together; ``damaged``: packets lost before each, by bytes that made none."""
        is_anew = False
        if self._last_ns is None:
            self._report.event(host_ns, Severity.INFO, "started", "receiving data")
        else:
            spare_ns = host_ns - self._last_ns - (len(fields) + sum(damaged)) * self._frame_ns
            is_anew = self._was_set_up or spare_ns > max(LATE_NS, 1.5 * self._frame_ns)
            if is_anew:
                self._lose(host_ns, round(spare_ns / self._frame_ns))
        numbers = []
        for lost in damaged:
            self._lose(host_ns, lost)
            numbers.append(self._next)
            self._next += 1
        self._last_ns, self._was_down, self._was_set_up = host_ns, False, False
        self._heard(host_ns)
        self._broken = False
        table = np.frombuffer(b"".join(fields), FIELD)
        overload = table["overload"] & 0x3F
        self._tell_status(host_ns, overload.tolist())
        status = np.where(overload, np.uint8(SampleStatus.SATURATED), np.uint8(0))
        status |= np.uint8(SampleStatus.NOT_VALID if host_ns < self._unbiased_ns else 0)
        status[0] |= SampleStatus.AFTER_RESET if is_anew else 0
        for one in self._channels.values():
            counts = table["counts"][:, one.component]
            rows = self._rows(one, host_ns, numbers, numbers)
            rows["value_raw"] = counts
            rows["scale"] = 1.0 / (COUNTS_PER_N if one.component < 3 else self.config.counts_per_N_m)
            rows["device_status"] = table["overload"]
            at_end = (counts == HIGHEST) | (counts == LOWEST)
            rows["status"] = status | at_end * np.uint8(SampleStatus.SATURATED)
            self._report.rows(one.channel, rows)

    def _tell_status(self, host_ns: int, overload: list[int]) -> None:
        """Changes of the overload byte, also of what is over within the same read."""
        for code in overload:
            if code == self._status:
                continue
            self._status = code
            if code:
                beyond = ", ".join(axis for bit, axis in enumerate(reversed(AXES)) if code >> bit & 1)
                text = f"beyond 120 % of its rating: {beyond}; take the load off"
                self._report.event(host_ns, Severity.WARNING, "sensor_status", text)
            else:
                self._report.event(host_ns, Severity.INFO, "sensor_normal", "within its rating again")

    def _end_stream(self, now_ns: int) -> bool:
        sends = self._phase in (_Phase.STARTING, _Phase.RUNNING)
        return sends and self._link.write(now_ns, command(STOP)) is not None

    def _finish(self, now_ns: int) -> None:
        if self._last_ns is not None:
            self._lose_at_end(now_ns, self._last_ns)


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The components of a sensor that tells its model's name, or is heard sending data.

    Raises:
        OSError: The line fails.
    """
    port.write(command(NAME))
    for field in frames_heard(port, wait, rft_stream(), ANSWERS_NS):
        if field[0] in (NAME, START):
            for number, axis in enumerate(AXES, 1):
                yield Station(number, f"sensor of Robotous, {axis}: component = {number}")
            return
