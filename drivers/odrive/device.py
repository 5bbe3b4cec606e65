"""All axes of a CAN bus as one device: what they send unasked becomes SCALAR rows.

Messages carry neither number nor time: ``tick`` is the stamp of their arrival, CLOCK_MONOTONIC ns, and what is missing
is estimated by it, from one read to the next: frames that were read together may have waited.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.canopen_pdo.bus_port import DRAIN_S, DRAINS, BusPort
from drivers.errors import ConfigurationError, FrameError
from drivers.odrive.message import (
    CLOSED_LOOP,
    COUNTS,
    ENCODER_ESTIMATES,
    ERRORS,
    HEARTBEAT,
    INITIALIZING,
    MISSING_ESTIMATE,
    NODES,
    STATES,
    TORQUES,
    Heartbeat,
    decode_heartbeat,
    decode_pair,
    split,
)
from drivers.ports import CanFrame, CanPort
from drivers.records import SCALAR, Batch, SampleStatus, Severity
from drivers.reporter import Reporter

SILENT_NS = 500_000_000  # five heartbeats
LARGEST = 1e9  # rev, rev/s, N m: beyond it a number is none
EARLY = 0.1  # of a period, by which the second of two messages comes too early where none is missing between them
SLOWER = 0.01  # than ``rate_hz``: its crystal is good for 1e-4
FASTER = 0.05  # than ``rate_hz``: messages are set to another rate, and cannot be counted by it


@dataclass(frozen=True)
class OdriveAxis:
    """An axis, and what is recorded of it.

    Attributes:
        name: Channel of its position; ``NAME_velocity`` and ``NAME_torque`` are the others'.
        node: 0 to 63, ``can.node_id``.
        counts_per_revolution: 2^20 times the motor's revolutions in one of the joint; negative where it turns against.
        rate_hz: Of either message, 1000 / ``encoder_msg_rate_ms`` and ``torques_msg_rate_ms``.
        velocity: Whether its velocity is recorded.
        torque: Whether its torque is.

    Raises:
        ConfigurationError: A number that no axis has.
    """

    name: str
    node: int = 0
    counts_per_revolution: int = COUNTS
    rate_hz: float = 100.0
    velocity: bool = False
    torque: bool = False

    def __post_init__(self) -> None:
        if not (0 <= self.node < NODES and self.counts_per_revolution and 1.0 <= self.rate_hz <= 1000.0):
            text = (
                f"node = {self.node}, counts_per_revolution = {self.counts_per_revolution}, rate_hz = {self.rate_hz:g}"
            )
            raise ConfigurationError(f"{self.name}: {text}: a node is 0 to 63, counts are not 0, a rate 1 to 1000 Hz")

    @property
    def channels(self) -> dict[str, tuple[int, float, str]]:
        """By channel: which of a message's two numbers, its scale and its unit."""
        angle = 2.0 * np.pi / self.counts_per_revolution
        told = {self.name: (0, angle, "rad")} | (
            {f"{self.name}_velocity": (1, angle, "rad/s")} if self.velocity else {}
        )
        torque = f"{self.name}_torque", (1, self.counts_per_revolution / COUNTS / COUNTS, "N m")
        return told | (dict([torque]) if self.torque else {})


class _Message(NamedTuple):
    host_ns: int
    values: tuple[float, float]


