"""Sources of clock marks: one class per way in which a device registers the sync pulses in its stream.

Every source keeps two clocks of a device: one from marks and, until that is locked, one from arrival stamps. Both
restart when the device's ticks restart.
"""

from collections import deque
from typing import NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from drivers.sync_pulse import code
from onboard.timebase.arrival import ArrivalClock
from onboard.timebase.clock import CRYSTAL_DRIFT_PER_S, ClockState, DeviceClock, Mark
from onboard.timebase.latch import LatchedCounts
from onboard.timebase.pulse_train import PulsePlace

SYNC_COUNTER_MODULUS = 240  # CiA 301 1019h as the sync box is set
# A QSB reports an edge in two lines of 1.13 ms; a position due meanwhile is measured after them
BUSY_TICKS = 3.1
_RESET = int(SampleStatus.AFTER_RESET)
# Cycles of the code differ in the SYNC counter of their pulses by multiples of this: 16, which is 80 ms
_CYCLE_COUNTS = int(np.gcd(code.cycle_sync_periods(), SYNC_COUNTER_MODULUS))


class EdgeBounds(NamedTuple):
    """The line rose between ``earliest_ns`` and ``latest_ns``."""

    earliest_ns: int
    latest_ns: int


class NewestEdges:
    """The newest edges of the line.

    Args:
        window_ns: search window on either side: less than half the shortest interval.
    """

    HELD = 64

    def __init__(self, window_ns: float) -> None:
        self.window_ns = window_ns
        self._edges: deque[EdgeBounds] = deque(maxlen=self.HELD)

    def append(self, edge: EdgeBounds) -> None:
        """Add an edge."""
        self._edges.append(edge)

    def may_come(self, time_ns: int) -> bool:
        """Whether the edge at ``time_ns`` may still be unread."""
        return not self._edges or time_ns - self._edges[-1].latest_ns > self.window_ns

    def near(self, time_ns: int) -> EdgeBounds | None:
        """The edge at ``time_ns``, if there is one."""
        nearest = min(self._edges, key=lambda edge: abs(edge.latest_ns - time_ns), default=None)
        return nearest if nearest is not None and abs(nearest.latest_ns - time_ns) < self.window_ns else None


