"""Plays a motion over the drives of a CAN bus, and stops them all when anything is not as it has to be.

Nothing is sent before ``arm``, but for the set-up. Armed, it beats (CiA 301 heartbeat, which the drives watch), enables
the drives where they stand, blends into the motion within ``BLEND_S``, and sends each target after the SYNC before
the one it is for. It watches, on every pump: SYNC, each drive's answers, state, mode, position, rate, distance from
the target, EMCY, reboot. Whatever is wrong becomes a quick stop of all drives, once; a player that has stopped does
not start again. The row of the motion goes by SYNC number, so that a SYNC that was lost leaves no lag behind.

The drives stop by themselves when this process does not beat any more: that is set up before, and read back.
"""

from collections import deque
from collections.abc import Callable, Iterator
from enum import Enum, auto
from functools import partial
from typing import Final

from drivers.canopen_pdo import drive_axis, frame
from drivers.canopen_pdo.drive_axis import CYCLIC, DriveAxis
from drivers.canopen_pdo.frame import NmtState
from drivers.canopen_pdo.player_config import PlayerConfig
from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import Severity
from drivers.reporter import Reporter

BLEND_S: Final = 1.0  # from where the arm stands to the motion
READY_NS: Final = 10_000_000_000  # after arming, until every drive is set up
ENABLE_NS: Final = 3_000_000_000
REPEAT_NS: Final = 50_000_000  # of a controlword that is not obeyed
STOP_NS: Final = 3_000_000_000  # of a quick stop
ARRIVE_NS: Final = 60_000_000_000  # of the last way point of a profile
ACKNOWLEDGE_NS: Final = 500_000_000
BEATS: Final = 4  # heartbeats in the time that a drive does without
RATE_SLACK: Final = 1.25  # of the rate limit, for the drive's own control
RATE_WINDOW_NS: Final = 25_000_000
LATENCY: Final = 3  # SYNCs from a target being sent to its being reached


class State(Enum):
    """Of a player."""

    IDLE = auto()  # not armed, or waiting for the drives' set-up
    ENABLING = auto()
    PLAYING = auto()
    HOLDING = auto()  # at the end of the motion
    STOPPING = auto()
    STOPPED = auto()  # for good