class _Stream:
    """One kind of message of an axis, and its channels.

    Args:
        axis: Whose.
        channels: Names, which number, scale, unit.
        report: Receives rows and gaps.
    """

    def __init__(self, axis: OdriveAxis, channels: dict[str, tuple[int, float, str]], report: Reporter) -> None:
        self.heard_ns: int | None = None
        self._channels, self._report = channels, report
        self._period_ns = 1e9 / axis.rate_hz
        self._next = 0
        self._due_ns = 0.0  # when the last message would have come without delay, or later
        self._since = 0, 0  # number and arrival of the first message since the last silence
        self._is_even = True  # as far as is known: they come at the rate stated

    def take(self, messages: Sequence[_Message], first: SampleStatus, state: int) -> None:
        """Rows of messages that were read together; the first is marked ``first``."""
        first_ns, last_ns = messages[0].host_ns, messages[-1].host_ns
        sent = len(messages)
        if self.heard_ns is not None:
            sent = max(sent, int((last_ns - self._due_ns) / self._period_ns + EARLY))
            self._lose(last_ns, sent - len(messages), "messages_lost")
        if self.heard_ns is None or first_ns - self.heard_ns > SILENT_NS:
            self._since = self._next, first_ns
        late_ns = self._due_ns + sent * self._period_ns * (1.0 + SLOWER)
        self._due_ns = last_ns if self.heard_ns is None else min(last_ns, late_ns)
        self.heard_ns = last_ns
        numbers = self._next + np.arange(len(messages))
        ticks = self._since[1] + np.rint((numbers - self._since[0]) * self._period_ns)
        # what a host that stalls reads at once has one arrival, and is no other rate
        most_ns = (1.0 + FASTER) * (last_ns - self._since[1]) + SILENT_NS
        if self._is_even and ticks[-1] - self._since[1] > most_ns:
            self._is_even = False
            self._tell_rate(last_ns, int(numbers[-1]) - self._since[0])
        values = np.array([message.values for message in messages])
        for name, (which, scale, unit) in self._channels.items():
            rows = np.zeros(len(messages), SCALAR)
            rows["sequence"], rows["host_ns"] = numbers, [message.host_ns for message in messages]
            rows["tick"] = ticks if self._is_even else rows["host_ns"]
            good = np.abs(values[:, which]) < LARGEST  # false of what is not finite
            rows["value_raw"] = np.rint(np.where(good, values[:, which], 0.0) * COUNTS)
            rows["scale"], rows["unit"], rows["device_status"] = scale, unit.encode(), state & 0xFF
            rows["status"] = ~good * np.uint8(SampleStatus.NOT_VALID)
            if first & SampleStatus.NOT_VALID:
                rows["status"] |= np.uint8(SampleStatus.NOT_VALID)
            rows["status"][0] |= np.uint8(first)
            self._report.rows(name, rows)
        self._next += len(messages)

    def finish(self, now_ns: int) -> None:
        """Count what is missing at the end."""
        if self.heard_ns is not None and now_ns - self.heard_ns > SILENT_NS:
            self._lose(now_ns, int((now_ns - self.heard_ns) / self._period_ns), "silent")

    def _tell_rate(self, now_ns: int, count: int) -> None:
        text = f"messages come at {1e9 * count / (now_ns - self._since[1]):.3g} Hz, not at {1e9 / self._period_ns:g}"
        text += ": set rate_hz to that; until then their times are those of their arrivals"
        for name in self._channels:
            self._report.event(now_ns, Severity.WARNING, "rate", text, name)

    def _lose(self, now_ns: int, lost: int, cause: str) -> None:
        if lost > 0:
            for name in self._channels:
                duration_ns = round(lost * self._period_ns)
                self._report.gap(now_ns, name, self._next, self._next + lost - 1, duration_ns, cause)
            self._next += lost


class _Axis:
    """What is known of one."""

    def __init__(self, axis: OdriveAxis, report: Reporter) -> None:
        self.axis, self._report = axis, report
        own = axis.channels
        torque = {name: one for name, one in own.items() if one[2] == "N m"}
        angles = {name: one for name, one in own.items() if name not in torque}
        self.streams = {ENCODER_ESTIMATES: _Stream(axis, angles, report), TORQUES: _Stream(axis, torque, report)}
        self._heard_ns: int | None = None
        self._is_silent = False
        self._beat = Heartbeat(0, CLOSED_LOOP)
        self._awaits_beat = self._restarted = False  # after a silence: whether it began anew is not known yet

    def heard(self, host_ns: int) -> None:
        """Something of it has come."""
        if self._heard_ns is None:
            self._report.event(host_ns, Severity.INFO, "started", f"node {self.axis.node} is heard", self.axis.name)
        elif host_ns - self._heard_ns > SILENT_NS:
            self._awaits_beat = True
        if self._is_silent:
            self._is_silent = False
            self._report.event(host_ns, Severity.INFO, "recovered", "it is heard again", self.axis.name)
        self._heard_ns = host_ns

    def beat(self, host_ns: int, beat: Heartbeat) -> None:
        """Its heartbeat."""
        if self._awaits_beat and self._beat.state == CLOSED_LOOP != beat.state:
            self._restarted = True
            self._report.event(
                host_ns, Severity.WARNING, "restarted", "it has started again: where zero is may be lost"
            )
        self._awaits_beat = False
        if beat.errors != self._beat.errors:
            named = ", ".join(text for bit, text in ERRORS.items() if beat.errors & bit) or hex(beat.errors)
            if beat.errors:
                text = f"error {beat.errors:#x} ({named}): see odrivetool's dump_errors"
                self._report.event(host_ns, Severity.ERROR, "axis_error", text, self.axis.name)
            else:
                self._report.event(host_ns, Severity.INFO, "axis_normal", "it has no error any more", self.axis.name)
        if beat.state != self._beat.state:
            state = STATES[beat.state] if beat.state < len(STATES) else f"state {beat.state}"
            text = "it is driven" if beat.state == CLOSED_LOOP else f"it is not driven: {state}"
            self._report.event(host_ns, Severity.WARNING, "axis_state", text, self.axis.name)
        self._beat = beat

    def take(self, command: int, messages: Sequence[_Message]) -> None:
        """Estimates that were read together."""
        lacks = self._awaits_beat or self._beat.errors & (INITIALIZING | MISSING_ESTIMATE)
        status = SampleStatus.NOT_VALID if lacks else SampleStatus.OK
        if command == ENCODER_ESTIMATES and not lacks and self._restarted:
            self._restarted, status = False, SampleStatus.AFTER_RESET
        self.streams[command].take(messages, status, self._beat.state)

    def watch(self, now_ns: int, started_ns: int) -> None:
        """Report one that is silent."""
        heard_ns = started_ns if self._heard_ns is None else self._heard_ns
        if not self._is_silent and now_ns - heard_ns > 2 * SILENT_NS:
            self._is_silent = True
            text = f"node {self.axis.node} is not heard: check supply, can.node_id, bit rate and encoder_msg_rate_ms"
            self._report.event(now_ns, Severity.ERROR, "silent", text, self.axis.name)