class TickSource:
    """A device with its own tick counter.

    Args:
        clock: from marks.
        arrival: from arrival stamps.
        is_marked: whether it registers sync pulses; else only arrival stamps are used.
    """

    LATE_NS = 250e6  # samples later than this indicate a restart of the ticks
    LATE_TO_RESTART = 10

    def __init__(self, clock: DeviceClock, arrival: ArrivalClock, is_marked: bool = True) -> None:
        self.clock, self.arrival, self.is_marked = clock, arrival, is_marked
        self._newest: tuple[int, int] | None = None  # tick and host_ns of the newest sample
        self._late = self._without_edge = 0

    @property
    def main(self) -> "DeviceClock | ArrivalClock":
        """Its mark clock, or its arrival clock if it has no marks."""
        return self.clock if self.is_marked else self.arrival

    @property
    def best(self) -> "DeviceClock | ArrivalClock | None":
        """The clock to use now."""
        return self.clock if self.clock.trusted else self.arrival if self.arrival.trusted else None

    def at(self, now_ns: int) -> ClockState:
        """The state of its main clock at ``now_ns``."""
        self.clock.at(now_ns), self.arrival.at(now_ns)
        return self.main.state

    def take(self, rows: Rows) -> bool:
        """Take samples; returns whether the main clock changed."""
        return self._samples(rows)[1]

    def restart(self) -> None:
        """The device's ticks restarted."""
        self.clock.restart()
        self.arrival.restart()
        self._newest, self._late, self._without_edge = None, 0, 0

    def _samples(self, rows: Rows) -> tuple[Rows, bool]:
        """Take samples; returns those since the last restart of the ticks, and whether the arrival clock changed."""
        ticks = rows["tick"].astype(np.int64)
        anew = (ticks[1:] < ticks[:-1]).nonzero()[0] + 1
        if self._newest and ticks[0] < self._newest[0]:
            anew = np.append(0, anew)
        if "status" in (rows.dtype.names or ()):
            resets = rows["status"] & _RESET
            anew = np.union1d(anew, np.flatnonzero(resets)) if resets.any() else anew
        if len(anew):
            self.restart()
            rows, ticks = rows[anew[-1] :], ticks[anew[-1] :]
        moved = False
        stamps = rows["host_ns"]
        last = [*(stamps[1:] != stamps[:-1]).nonzero()[0].tolist(), len(stamps) - 1]  # last sample of each read
        for tick, host_ns in zip(ticks[last].tolist(), stamps[last].tolist(), strict=True):
            moved |= self.arrival.arrived(tick, host_ns)
        self._newest = (int(ticks[-1]), int(rows["host_ns"][-1]))
        self._plausible(*self._newest)
        return rows, moved

    def _plausible(self, tick: int, host_ns: int) -> None:
        """Restart the clocks if a sample arrives before its time or too late: its ticks must have restarted."""
        clock = self.clock
        if not clock.trusted:
            return
        late_ns = host_ns - int(clock.time_ns(np.array([tick]))[0])
        if late_ns < -(1e6 + clock.period_ns + 5.0 * clock.sigma_ns(tick)):
            clock.restart()
        elif late_ns > self.LATE_NS:
            clock.suspect()
            self._late += 1
            if self._late >= self.LATE_TO_RESTART:
                self.restart()
        else:
            self._late = 0

    def _accepted(self, mark: Mark) -> bool:
        """Take in a mark; whether it was accepted. One that locks the clock may be older than a jump of the ticks."""
        was_trusted = self.clock.trusted
        accepted = self.clock.mark(mark)
        if accepted and not was_trusted and self._newest is not None:
            self._plausible(*self._newest)
        return accepted

    def _is_told(self, edge: EdgeBounds | None, window_ns: float) -> TypeGuard[EdgeBounds]:
        """Whether the line has an edge for a mark; repeated misses count against the clock."""
        if edge is not None:
            self._without_edge = 0
            return True
        self._without_edge += 1
        if self._without_edge >= self.clock.REJECTS_TO_REACQUIRE:
            self.restart()
        self.clock.suspect(window_ns)
        return False

    def _estimate(self, tick: float) -> int | None:
        """Approximate vehicle time of ``tick``, ns; None if unknown."""
        clock = self.best
        if clock is not None:
            return int(clock.time_ns(np.array([tick]))[0])
        if self._newest is None:
            return None
        newest, host_ns = self._newest
        return host_ns - round((newest - tick) * self.clock.nominal_period_ns)


class FlaggingSource(TickSource):
    """An IMU that flags the sample during which the edge fell."""

    def __init__(self, period_ns: float) -> None:
        # mean age of the newest sample of a drain: half a period
        super().__init__(DeviceClock(period_ns), ArrivalClock(period_ns, delay_sigma_ns=period_ns))
        self._flagged: deque[int] = deque(maxlen=16)
        self._last_flagged = -2

    def restart(self) -> None:
        """See ``TickSource``."""
        super().restart()
        self._flagged.clear()
        self._last_flagged = -2

    def update(self, rows: Rows, edges: NewestEdges) -> bool:
        """Take samples; returns whether a mark was accepted."""
        before = self._newest
        rows, _ = self._samples(rows)
        ticks = rows["tick"].astype(np.int64)
        contiguous = np.empty(len(ticks), np.bool_)
        contiguous[0] = before is not None and self._newest is not None and ticks[0] - before[0] == 1
        contiguous[1:] = ticks[1:] - ticks[:-1] == 1
        if before is not None and not contiguous.all():
            self.clock.blur(1.0)
        for place in rows["sync"].nonzero()[0].tolist():
            tick = int(ticks[place])
            # a pulse still high at the end of its sample flags the next one too: only the first one is a mark,
            # and which is first is unknown after a gap
            if tick != self._last_flagged + 1 and contiguous[place]:
                self._flagged.append(tick)
            self._last_flagged = tick
        return self._match(edges)

    def _match(self, edges: NewestEdges) -> bool:
        accepted = False
        while self._flagged:
            tick = self._flagged[0]
            estimate = self._estimate(tick - 0.5)
            if estimate is None or edges.may_come(estimate):
                break
            self._flagged.popleft()
            edge = edges.near(estimate)
            if self._is_told(edge, edges.window_ns):
                accepted |= self._accepted(Mark(tick - 1, tick, *edge))
        return accepted


