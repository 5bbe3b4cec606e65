"""Plays a motion over the drives of a bus, and stops them all when anything is not as it has to be.

Nothing is sent before ``arm``, but for the set-up. Armed, it enables the drives where they stand, blends into the
motion within ``BLEND_S`` or as long as their limits need, and sends each target after the tick (SYNC, or round of
requests) before the one it is for. It watches, on every pump, what every master does, and each drive's distance from
its target. Where ticks were lost, or this computer was late, the drives stood at their last target: the motion goes on
from there, from rest to its own pace within their accelerations, and ends as much later.

The drives stop by themselves when this process is not there any more: that is set up before, and read back.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from drivers.play.axis import Axis, AxisConfig, DriveTicks
from drivers.play.master import Axis_co, DriveMaster, MasterState
from drivers.records import Severity
from drivers.reporter import Reporter

BLEND_S: Final = 1.0  # from where the arm stands to the motion, at least
BLEND_RATE, BLEND_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)  # largest of 10 u^3 - 15 u^4 + 6 u^5, by u
ARRIVE_NS: Final = 60_000_000_000  # of the last way point of a profile
ACKNOWLEDGE_NS: Final = 500_000_000
LATENCY: Final = 3  # ticks from a target being sent to its being reached
Config_co = TypeVar("Config_co", bound=AxisConfig, covariant=True)


@dataclass(frozen=True)
class PlayerConfig(Generic[Config_co]):
    """What is played, and how.

    Attributes:
        axes: The drives, in the order of the columns.
        ticks: Periods from the start of the motion to each row, rising, (n,).
        counts: Target of each drive, (n, axes).
        is_profile: Its rows are way points of the drives' own profiles, instead of a target for each tick.
        heartbeat_ms: How long the drives do without us.
        sync_limit_ms: Longest time without a tick, or without an answer of a drive.
        name: Of the motion, for messages.
        segments: Further motions by name, a row for each tick, from the motion's last row and back to it.
    """

    axes: tuple[Config_co, ...]
    ticks: NDArray[np.int64]
    counts: NDArray[np.int64]
    is_profile: bool = False
    heartbeat_ms: int = 100
    sync_limit_ms: float = 25.0
    name: str = "motion"
    segments: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.counts.shape != (len(self.ticks), len(self.axes)) or len(self.ticks) < 2 or not self.axes:
            raise ConfigurationError(f"{self.name}: {self.counts.shape} targets for {len(self.axes)} drives: two rows")
        for name, counts in self.segments.items():
            if self.is_profile or counts.ndim != 2 or np.abs(counts[[0, -1]] - self.counts[-1]).max() > 1:
                raise ConfigurationError(
                    f"{name}: segments are cyclic, from where {self.name} ends and back: correct it"
                )
        columns = np.concatenate([self.counts, *self.segments.values()]).T
        for axis, column in zip(self.axes, columns, strict=True):
            if column.min() < axis.low or column.max() > axis.high:
                raise ConfigurationError(f"{self.name}: {axis.drive.name} would leave its limits: correct the motion")


class Player(DriveMaster[Axis_co]):
    """The player of one bus; arguments and attributes as :class:`DriveMaster` has."""

    SENDS: ClassVar = "target"
    STOPPED_AS: ClassVar = Severity.ERROR

    def __init__(
        self, config: PlayerConfig[AxisConfig], axes: Sequence[Axis_co], ticks: DriveTicks, report: Reporter
    ) -> None:
        super().__init__(config, axes, ticks, report)
        self.config = config
        self._first_tick = self._row = 0
        self._played = -1.0  # rows after the start, of the last target
        self._pace, self._gain = 1.0, 1.0  # rows a tick; of it that is missing, the share that a tick adds
        self._counts, self._name = config.counts, config.name  # of what is played now
        self._offsets: list[int] = []
        self._aimed: deque[tuple[int, list[int]]] = deque(maxlen=LATENCY + 1)
        self._waiting_ns: int | None = None  # for a way point to be acknowledged
        self._worst = [0] * len(self.axes)
        self._blend = self._lead = round(BLEND_S * 1e9 / ticks.period_ns)

    def request(self, name: str) -> None:
        """Play a segment from where the arm is held; refused, with an event, while it is not held there."""
        counts = self.config.segments.get(name)
        if counts is None or self.state is not MasterState.HOLDING:
            why = "there is none of this name" if counts is None else f"the player is {self.state.name.lower()}"
            self._report.event(self._now_ns, Severity.WARNING, "segment_refused", f"{name}: {why}")
            return
        self._counts, self._name, self._lead, self._offsets = counts, name, 0, [0] * len(self.axes)
        self.state = MasterState.PLAYING
        self._begin_motion()
        self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{name} is played")

    # Arming

    def _not_to_be_armed(self, place: int, axis: Axis) -> str:
        if why := super()._not_to_be_armed(place, axis):
            return why
        if axis.position is None or not axis.config.low <= axis.position <= axis.config.high:
            return "stands outside its limits: bring it back by hand, or with its tool"
        away = abs(axis.distance(int(self.config.counts[0][place])))
        if away > axis.config.start_within:
            return f"stands {axis.config.degrees(away):.2f} deg from where the motion starts: bring it there"
        return ""

    def _get_ready(self) -> str:
        first = self.config.counts[0].tolist()
        self._offsets = [axis.distance(start) for axis, start in zip(self.axes, first, strict=True)]
        period_s = self._ticks.period_ns * 1e-9
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

    def _started(self) -> None:
        self._row = 0
        self._begin_motion()
        self._report.event(self._now_ns, Severity.INFO, "drive_started", f"{self.config.name} is played")

    # Playing

    def _go_on(self) -> None:
        tick = self._ticks.tick
        if tick is None or tick == self._sent_tick:
            return
        if self.state is MasterState.ENABLING:
            if not self.config.is_profile:
                self._aim(tick, self._row_at(0))  # where they stand
            self._enable()
        elif not self.config.is_profile:
            self._play(tick)
        else:
            self._way_point(tick)
        self._sent_tick = tick

    def _begin_motion(self) -> None:
        self._first_tick, self._played, self._pace = (self._ticks.tick or 0) + 1, -1.0, 1.0
        square = (self._ticks.period_ns * 1e-9) ** 2
        steps = np.abs(np.diff(self._counts, axis=0)).max(axis=0).tolist()
        blends = [BLEND_RATE * abs(offset) / self._blend for offset in self._offsets]
        largest = [max(1.0, *both) for both in zip(steps, blends, strict=True)]
        own = zip(self.axes, largest, strict=True)
        self._gain = min(1.0, *(axis.config.acceleration * square / most for axis, most in own))

    def _play(self, tick: int) -> None:
        """The next targets. After SYNCs without one the drives stand, and the pace begins at zero.

        At pace p the motion's acceleration takes up p of the limit at most; what the pace gains, ``gain (1 - p)``
        rows, takes up ``1 - p`` of it.
        """
        if self._sent_tick is not None and tick - self._sent_tick > 1:
            self._pace = 0.0
        self._pace += (1.0 - self._pace) * self._gain
        self._played += self._pace
        if self._played - self._lead >= len(self._counts) and self.state is MasterState.PLAYING:
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
        """Each is acknowledged and confirmed before the next."""
        if self._waiting_ns is not None:
            if all(axis.has_taken for axis in self.axes):
                self._waiting_ns = None
                for axis in self.axes:
                    axis.confirm()
            elif self._now_ns - self._waiting_ns > ACKNOWLEDGE_NS:
                self.stop("a target was not acknowledged")
            return
        ready = not any(axis.has_taken for axis in self.axes)
        if self._row < len(self.config.ticks):
            if ready and tick - self._first_tick >= self.config.ticks[self._row]:
                for axis, target in zip(self.axes, self.config.counts[self._row].tolist(), strict=True):
                    axis.way_point(target)
                self._row, self._waiting_ns, self._told_ns = self._row + 1, self._now_ns, self._now_ns
        elif ready and all(axis.has_arrived for axis in self.axes):
            for axis, target in zip(self.axes, self.config.counts[-1].tolist(), strict=True):
                if abs(axis.distance(target)) > axis.config.following_error:
                    self.stop(f"{axis.name} says that its target is reached, and is elsewhere")
                    return
            if self.state is MasterState.PLAYING:
                self._finish()
        elif self._now_ns - self._told_ns > ARRIVE_NS:
            self.stop("the last way point was not reached")

    def _finish(self) -> None:
        self.state = MasterState.HOLDING
        far = (
            ""
            if self.config.is_profile
            else "; largest following error, mdeg: "
            + ", ".join(
                f"{axis.name} {1e3 * axis.config.degrees(far):.0f}"
                for axis, far in zip(self.axes, self._worst, strict=True)
            )
        )
        text = f"{self._name} is over, its end is held{far}"
        self._report.event(self._now_ns, Severity.INFO, "drive_done", text)

    # Watching

    def _astray(self, place: int, axis: Axis) -> Iterator[str]:
        yield from super()._astray(place, axis)
        if self._aimed:
            far = min(abs(axis.distance(targets[place])) for _, targets in self._aimed)
            self._worst[place] = max(self._worst[place], far)
            if far > axis.config.following_error:
                yield f"is {axis.config.degrees(far):.2f} deg from where it was sent"
