"""The sensor as a stream of SCALAR rows: set up after each opening of its port, lost frames found by its clock."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.bota_ft.frame import BOOTED, FRAME, INVALID, OVERRANGE, RAW, SKIPS, answer, wrench_stream
from drivers.errors import ConfigurationError
from drivers.ports import SerialPort, Station
from drivers.records import SampleStatus, Severity
from drivers.serial_line.device import MS, Clock, OpenPort, ReceivedBytes
from drivers.serial_line.frames import frames_heard
from drivers.serial_line.scalars import COMPONENTS, ScalarStream, StreamConfig, WrenchChannel

SINC_HZ = 51_200.0  # a frame's period is the sinc length times 19.53125 us
SINC = range(64, 2049)  # by the maker's package bota-driver 1.1.16
BAUD_CODE = 4  # 460,800
WAKES_NS = 200 * MS  # opening the port resets many adapters' sensor: what is heard before is of its last run
BOOTS_NS = 3000 * MS  # the longest from then to "App Init", as the maker's own driver waits
SETTLES_NS = 500 * MS  # from "App Init" till it takes commands, as in the maker's example
ANSWERS_NS = 1000 * MS
CLOCKS_AGREE = 1e-3  # its crystal is good for 1e-4; beyond ten times that its time has begun again,
ARRIVES_WITHIN_US = 2e5  # and so much later a frame may arrive
LARGEST = 1e9  # N, N m: beyond it a number is none
STEP = 2.0**-32
TEMPERATURE = 6  # as a component
TOLD = {
    SKIPS: "it leaves out measurements: choose a lower rate_hz",
    OVERRANGE: "beyond its range",
    INVALID: "its measurements are not valid: it may be damaged",
    RAW: "its numbers are those of the gauges, without its calibration",
}
_KEPT = 400  # bytes of text that an answer is looked for in


@dataclass(frozen=True)
class BotaFtConfig(StreamConfig):
    """How a sensor is read.

    Attributes:
        rate_hz: Frames a second, 25 to 800: 51,200 / ``rate_hz`` is its sinc length, a whole number.

    Raises:
        ConfigurationError: A rate that it has not.
    """

    rate_hz: float = 400.0

    def __post_init__(self) -> None:
        if self.rate_hz <= 0.0 or SINC_HZ / self.rate_hz not in SINC:
            text = "it is 51,200 over a whole number from 64 to 2048: 100, 160, 200, 256, 320, 400, 512, 640, 800"
            raise ConfigurationError(f"rate_hz = {self.rate_hz:g}: {text}")

    @property
    def commands(self) -> tuple[bytes, ...]:
        """The set-up: configuration mode; calibrated binary numbers; filters; run mode."""
        sinc = round(SINC_HZ / self.rate_hz)
        return b"C", b"c,0,1,0,%d" % BAUD_CODE, b"f,%d,0,0,1" % sinc, b"R"


class BotaFt(ScalarStream[WrenchChannel]):
    """Components of one sensor, and its temperature where wanted, as SCALAR rows; all of a frame have its number.

    ``tick`` is the sensor's time since power-up, us, unwrapped; ``device_status`` the low byte of its status.
    ``status`` is SATURATED beyond its range, NOT_VALID where the sensor or the number says so, AFTER_RESET where its
    time began anew. Frames carry no number: what is missing is counted by their times.

    Args:
        name: Source of its events.
        channels: At least one, with different names.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: How it is read.

    Raises:
        ConfigurationError: No channel, or two with one name.
    """

    def __init__(
        self,
        name: str,
        channels: Sequence[WrenchChannel],
        open_port: OpenPort,
        clock: Clock,
        config: BotaFtConfig | None = None,
    ) -> None:
        self.config = BotaFtConfig() if config is None else config
        super().__init__(name, channels, open_port, clock, self.config)
        self._stream = wrench_stream()
        self._text = b""  # what came since the last command
        self._step: int | None = None  # of the set-up, of which the answer is due; None: none was sent yet
        self._opened_ns = self._due_ns = 0  # of the first command, or of that answer
        self._has_booted = self._runs = False
        self._last: tuple[int, int] | None = None  # tick and arrival of the last frame
        self._was_set_up = False  # since the last frame

    # Set-up

    def _opened(self, now_ns: int) -> None:
        self._opened_ns = now_ns
        self._listen(now_ns + BOOTS_NS)

    def _listen(self, due_ns: int, *, has_booted: bool = False) -> None:
        """Wait with the set-up till ``due_ns``, until it says that it has started, or is heard running."""
        self._stream.clear()
        self._text, self._step, self._runs = b"", None, False
        self._due_ns, self._has_booted = due_ns, has_booted

    def _act(self, now_ns: int) -> bool:
        if self._runs:
            return super()._act(now_ns)
        if now_ns < self._due_ns:
            return False
        if self._step is None:
            return self._send(now_ns, 0)
        command = self.config.commands[self._step].decode()
        text = f"{command!r} is not answered ({self._last_error}): check power, wiring, baud rate; port is reopened"
        self._link.drop(now_ns, "no_answer", text)
        return False

    def _send(self, now_ns: int, step: int) -> bool:
        self._step, self._text, self._due_ns = step, b"", now_ns + ANSWERS_NS
        return self._link.write(now_ns, self.config.commands[step]) is not None

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        if not self._runs:
            chunk = chunk._replace(data=self._setting_up(now_ns, chunk))
        if self._runs:
            frames = b"".join(self._frames_in(chunk, self._stream))
            if frames:
                self._hand_over(chunk.host_ns, np.frombuffer(frames, FRAME))

    def _setting_up(self, now_ns: int, chunk: ReceivedBytes) -> bytes:
        """Go on with the set-up; what has come behind its last answer."""
        if self._step is None:
            self._heard_before(now_ns, chunk)
            return b""
        self._text = (self._text + chunk.data)[-_KEPT:]
        command = self.config.commands[self._step]
        got = answer(self._text, command)
        if got is None:
            return b""
        code, end = got
        if code:
            text = f"{command.decode()!r} is refused with code {code}: another sensor or firmware; port is reopened"
            self._link.drop(now_ns, "refused", text)
        elif command != self.config.commands[-1]:
            self._send(now_ns, self._step + 1)
        else:
            self._runs = self._was_set_up = True
            self._heard_ns = now_ns
            return self._text[end:]
        return b""

    def _heard_before(self, now_ns: int, chunk: ReceivedBytes) -> None:
        """Before the set-up: it says that it has started, or sends frames."""
        if self._has_booted:
            return
        self._text = (self._text + chunk.data)[-_KEPT:]
        if BOOTED in self._text:
            self._listen(now_ns + SETTLES_NS, has_booted=True)
        elif any(True for _ in self._frames_in(chunk, self._stream)) and now_ns - self._opened_ns >= WAKES_NS:
            self._due_ns = now_ns

    # Data

    def _hand_over(self, host_ns: int, table: NDArray[np.void]) -> None:
        """Rows of frames that came together."""
        used, status = [], []
        numbers, ticks = [], []
        for place, time_us in enumerate(table["time_us"].tolist()):
            told = self._follows(host_ns, time_us)
            if told is None:
                self._report.event(host_ns, Severity.WARNING, "restarted", "it has been without power: set up anew")
                self._listen(host_ns + SETTLES_NS, has_booted=True)
                break
            used.append(place)
            status.append(told[1])
            numbers.append(self._next)
            ticks.append(told[0])
            self._next += 1
            self._last, self._was_down, self._was_set_up = (told[0], host_ns), False, False
        if not used:
            return
        self._heard(host_ns)
        self._broken = False
        table = table[used]
        self._tell_status(host_ns, table["status"])
        values = np.column_stack([table["wrench"], table["temperature_c"]]).astype(np.float64)  # (n, 7), by component
        is_number = np.abs(values) < LARGEST  # false of what is not finite
        raw = np.rint(np.where(is_number, values, 0.0) / STEP)
        of_rows = np.array(status, np.uint8)[:, None] | ~is_number * np.uint8(SampleStatus.NOT_VALID)
        bad = ((table["status"] & (INVALID | RAW)) != 0) * np.uint8(SampleStatus.NOT_VALID)
        beyond = ((table["status"] & OVERRANGE) != 0) * np.uint8(SampleStatus.SATURATED)
        of_rows[:, :TEMPERATURE] |= (bad | beyond)[:, None]
        for one in self._channels.values():
            rows = self._rows(one, host_ns, numbers, ticks)
            rows["value_raw"], rows["scale"] = raw[:, one.component], STEP
            rows["device_status"], rows["status"] = table["status"] & 0xFF, of_rows[:, one.component]
            self._report.rows(one.channel, rows)

    def _follows(self, host_ns: int, time_us: int) -> tuple[int, int] | None:
        """Tick and status of a frame, after what is missing before it; None: it began anew and is to be set up."""
        if self._last is None:
            self._report.event(host_ns, Severity.INFO, "started", "receiving data")
            return time_us, 0
        tick, before_ns = self._last
        since_us = (time_us - tick + (1 << 31)) % (1 << 32) - (1 << 31)
        waited_us = 1e-3 * (host_ns - before_ns)
        allowed_us = CLOCKS_AGREE * waited_us + ARRIVES_WITHIN_US
        anew = since_us < 0 or since_us > waited_us + allowed_us
        if anew or (self._was_down and since_us < waited_us - allowed_us):
            if not self._was_set_up:
                return None
            self._lose(host_ns, round(1e3 * waited_us / self._frame_ns) - 1)
            return time_us, int(SampleStatus.AFTER_RESET)
        self._lose(host_ns, round(1e3 * since_us / self._frame_ns) - 1, counted=not self._was_set_up)
        return tick + since_us, 0 if since_us else int(SampleStatus.NOT_VALID)

    def _tell_status(self, host_ns: int, status: NDArray[np.uint16]) -> None:
        """Changes of the sensor's status; one that is over within one read is reported, too."""
        for code in [*np.unique(status).tolist(), int(status[-1])]:
            if code == self._status:
                continue
            self._status = code
            told = "; ".join(text for bit, text in TOLD.items() if code & bit) or "bits without a meaning"
            if not code:
                self._report.event(host_ns, Severity.INFO, "sensor_normal", "it has no error any more")
            elif code & (INVALID | RAW):
                self._report.event(host_ns, Severity.ERROR, "sensor_error", f"status {code:04x}h: {told}")
            else:
                self._report.event(host_ns, Severity.WARNING, "sensor_status", f"status {code:04x}h: {told}")

    def _finish(self, now_ns: int) -> None:
        if self._last is not None:
            self._lose_at_end(now_ns, self._last[1])


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The components of a sensor that is heard; it is not asked.

    Raises:
        OSError: The line fails.
    """
    for _ in frames_heard(port, wait, wrench_stream(), BOOTS_NS):
        for number, what in enumerate(COMPONENTS, 1):
            yield Station(number, f"sensor of Bota Systems, {what}: component = {number}")
        return
