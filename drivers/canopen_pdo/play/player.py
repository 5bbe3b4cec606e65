"""Plays a motion over the drives of a CAN bus, and stops them all when anything is not as it has to be.

Nothing is sent before ``arm``, but for the set-up. Armed, it beats (CiA 301 heartbeat, which the drives watch), enables
the drives where they stand, blends into the motion within ``BLEND_S`` or as long as their limits need, and sends each
target after the SYNC before the one it is for. It watches, on every pump: SYNC, each drive's answers, state, mode,
position, rate, distance from the target, EMCY, reboot. Whatever is wrong becomes a quick stop of all drives, once; a
player that has stopped does not start again. Where SYNCs were lost, or this computer was late, the drives stood at
their last target: the motion goes on from there, from rest to its own pace within their accelerations, and ends as much
later.

The drives stop by themselves when this process does not beat any more: that is set up before, and read back.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import ClassVar, Final

import numpy as np

from drivers.canopen_pdo.play import drive_axis
from drivers.canopen_pdo.play.drive_axis import CYCLIC, DriveAxis
from drivers.canopen_pdo.play.drive_master import DriveMaster, State
from drivers.canopen_pdo.play.player_config import PlayerConfig
from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import Severity
from drivers.reporter import Reporter

BLEND_S: Final = 1.0  # from where the arm stands to the motion, at least
BLEND_RATE, BLEND_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)  # largest of 10 u^3 - 15 u^4 + 6 u^5, by u
ARRIVE_NS: Final = 60_000_000_000  # of the last way point of a profile
ACKNOWLEDGE_NS: Final = 500_000_000
LATENCY: Final = 3  # SYNCs from a target being sent to its being reached


class Player(DriveMaster):
    """The player of one CAN bus; arguments and attributes as :class:`DriveMaster` has, the mode in ``config``."""

    SENDS: ClassVar = "target"
    STOPPED_AS: ClassVar = Severity.ERROR

    def __init__(
        self, config: PlayerConfig, sync: SyncCounter, send: Callable[[int, bytes], None], report: Reporter
    ) -> None:
        super().__init__(config, config.mode, sync, send, report)
        self.config = config
        self._first_tick = self._row = 0
        self._played = -1.0  # rows after the start, of the last target
        self._pace, self._gain = 1.0, 1.0  # rows a SYNC; of it that is missing, the share that a SYNC adds
        self._counts, self._name = config.counts, config.name  # of what is played now
        self._offsets: list[int] = []
        self._aimed: deque[tuple[int, list[int]]] = deque(maxlen=LATENCY + 1)
        self._waiting_ns: int | None = None  # for bit 12 in mode 1
        self._worst = [0] * len(self.axes)
        self._blend = self._lead = round(BLEND_S * 1e9 / sync.period_ns)

    def request(self, name: str) -> None:
        """Play a segment from where the arm is held; refused, with an event, while it is not held there."""
        counts = self.config.segments.get(name)
        if counts is None or self.state is not State.HOLDING:
            why = "there is none of this name" if counts is None else f"the player is {self.state.name.lower()}"
            self._report.event(self._now_ns, Severity.WARNING, "segment_refused", f"{name}: {why}")
            return
        self._counts, self._name, self._lead, self._offsets = counts, name, 0, [0] * len(self.axes)
        self.state = State.PLAYING
        self._begin_motion()
        self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{name} is played")

    # Arming

    def _not_to_be_armed(self, place: int, axis: DriveAxis) -> str:
        if why := super()._not_to_be_armed(place, axis):
            return why
        if axis.position is None or not axis.config.low <= axis.position <= axis.config.high:
            return "stands outside its limits: bring it back by hand, or with its tool"
        away = abs(axis.distance(int(self.config.counts[0][place])))
        if away > axis.config.start_within:
            stands = 360.0 * away / axis.config.drive.counts_per_revolution
            return f"stands {stands:.2f} deg from where the motion starts: bring it there"
        return ""

    def _get_ready(self) -> str:
        first = self.config.counts[0].tolist()
        self._offsets = [axis.distance(start) for axis, start in zip(self.axes, first, strict=True)]
        period_s = self._sync.period_ns * 1e-9
        self._blend = self._lead = math.ceil(self._blend_s() / period_s)
        seconds = (int(self.config.ticks[-1]) + self._blend) * period_s
        return f"{self.config.name}, {seconds:.1f} s, {super()._get_ready()}"

    def _blend_s(self) -> float:
        """How long the way to the motion takes, so that no axis leaves its rate or acceleration on it."""
        needed = [BLEND_S]
        for axis, offset in zip(self.axes, self._offsets, strict=True):
            needed.append(BLEND_RATE * abs(offset) / axis.config.rate)
            needed.append(math.sqrt(BLEND_ACCELERATION * abs(offset) / axis.config.acceleration))
        return max(needed)

    def _hold_still(self, axis: DriveAxis) -> None:
        """Nothing is sent: a drive that gets no set point stays where it is enabled."""

    def _started(self) -> None:
        self._row = 0
        self._begin_motion()
        self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{self.config.name} is played")

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
            self._play(tick)
        else:
            self._way_point(tick)
        self._sent_tick = tick

    def _begin_motion(self) -> None:
        self._first_tick, self._played, self._pace = (self._sync.tick or 0) + 1, -1.0, 1.0
        square = (self._sync.period_ns * 1e-9) ** 2
        steps = np.abs(np.diff(self._counts, axis=0)).max(axis=0).tolist()
        blends = [BLEND_RATE * abs(offset) / self._blend for offset in self._offsets]
        largest = [max(1.0, *both) for both in zip(steps, blends, strict=True)]
        own = zip(self.axes, largest, strict=True)
        self._gain = min(1.0, *(axis.config.acceleration * square / most for axis, most in own))

    def _play(self, tick: int) -> None:
        """The next targets. After SYNCs without one the drives stand, and the pace begins at zero.

        At pace p the motion's own acceleration takes up p of the limit at most; what the pace gains, ``gain (1 - p)``
        rows, takes up ``1 - p`` of it.
        """
        if self._sent_tick is not None and tick - self._sent_tick > 1:
            self._pace = 0.0
        self._pace += (1.0 - self._pace) * self._gain
        self._played += self._pace
        if self._played - self._lead >= len(self._counts) and self.state is State.PLAYING:
            self._finish()
        self._aim(tick, self._row_at(self._played))

    def _row_at(self, since: float) -> list[int]:
        """Targets so many rows after the start, between two of them too; the motion begins when the blend is over."""
        rows = self._counts
        at = min(max(since - self._lead, 0.0), len(rows) - 1.0)
        row = min(int(at), len(rows) - 2)
        share = min(max(since / self._blend, 0.0), 1.0)
        left = 1.0 - share**3 * (10.0 + share * (-15.0 + 6.0 * share))
        between = rows[row] + (at - row) * (rows[row + 1] - rows[row])
        return [round(target + left * offset) for target, offset in zip(between.tolist(), self._offsets, strict=True)]

    def _aim(self, tick: int, targets: list[int]) -> None:
        for axis, target in zip(self.axes, targets, strict=True):
            axis.target(target)
        self._aimed.append((tick, targets))

    def _way_point(self, tick: int) -> None:
        """Mode 1: bit 4 marks a new target, bit 12 acknowledges it."""
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

    def _astray(self, place: int, axis: DriveAxis) -> Iterator[str]:
        yield from super()._astray(place, axis)
        if self.config.mode == CYCLIC and (axis.status or 0) & drive_axis.FOLLOWING_ERROR:
            yield "reports a following error"
        if self._aimed:
            far = min(abs(axis.distance(targets[place])) for _, targets in self._aimed)
            self._worst[place] = max(self._worst[place], far)
            if far > axis.config.following_error:
                yield f"is {360.0 * far / axis.config.drive.counts_per_revolution:.2f} deg from where it was sent"
