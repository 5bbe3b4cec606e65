"""The controller as a stream of SCALAR rows: set-up of its outputs, data packages in, lost ones found by its clock."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, FrameError
from drivers.ports import SerialPort, Station
from drivers.records import SampleStatus, Severity
from drivers.serial_line.device import MS, Clock, OpenPort, ReceivedBytes
from drivers.serial_line.frames import frames_heard
from drivers.serial_line.scalars import ScalarStream, StreamConfig
from drivers.ur_rtde import packet
from drivers.ur_rtde.packet import IN_USE, Package, PackageStream, Recipe, RtdeChannel

LARGEST_RATE_HZ = 500.0  # of an e-Series; a CB3 has 125 Hz
TICK_S = 1e-6
LARGEST_COUNT = 2.0**62
LONGEST_S = 1e9  # of a controller's time since its start
CLOCKS_AGREE = 1e-3  # its crystal is good for 1e-4; beyond ten times that its time has begun again,
ARRIVES_WITHIN_S = 0.2  # and so much later a package may arrive
MEASURED_FROM, UPDATING = 5, 8  # robot_mode IDLE: the joints have power; the mode of a firmware update
NORMAL = 0x1  # of safety_status_bits
REDUCED = 0x2
SAFETY = {  # the other bits
    2: "protective stop",
    3: "recovery mode",
    4: "safeguard stop",
    5: "system emergency stop",
    6: "robot emergency stop",
    7: "emergency stop",
    8: "violation",
    9: "fault",
    10: "stopped due to safety",
}
MODES = {-1: "no controller", 0: "disconnected", 1: "confirm safety", 2: "booting", 3: "power off", 4: "power on"}
LEVELS = {2: Severity.WARNING, 3: Severity.INFO}
_OWN = {"timestamp": "DOUBLE", "robot_mode": "INT32", "safety_status_bits": "UINT32"}
ANSWERED_NS = 500 * MS  # a controller answers within a few control cycles of 2 to 8 ms
JOINTS = range(1, 7)
_NOT_VALID, _AFTER_RESET = np.uint8(SampleStatus.NOT_VALID), np.uint8(SampleStatus.AFTER_RESET)


@dataclass(frozen=True)
class RtdeConfig(StreamConfig):
    """How a controller is read.

    Attributes:
        rate_hz: Packages a second, 1 to 500 (CB3: 125); a whole fraction of the control rate.

    Raises:
        ConfigurationError: A value out of range.
    """

    rate_hz: float = 125.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate_hz <= LARGEST_RATE_HZ:
            raise ConfigurationError(f"rate_hz = {self.rate_hz:g}: a controller sends 1 to 500 packages a second")


class UrRtde(ScalarStream[RtdeChannel]):
    """Outputs of one controller as SCALAR rows; all channels of a package have its number and its time.

    ``tick`` is the controller's ``timestamp``, us. ``device_status`` is the low byte of ``safety_status_bits``.
    ``status`` is NOT_VALID while the joints have no power (their angles are not measured then), for a number that is
    not finite, and where the time does not advance; AFTER_RESET where the controller started again. An output that the
    controller has not is reported and left out; the rest is recorded.

    Args:
        name: Source of its events.
        channels: At least one, with different names.
        open_port: Opens the connection.
        clock: CLOCK_MONOTONIC, ns.
        config: How it is read.

    Raises:
        ConfigurationError: No channel, or two with one name.
    """

    def __init__(
        self,
        name: str,
        channels: Sequence[RtdeChannel],
        open_port: OpenPort,
        clock: Clock,
        config: RtdeConfig | None = None,
    ) -> None:
        self.config = RtdeConfig() if config is None else config
        super().__init__(name, channels, open_port, clock, self.config)
        self._wanted_types = _OWN | {one.variable: "VECTOR6D" for one in channels}
        self._names: list[str] = []  # outputs that were asked for
        self._stream = PackageStream()
        self._awaited = 0  # type of the answer that is due; DATA: it sends
        self._has_asked = False  # since the last look at what came
        self._recipe = Recipe(0, {})
        self._missing: dict[str, str] = {}  # outputs that it has not, and what it says of them
        self._version = ""
        self._following = dict.fromkeys(self._channels, 0)  # first number that is not recorded, by channel
        self._last: tuple[int, int] | None = None  # tick and arrival of the last package
        self._safety, self._has_power = NORMAL, True

    # Set-up

    def _opened(self, now_ns: int) -> None:
        self._stream.clear()
        self._broken = False  # a connection begins with a package
        self._names = list(self._wanted_types)
        self._ask(now_ns, packet.VERSION, packet.version_request())

    def _ask(self, now_ns: int, kind: int, request: bytes) -> None:
        self._awaited, self._has_asked = kind, True
        self._link.write(now_ns, request)

    def _act(self, now_ns: int) -> bool:
        super()._act(now_ns)
        asked, self._has_asked = self._has_asked, False
        return asked

    def _ask_for_outputs(self, now_ns: int) -> None:
        self._ask(now_ns, packet.OUTPUTS, packet.outputs_request(self.config.rate_hz, self._names))

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        data: list[bytes] = []
        before = self.bad_frames
        for one in self._frames_in(chunk, self._stream):
            try:
                if one.kind == packet.DATA and self._awaited == packet.DATA:
                    data.append(self._checked(one.payload))
                else:
                    self._answered(now_ns, one)
            except FrameError as error:
                self._bad_frame(chunk.host_ns, error)
            if self.bad_frames != before or not self._link.is_open:
                break
        if data:
            self._hand_over(chunk.host_ns, np.frombuffer(b"".join(data), self._recipe.dtype))
        if self.bad_frames != before:  # a stream of packages has no mark to find the next one by
            self._link.drop(now_ns, "out_of_step", f"{self._last_error}; the connection is opened anew")

    def _answered(self, now_ns: int, one: Package) -> None:
        """Whatever is not data: the answer that is due leads to the next request."""
        if one.kind == packet.TEXT:
            text = packet.decode_text(one.payload)
            severity = LEVELS.get(text.level, Severity.ERROR)
            self._report.event(now_ns, severity, "controller", f"{text.source}: {text.message}")
        elif one.kind != self._awaited:
            return  # of a session before this one, or nothing that was asked for
        elif one.kind == packet.VERSION:
            if not packet.decode_accepted(one.payload):
                self._link.drop(now_ns, "refused", "protocol version 2 is refused: update the controller's software")
                return
            self._ask(now_ns, packet.URCONTROL, packet.package(packet.URCONTROL))
        elif one.kind == packet.URCONTROL:
            version = packet.decode_urcontrol(one.payload)
            if version != self._version:
                self._version = version
                self._report.event(now_ns, Severity.INFO, "identified", f"URControl {version}")
            self._ask_for_outputs(now_ns)
        elif one.kind == packet.OUTPUTS:
            self._set_up(now_ns, packet.decode_recipe(one.payload, self._names))
        elif not packet.decode_accepted(one.payload):
            self._link.drop(now_ns, "refused", "it does not start to send: see the log of the controller")
        else:
            self._awaited = packet.DATA

    def _set_up(self, now_ns: int, recipe: Recipe) -> None:
        lacking = recipe.unusable(self._wanted_types)
        taken = [name for name, told in lacking.items() if told == IN_USE]
        usable = [name for name in self._names if name not in lacking]
        if taken:
            text = f"{', '.join(taken)}: IN_USE by another client; close that, or take them out of the file"
            self._link.drop(now_ns, "in_use", text)
        elif "timestamp" in lacking or not any(one.variable in usable for one in self._channels.values()):
            text = f"it has none of the outputs, or no time for them ({', '.join(lacking)}): update its software"
            self._link.drop(now_ns, "not_found", text)
        elif lacking:
            if not lacking.items() <= self._missing.items():
                told = ", ".join(f"{name} is {what}" for name, what in lacking.items())
                text = f"{told}: left out, as this controller has it not; take it out of the file"
                self._report.event(now_ns, Severity.ERROR, "not_found", text)
            self._missing |= lacking
            self._names = usable
            self._ask_for_outputs(now_ns)
        elif not recipe.identifier:
            text = f"rate_hz = {self.config.rate_hz:g} or its outputs are refused: a CB3 sends at most 125 a second"
            self._link.drop(now_ns, "refused", text)
        else:
            self._recipe = recipe
            self._ask(now_ns, packet.START, packet.package(packet.START))

    def _checked(self, payload: bytes) -> bytes:
        size, known = self._recipe.dtype.itemsize, self._recipe.identifier
        if len(payload) != size or payload[0] != known:
            raise FrameError(f"{len(payload)} bytes of recipe {payload[:1].hex()} are no {size} of {known:02x}")
        (time_s,) = np.frombuffer(payload, ">f8", 1, 1)  # "timestamp" is first
        if not 0.0 <= time_s <= LONGEST_S:
            raise FrameError(f"a controller that has been on for {time_s:g} s")
        return payload

    # Data

    def _hand_over(self, host_ns: int, table: NDArray[np.void]) -> None:
        """Rows of packages that came together."""
        if self._last is None:
            self._report.event(host_ns, Severity.INFO, "started", "receiving data")
        self._heard(host_ns)
        ticks = np.rint(table["timestamp"] / TICK_S).astype(np.int64)
        status = np.zeros(len(table), np.uint8)
        numbers = np.empty(len(table), np.int64)
        cause = "port_lost" if self._was_down else "packages_lost"
        for k, tick in enumerate(ticks.tolist()):
            lost, status[k] = self._step(host_ns, tick)
            self._next += lost
            numbers[k] = self._next
            self._next += 1
            self._last, self._was_down = (tick, host_ns), False
        names = self._recipe.types
        safety = table["safety_status_bits"] if "safety_status_bits" in names else np.full(len(table), NORMAL)
        if "robot_mode" in names:
            off = (table["robot_mode"] < MEASURED_FROM) | (table["robot_mode"] == UPDATING)
            status |= off * _NOT_VALID
            self._tell_power(host_ns, int(table["robot_mode"][-1]), is_on=not off[-1])
        for bits in np.unique(safety).tolist():  # a stop that is over within one read is reported, too
            self._tell_safety(host_ns, bits)
        self._tell_safety(host_ns, int(safety[-1]))
        for one in self._channels.values():
            if one.variable in names:
                rows = self._rows(one, host_ns, numbers, ticks)
                values = table[one.variable][:, one.place]
                good = np.abs(values) < LARGEST_COUNT * abs(one.scale)  # false of what is not finite
                rows["value_raw"] = np.rint(np.where(good, values, 0.0) / abs(one.scale))
                rows["scale"] = one.scale
                rows["device_status"] = safety & 0xFF
                rows["status"] = status | ~good * _NOT_VALID
                self._name_gaps(host_ns, one.channel, numbers, cause, counted=not (status & _AFTER_RESET).any())
                self._report.rows(one.channel, rows)

    def _step(self, host_ns: int, tick: int) -> tuple[int, np.uint8]:
        """Packages that are missing before the one of ``tick``, and its status."""
        if self._last is None:
            return 0, np.uint8(0)
        since_us, waited_us = tick - self._last[0], 1e-3 * (host_ns - self._last[1])
        began_anew = since_us < 0
        if self._was_down and abs(since_us - waited_us) > CLOCKS_AGREE * waited_us + 1e6 * ARRIVES_WITHIN_S:
            began_anew = True  # and has been on for longer than before
        if began_anew:
            self._report.event(host_ns, Severity.WARNING, "restarted", "the controller's time began anew")
            return max(0, round(1e3 * waited_us / self._frame_ns) - 1), _AFTER_RESET
        if since_us == 0:
            return 0, _NOT_VALID
        return max(0, round(1e3 * since_us / self._frame_ns) - 1), np.uint8(0)

    def _name_gaps(
        self, host_ns: int, channel: str, numbers: NDArray[np.int64], cause: str, *, counted: bool = False
    ) -> None:
        """Record what a channel lacks before each of these numbers."""
        expected = np.append(self._following[channel], numbers[:-1] + 1)
        for k in np.flatnonzero(numbers > expected).tolist():
            first, last = int(expected[k]), int(numbers[k]) - 1
            duration_ns = round((last - first + 1) * self._frame_ns)
            self._report.gap(host_ns, channel, first, last, duration_ns, cause, counted=counted)
        self._following[channel] = int(numbers[-1]) + 1

    def _end_stream(self, now_ns: int) -> bool:
        sends = self._awaited in (packet.START, packet.DATA)
        return sends and self._link.write(now_ns, packet.package(packet.PAUSE)) is not None

    def _finish(self, now_ns: int) -> None:
        if self._last is None:
            return
        silent_ns = now_ns - self._last[1]
        if self._was_down or self._misses_its_end(silent_ns, self._frame_ns):
            self._next += int(silent_ns / self._frame_ns)
        for channel, one in self._channels.items():
            cause = "not_found" if one.variable in self._missing else "silent"
            self._name_gaps(now_ns, channel, np.array([self._next]), cause)
            self._following[channel] = self._next
        self._last = None

    # Reports

    def _tell_power(self, host_ns: int, mode: int, *, is_on: bool) -> None:
        if is_on != self._has_power:
            self._has_power = is_on
            if is_on:
                self._report.event(host_ns, Severity.INFO, "arm_on", "the joints have power again")
            else:
                text = f"robot mode {mode} ({MODES.get(mode, 'firmware update')}): angles are not measured: power it on"
                self._report.event(host_ns, Severity.ERROR, "arm_off", text)

    def _tell_safety(self, host_ns: int, bits: int) -> None:
        if bits & ~(NORMAL | REDUCED) == self._safety & ~(NORMAL | REDUCED):
            return
        self._safety = bits
        told = ", ".join(text for bit, text in SAFETY.items() if bits >> bit & 1)
        if told:
            self._report.event(host_ns, Severity.ERROR, "safety", f"{told}: clear it on the teach pendant")
        else:
            self._report.event(host_ns, Severity.INFO, "safety_normal", "it may move again")


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The joints of a controller that answers; none: nobody answers, or it is no RTDE; no output is asked for.

    Raises:
        OSError: The connection fails.
    """
    stream = PackageStream()
    try:
        version = _answer(port, wait, stream, packet.VERSION, packet.version_request())
        if version is None:
            return
        if not packet.decode_accepted(version):
            yield Station(0, "RTDE, protocol version 2 is refused: update the controller's software", is_read=False)
            return
        software = _answer(port, wait, stream, packet.URCONTROL, packet.package(packet.URCONTROL))
        told = "" if software is None else f", URControl {packet.decode_urcontrol(software)}"
    except FrameError:
        return
    for number in JOINTS:
        yield Station(number, f"UR controller{told}: number = {number}")


def _answer(
    port: SerialPort, wait: Callable[[float], object], stream: PackageStream, kind: int, request: bytes
) -> bytes | None:
    """The payload of the answer to a request; None: it does not come."""
    port.write(request)
    for one in frames_heard(port, wait, stream, ANSWERED_NS):
        if one.kind == kind:
            return one.payload
    return None
