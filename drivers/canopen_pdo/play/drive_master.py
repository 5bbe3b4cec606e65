"""What every master of the drives of a CAN bus does: it beats, arms, enables, watches, stops.

Armed, it beats (CiA 301 heartbeat, which the drives watch) and enables the drives where they stand. On every pump it
watches SYNC, each drive's answers, state, mode, limits, rate, EMCY, reboot, and that it sent something itself. Whatever
is wrong becomes a quick stop of all drives, once; a master that has stopped does not start again.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from enum import Enum, auto
from functools import partial
from typing import ClassVar, Final, Protocol

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.frame import NmtState
from drivers.canopen_pdo.play import drive_axis
from drivers.canopen_pdo.play.drive_axis import AxisConfig, DriveAxis
from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import Severity
from drivers.reporter import Reporter

READY_NS: Final = 10_000_000_000  # after arming, until every drive is set up
ENABLE_NS: Final = 3_000_000_000
REPEAT_NS: Final = 50_000_000  # of a controlword that is not obeyed
STOP_NS: Final = 3_000_000_000  # of a quick stop
BEATS: Final = 4  # heartbeats in the time that a drive does without


class State(Enum):
    """Of a master."""

    IDLE = auto()  # not armed, or waiting for the drives' set-up
    ENABLING = auto()
    PLAYING = auto()
    HOLDING = auto()  # at the end of the motion
    STOPPING = auto()
    STOPPED = auto()  # for good


DRIVING: Final = (State.ENABLING, State.PLAYING, State.HOLDING)


class MasterConfig(Protocol):
    """Configuration that all masters have in common."""

    @property
    def axes(self) -> tuple[AxisConfig, ...]:
        """The drives."""

    @property
    def heartbeat_ms(self) -> int:
        """How long the drives do without our heartbeat."""

    @property
    def sync_limit_ms(self) -> float:
        """Longest time without SYNC, or without an answer of a drive."""

    @property
    def master(self) -> int:
        """Our node number, of the heartbeat."""


class DriveMaster(ABC):
    """The master of the drives of one CAN bus.

    Args:
        config: What is driven.
        mode: Of operation (6060h).
        sync: Numbers the SYNCs of this bus.
        send: Sends a frame (COB-ID, data); does not raise on bus faults.
        report: Where events and rows go.

    Attributes:
        state: Where it stands.
        axes: The drives.
        stopped_by: Why they were stopped; empty before.
    """

    SENDS: ClassVar[str]  # what it sends once a SYNC
    STOPPED_AS: ClassVar[Severity]  # of the event of a quick stop

    def __init__(
        self,
        config: MasterConfig,
        mode: int,
        sync: SyncCounter,
        send: Callable[[int, bytes], None],
        report: Reporter,
    ) -> None:
        self.state, self.stopped_by = State.IDLE, ""
        self._sync, self._report, self._mode = sync, report, mode
        self._master, self._heartbeat_ms = config.master, config.heartbeat_ms
        own = self._master, self._heartbeat_ms
        self.axes = [DriveAxis(axis, mode, sync, own, send, report) for axis in config.axes]
        self._armed = self._was_armed = False
        self._limit_ns = round(config.sync_limit_ms * 1e6)
        self._since_ns = self._beat_ns = self._told_ns = self._now_ns = 0
        self._sent_tick: int | None = None

    @property
    def is_active(self) -> bool:
        """Whether it sends: then frames are not gathered."""
        return self._armed and self.state is not State.STOPPED

    @property
    def is_moving(self) -> bool:
        """Whether drives are, or may be, enabled."""
        return self.state in (*DRIVING, State.STOPPING)

    def arm(self) -> None:
        """From now on the drives are enabled as soon as all are ready; may be called by another thread."""
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

    def step(self, now_ns: int) -> None:
        """Everything that is due, after the frames of a pump were taken."""
        self.set_time(now_ns)
        if self._armed and not self._was_armed:
            self._was_armed, self._since_ns = True, now_ns
        if self._was_armed:
            self._beat()
        if self.state is State.IDLE and self._was_armed:
            self._begin()
        elif self.state in DRIVING:
            wrong = self._wrong()
            if wrong:
                self.stop(wrong)
            else:
                self._go_on()
        if self.state is State.STOPPING:
            self._stop_on()
        self.hand_over()

    def set_time(self, now_ns: int) -> None:
        """What is sent from now on is sent at ``now_ns``."""
        self._now_ns = now_ns
        for axis in self.axes:
            axis.now_ns = now_ns

    def hand_over(self) -> None:
        """Pass the frames that were sent to the reporter."""
        for axis in self.axes:
            axis.hand_over()

    def stop(self, why: str) -> None:
        """Quick stop of all drives, for good."""
        if self.state is State.IDLE and self._was_armed:
            self._end(Severity.ERROR, "drive_refused", why)
        elif self.state in DRIVING:
            self.state, self._since_ns, self._told_ns = State.STOPPING, self._now_ns, -REPEAT_NS
            self.stopped_by = why
            self._report.event(self._now_ns, self.STOPPED_AS, "drive_stopped", f"quick stop: {why}")

    # Arming and enabling

    def _begin(self) -> None:
        late = [axis.name for axis in self.axes if not axis.is_ready or axis.position is None or axis.status is None]
        if late:
            if self._now_ns - self._since_ns > READY_NS:
                self.stop(f"not ready: {', '.join(late)}; see its events; the arm is not moved")
            return
        for place, axis in enumerate(self.axes):
            why = self._not_to_be_armed(place, axis)
            if why:
                self.stop(f"{axis.name} {why}")
                return
        self.state, self._since_ns, self._told_ns = State.ENABLING, self._now_ns, 0
        self._report.event(self._now_ns, Severity.WARNING, "drive_armed", self._get_ready())

    def _not_to_be_armed(self, place: int, axis: DriveAxis) -> str:
        if axis.state in drive_axis.FAULTS:
            return f"is in fault, statusword {axis.status or 0:04X}h: clear it with its tool"
        if axis.failed:
            return f"reports {axis.failed:04X}h (EMCY): clear it with its tool"
        return ""

    def _get_ready(self) -> str:
        """The last call before drives are enabled: what they are armed for."""
        return ", ".join(axis.name for axis in self.axes)

    def _enable(self) -> None:
        if all(axis.is_enabled for axis in self.axes):
            self.state = State.PLAYING
            self._started()
            return
        if self._now_ns - self._since_ns > ENABLE_NS:
            told = ", ".join(f"{axis.name} {axis.status or 0:04X}h" for axis in self.axes if not axis.is_enabled)
            self.stop(f"not enabled within {ENABLE_NS * 1e-9:g} s, statuswords: {told}")
            return
        if self._now_ns - self._told_ns >= self._sync.period_ns:
            self._told_ns = self._now_ns
            for axis in self.axes:
                self._hold_still(axis)
                axis.control(drive_axis.ENABLING.get(axis.state or 0, drive_axis.DISABLE_VOLTAGE))

    @abstractmethod
    def _hold_still(self, axis: DriveAxis) -> None:
        """What a drive is sent before a controlword that enables it, so that it does not move."""

    @abstractmethod
    def _started(self) -> None:
        """All drives are enabled."""

    @abstractmethod
    def _go_on(self) -> None:
        """What is due while drives are, or become, enabled."""

    # Watching

    def _wrong(self) -> str:
        """Why the drives have to stop; empty while all is well."""
        silent_ns = self._now_ns - self._sync.host_ns
        if silent_ns > self._limit_ns:
            return f"no SYNC for {silent_ns // 1_000_000} ms"
        tick = self._sync.tick
        if tick is not None and self._sent_tick is not None:
            missed_ns = (tick - self._sent_tick - 1) * self._sync.period_ns
            if missed_ns > self._limit_ns:
                late = f"no {self.SENDS} was sent for {missed_ns // 1_000_000} ms"
                return f"{late}: lost SYNCs, or this computer was late"
        for place, axis in enumerate(self.axes):
            if wrong := axis.unwell(self._now_ns, self._limit_ns):
                return f"{axis.name} {wrong}"
            for wrong in self._astray(place, axis) if self.state is not State.ENABLING else ():
                return f"{axis.name} {wrong}"
        return ""

    def _astray(self, place: int, axis: DriveAxis) -> Iterator[str]:
        if not axis.is_enabled:
            yield f"has left the operation enabled state, statusword {axis.status or 0:04X}h"
        if axis.mode_shown != self._mode:
            yield f"is in mode {axis.mode_shown}, not {self._mode} (6061h)"

    # Stopping and beating

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
        self.state, self.stopped_by = State.STOPPED, self.stopped_by or text
        self._report.event(self._now_ns, severity, code, text)

    def _beat(self) -> None:
        if self._now_ns - self._beat_ns >= self._heartbeat_ms * 1_000_000 // BEATS:
            self._beat_ns = self._now_ns
            self.axes[0].send(frame.HEARTBEAT + self._master, bytes([NmtState.OPERATIONAL]))