class LatchingSource(TickSource):
    """A device that stamps edges with its own clock: MARK rows beside its samples.

    Args:
        period_ns: nominal length of a tick.
        latches_counts: whether its marks carry the count latched on the edge, used because its ticks are coarse.
    """

    def __init__(self, period_ns: float, latches_counts: bool) -> None:
        super().__init__(DeviceClock(period_ns), ArrivalClock(period_ns, delay_sigma_ns=1e6))
        self._latched = LatchedCounts() if latches_counts else None
        self._marks: deque[tuple[int, int]] = deque(maxlen=16)  # tick, latched value
        self._told: deque[float] = deque(maxlen=64)  # ticks of edges reported by the device

    def restart(self) -> None:
        """See ``TickSource``."""
        super().restart()
        self._marks.clear()
        self._told.clear()
        if self._latched is not None:
            self._latched.clear()

    def update(self, samples: Rows, marks: Rows, edges: NewestEdges) -> bool:
        """Take samples and marks; returns whether a mark was accepted."""
        if len(samples):
            samples, _ = self._samples(samples)
            if self._latched is not None:
                self._latched.append(samples)
        if len(marks) and self._newest is not None:
            # a device that restarted may have marked an edge before
            since = marks["tick"].astype(np.int64) <= self._newest[0] + round(1e9 / self.clock.nominal_period_ns)
            self._marks.extend(zip(marks["tick"][since].tolist(), marks["value_raw"][since].tolist(), strict=True))
        accepted = False
        while self._marks:
            tick, value = self._marks[0]
            estimate = self._estimate(tick + 0.5)
            if estimate is None or edges.may_come(estimate):
                break
            low, high = float(tick), float(tick + 1)
            if self._latched is not None:
                if not self._latched.complete(tick):
                    break
                low, high = self._latched.interval(tick, value)
                self._told.append(0.5 * (low + high))
            self._marks.popleft()
            edge = edges.near(estimate)
            if self._is_told(edge, edges.window_ns):
                accepted |= self._accepted(Mark(low, high, *edge))
        return accepted

    def waited(self, ticks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which samples (n,) were due while the line was busy with an edge, and so were taken later."""
        since = ticks[:, None] - np.array(self._told or [-np.inf])
        return np.asarray(((since > 0.0) & (since <= BUSY_TICKS)).any(axis=1), np.bool_)


class SyncSource(TickSource):
    """The SYNC producer, whose counter has a known relation to the pulse code.

    A bus latency can therefore not shift it by whole periods. The cycle of the code follows from the SYNC that arrived
        at about that time: those of other cycles are 80 ms or more away.
    """

    def __init__(self, period_ns: float, delay_ns: float, is_marked: bool) -> None:
        self.period_ns, self.delay_ns = period_ns, delay_ns
        super().__init__(
            DeviceClock(period_ns, 1e-3, CRYSTAL_DRIFT_PER_S),
            ArrivalClock(period_ns, 1e-2, delay_ns, 0.0, CRYSTAL_DRIFT_PER_S),
            is_marked,
        )
        self._recent: deque[tuple[int, int, int]] = deque(maxlen=400)  # (tick, counter, host_ns)
        self._unmatched: deque[tuple[EdgeBounds, PulsePlace]] = deque(maxlen=16)

    def restart(self) -> None:
        """See ``TickSource``."""
        super().restart()
        self._recent.clear()

    def edge(self, edge: EdgeBounds, place: PulsePlace) -> None:
        """Take an identified edge of the line."""
        self._unmatched.append((edge, place))

    def take(self, rows: Rows) -> bool:
        """Take SYNCs; returns whether the main clock changed."""
        rows, moved = self._samples(rows)
        self._recent.extend(
            zip(rows["tick"].tolist(), rows["sync_counter"].tolist(), rows["host_ns"].tolist(), strict=True)
        )
        accepted = False
        while self._unmatched:
            edge, place = self._unmatched[0]
            if self._recent[-1][2] < edge.latest_ns + 0.3e9:
                break  # its SYNC may not have arrived yet
            self._unmatched.popleft()
            tick = self._sync_of(edge, place)
            if tick is not None:
                at = tick + place.dither_ns / self.period_ns
                accepted |= self._accepted(Mark(at, at, *edge))
        return accepted if self.is_marked else moved

    def _sync_of(self, edge: EdgeBounds, place: PulsePlace) -> int | None:
        """Tick of the SYNC in whose period the pulse rose."""
        began_ns = edge.latest_ns - place.dither_ns
        if self.clock.trusted:
            near = round(self.clock.tick_at(began_ns))
            at, counter = next(((t, counter) for t, counter, _ in reversed(self._recent) if t <= near), (None, 0))
            return at if at == near and self._fits(counter, place) else None
        spacing_ns = _CYCLE_COUNTS * self.period_ns
        found = [
            (t, counter)
            for t, counter, host_ns in self._recent
            if self._fits(counter, place) and -0.1 < (host_ns - self.delay_ns - began_ns) / spacing_ns < 0.9
        ]
        return found[0][0] if len(found) == 1 else None

    @staticmethod
    def _fits(counter: int, place: PulsePlace) -> bool:
        return (counter - 1 - place.sync_count) % _CYCLE_COUNTS == 0


class FreeSource(TickSource):
    """A device with its own timer and without marks.

    Args:
        period_ns: nominal length of a tick.
        delay_ns: lower bound of the time from the sample to the arrival of its last byte.
        delay_sigma_ns: its standard deviation.
        tolerance: largest relative error of ``period_ns``.
    """

    def __init__(self, period_ns: float, delay_ns: float, delay_sigma_ns: float, tolerance: float = 0.06) -> None:
        arrival = ArrivalClock(period_ns, tolerance, delay_ns, delay_sigma_ns)
        super().__init__(DeviceClock(period_ns, tolerance), arrival, False)


class Bracket:
    """Samples taken between a request and its answer: no device clock, one interval per sample.

    Args:
        question_ns: lower bound of the request's time on the wire.
        answer_ns: the answer's time on the wire.
        longest_ns: from the request's end to the sample, at the most.
    """

    def __init__(self, question_ns: float, answer_ns: float, longest_ns: float = np.inf) -> None:
        self.question_ns, self.answer_ns = round(question_ns), round(answer_ns)
        self._longest_ns = longest_ns
        self.sigma_ns = np.inf
        self.samples = 0
        self.newest_ns = 0

    def update(self, rows: Rows) -> None:
        """Take samples."""
        for one in np.maximum(0.5 * self._width_ns(rows), 0.0).tolist():
            square = self.sigma_ns**2 if self.samples else one * one / 3.0
            self.sigma_ns = float(np.sqrt(square + (one * one / 3.0 - square) / min(self.samples + 1, 32)))
            self.samples += 1
        self.newest_ns = int(self.time_ns(rows)[-1])

    def time_ns(self, rows: Rows) -> NDArray[np.int64]:
        """Middle of the interval in which each of ``rows`` (n,) was taken [ns], (n,)."""
        return np.asarray(rows["tick"].astype(np.int64) + self.question_ns + self._width_ns(rows) // 2, np.int64)

    def _width_ns(self, rows: Rows) -> NDArray[np.int64]:
        between = rows["host_ns"] - rows["tick"].astype(np.int64) - self.question_ns - self.answer_ns
        return np.asarray(np.minimum(between, self._longest_ns), np.int64)
