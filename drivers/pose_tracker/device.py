"""Pose tracker: messages in, POSE rows out, lost messages found by their number."""

import numpy as np

from drivers.errors import FrameError
from drivers.pose_tracker.frame import ATT_POS_MOCAP, Message, PoseTrackerConfig, decode_pose, message_stream
from drivers.records import POSE, Rows, SampleStatus, Severity
from drivers.serial_line.device import Channels, Clock, OpenPort, ReceivedBytes, SerialDevice

UNIT_WITHIN = 1e-2  # of 1: the length of a quaternion that is a rotation
PERIOD_POSES = 8  # contiguous ones, to learn the period from
_NUMBERS = 256


class PoseTracker(SerialDevice):
    """Poses of one motion capture bridge, on the channel of its name.

    ``tick`` is the tracker's time, us. ``status`` is NOT_VALID for a pose that repeats the one before to the bit (the
    tracker holds it while it does not see the markers), that is no rotation or not finite, or whose time does not
    advance; AFTER_RESET where the time went back.

    Args:
        name: Channel of its rows, source of its events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Whose poses.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, config: PoseTrackerConfig | None = None) -> None:
        self.config = PoseTrackerConfig() if config is None else config
        super().__init__(name, open_port, clock, self.config.poll_period_ms, self.config.silence_ms)
        self._stream = message_stream()
        self._next = 0  # number of the next pose, if none is lost before it
        self._number: dict[tuple[int, int], int] = {}  # of each sender's last message
        self._last: Rows | None = None  # (1,)
        self._steps: list[int] = []  # us between contiguous poses, until the period is known
        self._period_us: float | None = None
        self._others = False  # messages of other kinds came
        self._held = False

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        return {self.name: POSE}

    def _opened(self, now_ns: int) -> None:
        self._stream.clear()

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        rows: list[Rows] = []
        for message in self._frames_in(chunk, self._stream):
            self._broken = False
            self._heard(now_ns)
            if self._is_wanted(message):
                rows += self._taken(chunk.host_ns, message)
        if rows:
            self._report.rows(self.name, np.concatenate(rows))

    def _is_wanted(self, message: Message) -> bool:
        wanted = (self.config.system, message.system), (self.config.component, message.component)
        return all(own in (0, told) for own, told in wanted)

    def _taken(self, host_ns: int, message: Message) -> list[Rows]:
        """The row of a message, if it is a pose."""
        sender = message.system, message.component
        lost = (message.sequence - self._number.get(sender, message.sequence - 1) - 1) % _NUMBERS
        self._number[sender] = message.sequence
        try:
            row = decode_pose(message)
        except FrameError as error:
            self._others = True
            if message.identifier == ATT_POS_MOCAP:
                self._bad_frame(host_ns, error)
            if lost:
                self._report.gap(host_ns, self.name, self._next, self._next + lost - 1, 0, "messages_lost")
                self._next += lost
            return []
        status = self._status(row)
        if self._last is None:
            self._report.event(host_ns, Severity.INFO, "started", "receiving poses")
        else:
            self._lost(host_ns, lost, int(row["tick"][0]) - int(self._last["tick"][0]))
        row["sequence"], row["host_ns"], row["status"] = self._next, host_ns, status
        self._next += 1
        self._tell_held(host_ns, bool(status & SampleStatus.NOT_VALID))
        self._last = row
        return [row]

    def _lost(self, host_ns: int, lost: int, since_us: int) -> None:
        """Record lost messages: as counted if their number agrees with the time and only poses are received."""
        if not lost:
            self._learn(since_us)
            return
        if since_us <= 0 or (self._period_us and (lost - 1) * self._period_us > since_us):
            return  # the sender began again
        counted = bool(self._period_us) and not self._others
        counted = counted and abs(since_us - (lost + 1) * (self._period_us or 0.0)) < 1.5 * (self._period_us or 0.0)
        self._report.gap(
            host_ns, self.name, self._next, self._next + lost - 1, 1000 * since_us, "messages_lost", counted=counted
        )
        self._next += lost

    def _learn(self, since_us: int) -> None:
        if self._period_us is None and since_us > 0:
            self._steps.append(since_us)
            if len(self._steps) >= PERIOD_POSES:
                self._period_us = float(np.median(self._steps))

    def _status(self, row: Rows) -> SampleStatus:
        status = SampleStatus.OK
        numbers = np.concatenate([row["position_m"][0], row["quaternion"][0]]).astype(np.float64)
        if not np.isfinite(numbers).all() or abs(float(np.linalg.norm(numbers[3:])) - 1.0) > UNIT_WITHIN:
            status |= SampleStatus.NOT_VALID
        if self._last is not None:
            same = all((row[field] == self._last[field]).all() for field in ("position_m", "quaternion"))
            since_us = int(row["tick"][0]) - int(self._last["tick"][0])
            if same or since_us == 0:
                status |= SampleStatus.NOT_VALID
            if since_us < 0:
                status |= SampleStatus.AFTER_RESET
        return status

    def _tell_held(self, host_ns: int, held: bool) -> None:
        if held != self._held:
            self._held = held
            if held:
                text = "poses repeat or are no rotation: the tracker does not see the markers; uncover them"
                self._report.event(host_ns, Severity.WARNING, "not_tracked", text)
            else:
                self._report.event(host_ns, Severity.INFO, "tracked", "poses change again")