class Odrives:
    """Axes of one CAN bus; see ``drivers.device.Device``.

    ``device_status`` is the axis' state; ``status`` is NOT_VALID for what is no number, while the axis says that it
    lacks its estimate, and after a silence until its heartbeat has come; AFTER_RESET where it was driven before that
    silence and is not after it.

    Args:
        port: The bus.
        axes: What is on it, with different names and nodes.
        name: Source of the events of the bus itself.

    Raises:
        ConfigurationError: No axis, or two of one node.
    """

    def __init__(self, port: CanPort, axes: Sequence[OdriveAxis], name: str) -> None:
        self.name = name
        self._report = Reporter(name)
        self._port = BusPort(port, self._report)
        self._axes = {axis.node: _Axis(axis, self._report) for axis in axes}
        if not axes or len(self._axes) < len(axes):
            raise ConfigurationError(f"{name}: nodes {[axis.node for axis in axes]}: give the axes different nodes")
        self._started_ns = 0
        self._is_broken = False

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: ``pump`` waits on the port. Non-zero only while the port fails."""
        return self._port.period_ns

    def start(self, now_ns: int) -> list[Batch]:
        """Listen. See ``drivers.device.Device``."""
        self._port.now_ns = self._started_ns = now_ns
        self._port.start()
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Rows of the frames that wait; waits up to ``timeout_s`` for the first."""
        self._port.now_ns = now_ns
        self._take(self._port.receive(timeout_s))
        for axis in self._axes.values():
            axis.watch(now_ns, self._started_ns)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Read the rest, and count what is missing."""
        self._port.now_ns = now_ns
        self._port.mute()
        for _ in range(DRAINS):
            if not (frames := self._port.receive(DRAIN_S)):
                break
            self._take(frames)
        for axis in self._axes.values():
            for stream in axis.streams.values():
                stream.finish(now_ns)
        self._report.event(now_ns, Severity.INFO, "stopped", "stopped")
        self._report.flush(now_ns)
        return self._report.take()

    def _take(self, frames: Sequence[CanFrame]) -> None:
        together: dict[tuple[int, int], list[_Message]] = {}
        for host_ns, identifier, data, is_error in frames:
            node, command = split(identifier)
            axis = self._axes.get(node)
            if is_error:
                self._port.report_error_frame(host_ns, identifier, data)
            elif axis is not None and command in (HEARTBEAT, *axis.streams):
                try:
                    if command == HEARTBEAT:
                        beat = decode_heartbeat(data)
                        axis.heard(host_ns)
                        axis.beat(host_ns, beat)
                    else:
                        message = _Message(host_ns, decode_pair(data))
                        axis.heard(host_ns)
                        together.setdefault((node, command), []).append(message)
                except FrameError as error:
                    self._report.event(host_ns, Severity.WARNING, "bad_frame", str(error), axis.axis.name)
        for (node, command), messages in together.items():
            self._axes[node].take(command, messages)
