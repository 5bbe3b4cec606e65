"""Drives torques of a control law over the drives of a CAN bus (CiA 402 mode 10), and stops them all when it must.

Armed, it beats, enables the drives with torque zero where they stand, and then asks the law for torques once a SYNC, as
soon as every drive has answered it; they are in force from the next SYNC on. A SYNC that a drive does not answer in
time has no torques of its own: those of the last one stay. It watches on every pump what the player of positions
watches too (:meth:`DriveAxis.unwell`), the state and mode of every drive and its rate. Whatever is wrong becomes a
quick stop of all drives, once; so does a law that says why it ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from typing import Final

from drivers.canopen_pdo import drive_axis, frame
from drivers.canopen_pdo.drive_axis import CYCLIC_TORQUE, AxisConfig, DriveAxis
from drivers.canopen_pdo.frame import NmtState
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import ConfigurationError
from drivers.records import Severity
from drivers.reporter import Reporter

READY_NS: Final = 10_000_000_000  # after arming, until every drive is set up
ENABLE_NS: Final = 3_000_000_000
REPEAT_NS: Final = 50_000_000  # of a controlword that is not obeyed
STOP_NS: Final = 3_000_000_000
BEATS: Final = 4  # heartbeats in the time that a drive does without
RATE_SLACK: Final = 1.25

Law = Callable[[int, Sequence[int]], Sequence[int] | str]
"""Torques in thousandths of the rated ones, for the SYNC number and the counts at it; or why to stop."""


@dataclass(frozen=True)
class TorqueConfig:
    """What is driven, and by which law.

    Attributes:
        axes: The drives, in the order of the law's counts and torques.
        law: Asked once a SYNC.
        heartbeat_ms: How long the drives do without our heartbeat.
        sync_limit_ms: Longest time without SYNC, or without an answer of a drive.
        master: Our node number, of the heartbeat.
    """

    axes: tuple[AxisConfig, ...]
    law: Law
    heartbeat_ms: int = 100
    sync_limit_ms: float = 25.0
    master: int = 127

    def __post_init__(self) -> None:
        if not self.axes or not 1 <= self.master <= 127 or any(axis.drive.node == self.master for axis in self.axes):
            raise ConfigurationError(f"master node {self.master}: a number of 1..127 that no drive has; and a drive")


class _State(Enum):
    IDLE = auto()
    ENABLING = auto()
    RUNNING = auto()
    STOPPING = auto()
    STOPPED = auto()


class TorqueMaster:
    """The master of one CAN bus; on the bus it stands where a ``Player`` does.

    Args:
        config: What is driven.
        sync: Numbers the SYNCs of this bus.
        send: Sends a frame (COB-ID, data); does not raise on bus faults.
        report: Where events and rows go.

    Attributes:
        axes: The drives.
        stopped_by: Why they were stopped; empty before.
    """

    def __init__(
        self, config: TorqueConfig, sync: SyncCounter, send: Callable[[int, bytes], None], report: Reporter
    ) -> None:
        self.config, self.stopped_by = config, ""
        self._sync, self._report = sync, report
        master = config.master, config.heartbeat_ms
        self.axes = [DriveAxis(axis, CYCLIC_TORQUE, sync.period_ns, master, send, report) for axis in config.axes]
        self._state, self._armed = _State.IDLE, False
        self._limit_ns = round(config.sync_limit_ms * 1e6)
        self._now_ns = self._since_ns = self._told_ns = self._beat_ns = 0
        self._tick: int | None = None  # of the SYNC that the law was last asked for
        self._before: tuple[int, list[int]] | None = None

    @property
    def is_active(self) -> bool:
        """Whether it sends: then frames are not gathered."""
        return self._armed and self._state is not _State.STOPPED

    @property
    def is_moving(self) -> bool:
        """Whether drives are, or may be, enabled."""
        return self._state in (_State.ENABLING, _State.RUNNING, _State.STOPPING)

    @property
    def is_running(self) -> bool:
        """Whether the law is asked for torques."""
        return self._state is _State.RUNNING

    @property
    def has_stopped(self) -> bool:
        """Whether it has ended for good."""
        return self._state is _State.STOPPED

    def arm(self) -> None:
        """From now on the drives are enabled as soon as all are ready."""
        self._armed = True

    def axis_of(self, node: int) -> DriveAxis | None:
        """The axis that a node drives."""
        return next((axis for axis in self.axes if axis.node == node), None)

    def routes(self) -> list[tuple[int, Callable[[int, bytes], None]]]:
        """COB-IDs that it listens to."""
        found: list[tuple[int, Callable[[int, bytes], None]]] = []
        for axis in self.axes:
            found += [(cob_id, partial(axis.on_tpdo, cob_id)) for cob_id in axis.cob_ids]
            found.append((frame.EMERGENCY + axis.node, axis.on_emergency))
        return found

    def set_time(self, now_ns: int) -> None:
        """What is sent from now on is sent at ``now_ns``."""
        self._now_ns = now_ns
        for axis in self.axes:
            axis.now_ns = now_ns

    def hand_over(self) -> None:
        """Pass the frames that were sent to the reporter."""
        for axis in self.axes:
            axis.hand_over()

    def step(self, now_ns: int) -> None:
        """Everything that is due, after the frames of a pump were taken."""
        self.set_time(now_ns)
        if self._armed and self._state is not _State.STOPPED:
            self._beat()
        if self._armed and self._state is _State.IDLE:
            self._begin()
        elif self._state in (_State.ENABLING, _State.RUNNING):
            wrong = self._wrong()
            if wrong:
                self.stop(wrong)
            elif self._state is _State.ENABLING:
                self._enable()
            else:
                self._ask()
        if self._state is _State.STOPPING:
            self._stop_on()
        self.hand_over()

    def stop(self, why: str) -> None:
        """Quick stop of all drives, for good."""
        if self._state is _State.IDLE and self._armed:
            self._end(Severity.ERROR, "drive_refused", why)
        elif self._state in (_State.ENABLING, _State.RUNNING):
            self._state, self._since_ns, self._told_ns = _State.STOPPING, self._now_ns, -REPEAT_NS
            self.stopped_by = why
            self._report.event(self._now_ns, Severity.WARNING, "drive_stopped", f"quick stop: {why}")

    def _begin(self) -> None:
        self._since_ns = self._since_ns or self._now_ns
        late = [axis.name for axis in self.axes if not axis.is_ready or axis.position is None or axis.status is None]
        if late:
            if self._now_ns - self._since_ns > READY_NS:
                self.stop(f"not ready: {', '.join(late)}; see its events; the arm is not moved")
            return
        for axis in self.axes:
            if axis.state in drive_axis.FAULTS or axis.failed:
                self.stop(f"{axis.name} is in fault, statusword {axis.status or 0:04X}h: clear it with its tool")
                return
        self._state, self._since_ns, self._told_ns = _State.ENABLING, self._now_ns, 0
        self._report.event(self._now_ns, Severity.WARNING, "drive_armed", ", ".join(axis.name for axis in self.axes))

    def _enable(self) -> None:
        if all(axis.is_enabled for axis in self.axes):
            self._state = _State.RUNNING
            return
        if self._now_ns - self._since_ns > ENABLE_NS:
            told = ", ".join(f"{axis.name} {axis.status or 0:04X}h" for axis in self.axes if not axis.is_enabled)
            self.stop(f"not enabled within {ENABLE_NS * 1e-9:g} s, statuswords: {told}")
        elif self._now_ns - self._told_ns >= self._sync.period_ns:
            self._told_ns = self._now_ns
            for axis in self.axes:
                axis.torque(0)
                axis.control(drive_axis.ENABLING.get(axis.state or 0, drive_axis.DISABLE_VOLTAGE))

    def _ask(self) -> None:
        tick = self._sync.tick
        answered = all(axis.heard_ns >= self._sync.host_ns for axis in self.axes)
        if tick is None or tick == self._tick or not answered:
            return
        self._tick = tick
        torques = self.config.law(tick, [axis.position or 0 for axis in self.axes])
        if isinstance(torques, str):
            self.stop(torques)
            return
        for axis, torque in zip(self.axes, torques, strict=True):
            axis.torque(torque)

    def _wrong(self) -> str:
        """Why the drives have to stop; empty while all is well."""
        silent_ns = self._now_ns - self._sync.host_ns
        if silent_ns > self._limit_ns:
            return f"no SYNC for {silent_ns // 1_000_000} ms"
        tick = self._sync.tick
        if tick is not None and self._tick is not None:
            missed_ns = (tick - self._tick - 1) * self._sync.period_ns
            if missed_ns > self._limit_ns:
                return f"no torque was sent for {missed_ns // 1_000_000} ms: lost SYNCs, or this computer was late"
        for axis in self.axes:
            if wrong := axis.unwell(self._now_ns, self._limit_ns):
                return f"{axis.name} {wrong}"
            if self._state is _State.RUNNING and not axis.is_enabled:
                return f"{axis.name} has left the operation enabled state, statusword {axis.status or 0:04X}h"
            if self._state is _State.RUNNING and axis.mode_shown != CYCLIC_TORQUE:
                return f"{axis.name} is in mode {axis.mode_shown}, not {CYCLIC_TORQUE} (6061h)"
        return self._too_fast(tick)

    def _too_fast(self, tick: int | None) -> str:
        positions = [axis.position or 0 for axis in self.axes]
        if tick is None or self._before is None or tick <= self._before[0]:
            self._before = self._before or (None if tick is None else (tick, positions))
            return ""
        periods, before = tick - self._before[0], self._before[1]
        if periods < 6:  # long enough for the counts
            return ""
        self._before = tick, positions
        for axis, position in zip(self.axes, before, strict=True):
            rate = abs(axis.distance(position)) * 1e9 / (periods * self._sync.period_ns)
            if rate > RATE_SLACK * axis.config.rate:
                per_turn = axis.config.drive.counts_per_revolution
                return f"{axis.name} moves at {360.0 * rate / per_turn:.1f} deg/s, faster than its limit"
        return ""

    def _stop_on(self) -> None:
        if self._now_ns - self._told_ns >= REPEAT_NS:
            self._told_ns = self._now_ns
            for axis in self.axes:
                axis.control(drive_axis.QUICK_STOP)
        moving = [axis for axis in self.axes if axis.is_enabled or axis.status is None]
        if not moving:
            self._end(Severity.INFO, "drive_at_rest", "no drive follows set points any more")
        elif self._now_ns - self._since_ns > STOP_NS:
            for axis in moving:
                axis.control(drive_axis.DISABLE_VOLTAGE)
            left = ", ".join(axis.name for axis in moving)
            self._end(Severity.ERROR, "drive_unheard", f"no answer to quick stop: {left}; told to cut the current")

    def _end(self, severity: Severity, code: str, text: str) -> None:
        self._state, self.stopped_by = _State.STOPPED, self.stopped_by or text
        self._report.event(self._now_ns, severity, code, text)

    def _beat(self) -> None:
        if self._now_ns - self._beat_ns >= self.config.heartbeat_ms * 1_000_000 // BEATS:
            self._beat_ns = self._now_ns
            self.axes[0].send(frame.HEARTBEAT + self.config.master, bytes([NmtState.OPERATIONAL]))