class Player:
    """The player of one CAN bus.

    Args:
        config: What is played.
        sync: Numbers the SYNCs of this bus.
        send: Sends a frame (COB-ID, data); does not raise on bus faults.
        report: Where events and rows go.

    Attributes:
        state: Where it stands.
        axes: The drives.
    """

    def __init__(
        self, config: PlayerConfig, sync: SyncCounter, send: Callable[[int, bytes], None], report: Reporter
    ) -> None:
        self.config, self.state = config, State.IDLE
        self._sync, self._report = sync, report
        master = config.master, config.heartbeat_ms
        self.axes = [DriveAxis(axis, config.mode, sync.period_ns, master, send, report) for axis in config.axes]
        self._armed = self._was_armed = False
        self._limit_ns = round(config.sync_limit_ms * 1e6)
        self._since_ns = self._beat_ns = self._told_ns = self._now_ns = 0
        self._sent_tick: int | None = None
        self._first_tick = self._row = 0
        self._counts, self._name = config.counts, config.name  # of what is played now
        self._offsets: list[int] = []
        self._aimed: deque[tuple[int, list[int]]] = deque(maxlen=LATENCY + 1)
        self._past: deque[tuple[int, list[int]]] = deque()
        self._waiting_ns: int | None = None  # for bit 12 in mode 1
        self._worst = [0] * len(self.axes)
        self._blend = self._lead = round(BLEND_S * 1e9 / sync.period_ns)

    @property
    def is_active(self) -> bool:
        """Whether it sends: then frames are not gathered."""
        return self._armed and self.state is not State.STOPPED

    @property
    def is_moving(self) -> bool:
        """Whether drives are, or may be, enabled."""
        return self.state in (State.ENABLING, State.PLAYING, State.HOLDING, State.STOPPING)

    def arm(self) -> None:
        """From now on the motion is played as soon as all drives are ready; may be called by another thread."""
        self._armed = True

    def request(self, name: str) -> None:
        """Play a segment from where the arm is held; refused, with an event, while it is not held there."""
        counts = self.config.segments.get(name)
        if counts is None or self.state is not State.HOLDING:
            why = "there is none of this name" if counts is None else f"the player is {self.state.name.lower()}"
            self._report.event(self._now_ns, Severity.WARNING, "segment_refused", f"{name}: {why}")
            return
        self._counts, self._name, self._lead, self._offsets = counts, name, 0, [0] * len(self.axes)
        self.state, self._first_tick = State.PLAYING, (self._sync.tick or 0) + 1
        self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{name} is played")

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
        elif self.state in (State.ENABLING, State.PLAYING, State.HOLDING):
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
        """Quick stop of all drives; nothing more is played."""
        if self.state is State.IDLE and self._was_armed:
            self._end(Severity.ERROR, "drive_refused", why)
        elif self.state in (State.ENABLING, State.PLAYING, State.HOLDING):
            self.state, self._since_ns, self._told_ns = State.STOPPING, self._now_ns, -REPEAT_NS
            self._report.event(self._now_ns, Severity.ERROR, "drive_stopped", f"quick stop: {why}")

    # Arming and enabling

    def _begin(self) -> None:
        late = [axis.name for axis in self.axes if not axis.is_ready or axis.position is None or axis.status is None]
        if late:
            if self._now_ns - self._since_ns > READY_NS:
                self.stop(f"not ready: {', '.join(late)}; see its events; the arm is not moved")
            return
        first = self.config.counts[0].tolist()
        for axis, start in zip(self.axes, first, strict=True):
            why = self._not_to_be_armed(axis, start)
            if why:
                self.stop(f"{axis.name} {why}")
                return
        self._offsets = [axis.distance(start) for axis, start in zip(self.axes, first, strict=True)]
        self.state, self._since_ns, self._told_ns = State.ENABLING, self._now_ns, 0
        seconds = (int(self.config.ticks[-1]) + self._blend) * self._sync.period_ns * 1e-9
        text = f"{self.config.name}, {seconds:.1f} s, {', '.join(axis.name for axis in self.axes)}"
        self._report.event(self._now_ns, Severity.WARNING, "drive_armed", text)

    def _not_to_be_armed(self, axis: DriveAxis, start: int) -> str:
        if axis.state in drive_axis.FAULTS:
            return f"is in fault, statusword {axis.status or 0:04X}h: clear it with its tool"
        if axis.failed:
            return f"reports {axis.failed:04X}h (EMCY): clear it with its tool"
        if abs(axis.distance(start)) > axis.config.start_within:
            away = 360.0 * abs(axis.distance(start)) / axis.config.drive.counts_per_revolution
            return f"stands {away:.2f} deg from where the motion starts: bring it there"
        return ""

    def _enable(self) -> None:
        if all(axis.is_enabled for axis in self.axes):
            self.state, self._first_tick, self._row = State.PLAYING, (self._sync.tick or 0) + 1, 0
            self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{self.config.name} is played")
            return
        if self._now_ns - self._since_ns > ENABLE_NS:
            told = ", ".join(f"{axis.name} {axis.status or 0:04X}h" for axis in self.axes if not axis.is_enabled)
            self.stop(f"not enabled within {ENABLE_NS * 1e-9:g} s, statuswords: {told}")
            return
        if self._now_ns - self._told_ns >= self._sync.period_ns:
            self._told_ns = self._now_ns
            for axis in self.axes:
                axis.control(drive_axis.ENABLING.get(axis.state or 0, drive_axis.DISABLE_VOLTAGE))

    # Playing

    def _go_on(self) -> None:
        tick = self._sync.tick
        if tick is None or tick == self._sent_tick:
            return
        if self.state is State.ENABLING:
            if self.config.mode == CYCLIC:
                self._aim(tick, self._row_at(0))  # where they stand
            self._enable()
        elif self.config.mode == CYCLIC:
            self._aim(tick, self._row_at(tick + 1 - self._first_tick))
        else:
            self._way_point(tick)
        self._sent_tick = tick

    def _row_at(self, since: int) -> list[int]:
        """Targets so many SYNCs after the start; the motion begins when the way to it is over."""
        rows = self._counts
        row = min(max(since - self._lead, 0), len(rows) - 1)
        if since - self._lead >= len(rows) and self.state is State.PLAYING:
            self._finish()
        share = min(max(since / self._blend, 0.0), 1.0)
        left = 1.0 - share**3 * (10.0 + share * (-15.0 + 6.0 * share))
        return [round(target + left * offset) for target, offset in zip(rows[row].tolist(), self._offsets, strict=True)]

    def _aim(self, tick: int, targets: list[int]) -> None:
        for axis, target in zip(self.axes, targets, strict=True):
            axis.target(target)
        self._aimed.append((tick, targets))

    def _way_point(self, tick: int) -> None:
        """Mode 1: bit 4 tells that the target is new, bit 12 answers."""
        if self._waiting_ns is not None:
            if all((axis.status or 0) & drive_axis.ACKNOWLEDGE for axis in self.axes):
                self._waiting_ns = None
                for axis in self.axes:
                    axis.control(drive_axis.ENABLE | drive_axis.AT_ONCE)
            elif self._now_ns - self._waiting_ns > ACKNOWLEDGE_NS:
                self.stop("a target was not acknowledged (bit 12 of the statusword)")
            return
        ready = not any((axis.status or 0) & drive_axis.ACKNOWLEDGE for axis in self.axes)
        if self._row < len(self.config.ticks):
            if ready and tick - self._first_tick >= self.config.ticks[self._row]:
                for axis, target in zip(self.axes, self.config.counts[self._row].tolist(), strict=True):
                    axis.target(target, drive_axis.ENABLE | drive_axis.AT_ONCE | drive_axis.NEW_SET_POINT)
                self._row, self._waiting_ns, self._told_ns = self._row + 1, self._now_ns, self._now_ns
        elif ready and all((axis.status or 0) & drive_axis.REACHED for axis in self.axes):
            for axis, target in zip(self.axes, self.config.counts[-1].tolist(), strict=True):
                if abs(axis.distance(target)) > axis.config.following_error:
                    self.stop(f"{axis.name} says that its target is reached, and is elsewhere")
                    return
            if self.state is State.PLAYING:
                self._finish()
        elif self._now_ns - self._told_ns > ARRIVE_NS:
            self.stop("the last way point was not reached")

    def _finish(self) -> None:
        self.state = State.HOLDING
        far = (
            ""
            if self.config.mode != CYCLIC
            else "; largest following error, mdeg: "
            + ", ".join(
                f"{axis.name} {360e3 * far / axis.config.drive.counts_per_revolution:.0f}"
                for axis, far in zip(self.axes, self._worst, strict=True)
            )
        )
        text = f"{self._name} is over, its end is held{far}"
        self._report.event(self._now_ns, Severity.INFO, "drive_done", text)

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
                return f"no target was sent for {missed_ns // 1_000_000} ms: lost SYNCs, or this computer was late"
        for place, axis in enumerate(self.axes):
            if wrong := axis.unwell(self._now_ns, self._limit_ns):
                return f"{axis.name} {wrong}"
            for wrong in self._astray(place, axis) if self.state is not State.ENABLING else ():
                return f"{axis.name} {wrong}"
        return self._too_fast()

    def _astray(self, place: int, axis: DriveAxis) -> Iterator[str]:
        status = axis.status or 0
        if not axis.is_enabled:
            yield f"has left the operation enabled state, statusword {status:04X}h"
        if axis.mode_shown != self.config.mode:
            yield f"is in mode {axis.mode_shown}, not {self.config.mode} (6061h)"
        if self.config.mode == CYCLIC and status & drive_axis.FOLLOWING_ERROR:
            yield "reports a following error"
        if self._aimed:
            far = min(abs(axis.distance(targets[place])) for _, targets in self._aimed)
            self._worst[place] = max(self._worst[place], far)
            if far > axis.config.following_error:
                yield f"is {360.0 * far / axis.config.drive.counts_per_revolution:.2f} deg from where it was sent"

    def _too_fast(self) -> str:
        """Rates over a window long enough for the counts."""
        heard_ns = min(axis.heard_ns for axis in self.axes)
        if not self._past or heard_ns > self._past[-1][0]:
            self._past.append((heard_ns, [axis.position or 0 for axis in self.axes]))
        while len(self._past) > 2 and self._past[-1][0] - self._past[1][0] >= RATE_WINDOW_NS:
            self._past.popleft()
        then_ns, positions = self._past[0]
        elapsed_ns = self._past[-1][0] - then_ns
        if elapsed_ns < RATE_WINDOW_NS:
            return ""
        for axis, position in zip(self.axes, positions, strict=True):
            rate = abs(axis.distance(position)) * 1e9 / elapsed_ns
            if rate > RATE_SLACK * axis.config.rate + 2e9 / elapsed_ns:
                per_turn = axis.config.drive.counts_per_revolution
                return f"{axis.name} moves at {360.0 * rate / per_turn:.1f} deg/s, faster than its limit"
        return ""

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
        self.state = State.STOPPED
        self._report.event(self._now_ns, severity, code, text)

    def _beat(self) -> None:
        if self._now_ns - self._beat_ns >= self.config.heartbeat_ms * 1_000_000 // BEATS:
            self._beat_ns = self._now_ns
            self.axes[0].send(frame.HEARTBEAT + self.config.master, bytes([NmtState.OPERATIONAL]))
