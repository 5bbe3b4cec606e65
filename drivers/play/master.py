"""What every master of the drives of a bus does, whatever their kind: it beats, arms, enables, watches, stops.

Armed, it beats where the drives watch that and enables them where they stand. On every pump it watches the ticks, each
drive's answers, state, limits, rate and faults, and that it sent something itself. Whatever is wrong becomes a quick
stop of all drives, once; a master that has stopped does not start again.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from enum import Enum, auto
from typing import ClassVar, Final, Generic, Protocol, TypeVar

from drivers.play.axis import Axis, DriveTicks
from drivers.records import Severity
from drivers.reporter import Reporter

READY_NS: Final = 10_000_000_000  # after arming, until every drive is set up
ENABLE_NS: Final = 3_000_000_000
REPEAT_NS: Final = 50_000_000  # of a controlword that is not obeyed
STOP_NS: Final = 3_000_000_000  # of a quick stop
BEATS: Final = 4  # heartbeats in the time that a drive does without
Axis_co = TypeVar("Axis_co", bound=Axis, covariant=True)


class MasterState(Enum):
    """Of a master."""

    IDLE = auto()  # not armed, or waiting for the drives' set-up
    ENABLING = auto()
    PLAYING = auto()
    HOLDING = auto()  # at the end of the motion
    STOPPING = auto()
    STOPPED = auto()  # for good


DRIVING: Final = (MasterState.ENABLING, MasterState.PLAYING, MasterState.HOLDING)


class MasterConfig(Protocol):
    """Configuration that all masters have in common."""

    @property
    def heartbeat_ms(self) -> int:
        """How long the drives do without our heartbeat."""

    @property
    def sync_limit_ms(self) -> float:
        """Longest time without a tick, or without an answer of a drive."""


class DriveMaster(ABC, Generic[Axis_co]):
    """The master of the drives of one bus.

    Args:
        config: How they are watched.
        axes: The drives.
        ticks: Numbers the SYNCs, or the rounds, of this bus.
        report: Where events go.

    Attributes:
        state: Where it stands.
        axes: The drives.
        stopped_by: Why they were stopped; empty before.
    """

    SENDS: ClassVar[str]  # what it sends once a tick
    STOPPED_AS: ClassVar[Severity]  # of the event of a quick stop

    def __init__(self, config: MasterConfig, axes: Sequence[Axis_co], ticks: DriveTicks, report: Reporter) -> None:
        self.state, self.stopped_by = MasterState.IDLE, ""
        self.axes = axes
        self._ticks, self._report = ticks, report
        self._heartbeat_ms = config.heartbeat_ms
        self._armed = self._was_armed = False
        self._limit_ns = round(config.sync_limit_ms * 1e6)
        self._since_ns = self._beat_ns = self._told_ns = self._now_ns = 0
        self._sent_tick: int | None = None

    @property
    def is_active(self) -> bool:
        """Whether it sends: then frames are not gathered."""
        return self._armed and self.state is not MasterState.STOPPED

    @property
    def is_moving(self) -> bool:
        """Whether drives are, or may be, enabled."""
        return self.state in (*DRIVING, MasterState.STOPPING)

    def arm(self) -> None:
        """From now on the drives are enabled as soon as all are ready; may be called by another thread."""
        self._armed = True

    def step(self, now_ns: int) -> None:
        """Everything that is due, after the frames of a pump were taken."""
        self.set_time(now_ns)
        if self._armed and not self._was_armed:
            self._was_armed, self._since_ns = True, now_ns
        if self._was_armed:
            self._beat()
        if self.state is MasterState.IDLE and self._was_armed:
            self._begin()
        elif self.state in DRIVING:
            wrong = self._wrong()
            if wrong:
                self.stop(wrong)
            else:
                self._go_on()
        if self.state is MasterState.STOPPING:
            self._stop_on()
        self.hand_over()

    def set_time(self, now_ns: int) -> None:
        """What is sent from now on is sent at ``now_ns``."""
        self._now_ns = now_ns
        for axis in self.axes:
            axis.now_ns = now_ns

    def hand_over(self) -> None:
        """Pass what the drives were sent to the reporter."""
        for axis in self.axes:
            axis.hand_over()

    def stop(self, why: str) -> None:
        """Quick stop of all drives, for good."""
        if self.state is MasterState.IDLE and self._was_armed:
            self._end(Severity.ERROR, "drive_refused", why)
        elif self.state in DRIVING:
            self.state, self._since_ns, self._told_ns = MasterState.STOPPING, self._now_ns, -REPEAT_NS
            self.stopped_by = why
            self._report.event(self._now_ns, self.STOPPED_AS, "drive_stopped", f"quick stop: {why}")

    # Arming and enabling

    def _begin(self) -> None:
        late = [axis.name for axis in self.axes if not axis.is_ready]
        if late:
            if self._now_ns - self._since_ns > READY_NS:
                self.stop(f"not ready: {', '.join(late)}; see its events; the arm is not moved")
            return
        for place, axis in enumerate(self.axes):
            why = self._not_to_be_armed(place, axis)
            if why:
                self.stop(f"{axis.name} {why}")
                return
        self.state, self._since_ns, self._told_ns = MasterState.ENABLING, self._now_ns, 0
        self._report.event(self._now_ns, Severity.WARNING, "drive_armed", self._get_ready())

    def _not_to_be_armed(self, place: int, axis: Axis) -> str:
        del place
        return axis.not_to_be_armed()

    def _get_ready(self) -> str:
        """The last call before drives are enabled: what they are armed for."""
        return ", ".join(axis.name for axis in self.axes)

    def _enable(self) -> None:
        if all(axis.is_enabled for axis in self.axes):
            self.state = MasterState.PLAYING
            self._started()
            return
        if self._now_ns - self._since_ns > ENABLE_NS:
            told = ", ".join(f"{axis.name} {axis.shown}" for axis in self.axes if not axis.is_enabled)
            self.stop(f"not enabled within {ENABLE_NS * 1e-9:g} s, {self.axes[0].SHOWS}: {told}")
            return
        if self._now_ns - self._told_ns >= self._ticks.period_ns:
            self._told_ns = self._now_ns
            for axis in self.axes:
                axis.enable()

    @abstractmethod
    def _started(self) -> None:
        """All drives are enabled."""

    @abstractmethod
    def _go_on(self) -> None:
        """What is due while drives are, or become, enabled."""

    # Watching

    def _wrong(self) -> str:
        """Why the drives have to stop; empty while all is well."""
        silent_ns = self._now_ns - self._ticks.host_ns
        if silent_ns > self._limit_ns:
            return f"no {self._ticks.WHAT} for {silent_ns // 1_000_000} ms"
        tick = self._ticks.tick
        if tick is not None and self._sent_tick is not None:
            missed_ns = (tick - self._sent_tick - 1) * self._ticks.period_ns
            if missed_ns > self._limit_ns:
                late = f"no {self.SENDS} was sent for {missed_ns // 1_000_000} ms"
                return f"{late}: lost {self._ticks.WHAT}s, or this computer was late"
        for place, axis in enumerate(self.axes):
            if wrong := axis.unwell(self._now_ns, self._limit_ns):
                return f"{axis.name} {wrong}"
            for wrong in self._astray(place, axis) if self.state is not MasterState.ENABLING else ():
                return f"{axis.name} {wrong}"
        return ""

    def _astray(self, place: int, axis: Axis) -> Iterator[str]:
        del place
        return axis.astray()

    # Stopping and beating

    def _stop_on(self) -> None:
        if self._now_ns - self._told_ns >= REPEAT_NS:
            self._told_ns = self._now_ns
            for axis in self.axes:
                axis.quick_stop()
        moving = [axis for axis in self.axes if axis.may_move]
        if not moving:
            self._end(Severity.INFO, "drive_at_rest", "no drive follows set points any more")
        elif self._now_ns - self._since_ns > STOP_NS:
            for axis in moving:
                axis.cut()
            left = ", ".join(axis.name for axis in moving)
            self._end(Severity.ERROR, "drive_unheard", f"no answer to quick stop: {left}; commanded to cut the current")

    def _end(self, severity: Severity, code: str, text: str) -> None:
        self.state, self.stopped_by = MasterState.STOPPED, self.stopped_by or text
        self._report.event(self._now_ns, severity, code, text)

    def _beat(self) -> None:
        if self._now_ns - self._beat_ns >= self._heartbeat_ms * 1_000_000 // BEATS:
            self._beat_ns = self._now_ns
            self.axes[0].beat()
