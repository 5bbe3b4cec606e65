"""Every channel's samples on vehicle time.

Marks come from the sync pulses: an IMU flags the sample into whose period the edge fell, an encoder's adapter and a
node latch their own clocks on it, and the SYNC producer's counter stands in a known relation to the pulse code.
Arrival stamps serve to say which pulse a mark belongs to, as the clock of devices that see no pulses, and as a stopgap
where the line is silent. What was asked for was so at some time between question and answer.

Clock specifications of channels, given by a device's module and used by the timebase.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from drivers.sync_pulse.code import SHORTEST_INTERVAL
from onboard.channels import CLOCK
from onboard.timebase import marking
from onboard.timebase.arrival import ArrivalClock
from onboard.timebase.clock import ClockSolution, ClockState, DeviceClock
from onboard.timebase.pulse_train import PulseTrain

RECORD_EVERY_NS = 1_000_000_000  # of a clock that nothing new is known of
WIDEST_WINDOW_NS = 60e6
UNTOLD_DELAY_NS = 1e6  # of a serial line: a frame's time on it
_NO_ROWS: Rows = np.zeros(0, CLOCK)


class SampledChannel(NamedTuple):
    """A channel with a sample clock of its own that flags sync pulses (an IMU)."""

    period_ns: float


class MarkedChannel(NamedTuple):
    """A channel with a clock of its own that stamps sync pulses, in channel ``marks``.

    ``latches_counts``: its ticks are coarse, and the count latched on the edge refines them.
    """

    period_ns: float
    marks: str
    latches_counts: bool = False


class FreeChannel(NamedTuple):
    """A channel with a timer of its own and no marks; ``delay_ns``: from sample to arrival, waiting for a poll too.

    ``tolerance``: largest relative error of ``period_ns``.
    """

    period_ns: float
    delay_ns: float = 0.0
    delay_sigma_ns: float = 0.0
    tolerance: float = 0.06


class PolledChannel(NamedTuple):
    """A polled channel: ``tick`` is the time of the request, ``host_ns`` of the answer; their times on the wire.

    ``longest_ns``: after the question's end in which a device that answers at once has sampled, however late the host
        reads its answer.
    """

    question_ns: float = 0.0
    answer_ns: float = 0.0
    longest_ns: float = math.inf


class ProducerChannel(NamedTuple):
    """SYNC messages; each pulse of the line rises in the period of one."""

    period_ns: float
    delay_ns: float  # a SYNC frame on the wire: nodes sample at its end


class FollowerChannel(NamedTuple):
    """A channel whose ticks are those of channel ``sync``: the SYNCs of its bus, another channel of its device."""

    sync: str


class RecordedChannel(NamedTuple):
    """A channel of an imported recording: its host stamps are its times."""

    sigma_ns: float


ChannelClock = (
    SampledChannel | MarkedChannel | FreeChannel | PolledChannel | ProducerChannel | FollowerChannel | RecordedChannel
)


class SyncLine(NamedTuple):
    """The channel of the line's edges.

    ``coded``: with the published code, ``period_ns`` is that of SYNC; else of the pulses. ``late_ns``: typical largest
        latency of the kernel's stamp.
    """

    channel: str
    period_ns: float = 5e6
    coded: bool = True
    late_ns: int = 25_000

    @property
    def shortest_interval_ns(self) -> float:
        """Between two pulses."""
        return self.period_ns * (SHORTEST_INTERVAL - 1 if self.coded else 1)


class Timebase:
    """Vehicle time for every channel that has a clock.

    Args:
        channels: clock specification by channel name.
        line: the sync line, if there is one.
    """

    def __init__(self, channels: dict[str, ChannelClock], line: SyncLine | None) -> None:
        self._specs = channels
        self._line = line
        self._train = PulseTrain(line.period_ns) if line is not None and line.coded else None
        interval_ns = line.shortest_interval_ns if line is not None else WIDEST_WINDOW_NS
        self._edges = marking.NewestEdges(min(WIDEST_WINDOW_NS, 0.4 * interval_ns))
        self._sources = {name: source for name, spec in channels.items() if (source := _source(spec, line)) is not None}
        self._brackets = {n: marking.Bracket(*s) for n, s in channels.items() if isinstance(s, PolledChannel)}
        self._states: dict[str, ClockState] = {}
        self._recorded_ns: dict[str, int] = {}

    @property
    def channels(self) -> tuple[str, ...]:
        """Those whose samples it puts on vehicle time."""
        return tuple(self._specs)

    def update(self, now_ns: int, batches: dict[str, Rows]) -> Rows:
        """Take in what arrived; returns CLOCK rows of the clocks that moved (``sequence`` to be filled in).

        A clock that does not move is recorded once a second nevertheless, with the sigma that it then has.
        """
        if self._line is not None and self._line.channel in batches:
            self._pulses(self._line, batches[self._line.channel])
        moved = [name for name, source in self._sources.items() if self._move(name, source, batches)]
        for name, bracket in self._brackets.items():
            if name in batches and len(batches[name]):
                bracket.update(batches[name])
        due = list(moved)
        for name, source in self._sources.items():
            state = source.at(now_ns)
            if name not in moved and (
                state is not self._states.get(name, ClockState.ACQUIRING)
                or (source.best is not None and self._is_stale(name, now_ns))
            ):
                due.append(name)
            self._states[name] = state
        due += [name for name, bracket in self._brackets.items() if bracket.samples and self._is_stale(name, now_ns)]
        self._recorded_ns |= dict.fromkeys(due, now_ns)
        return self._records(now_ns, due)

    def _is_stale(self, name: str, now_ns: int) -> bool:
        return now_ns - self._recorded_ns.get(name, 0) >= RECORD_EVERY_NS

    def time_ns(self, channel: str, rows: Rows) -> NDArray[np.int64] | None:
        """When samples of ``channel`` were taken, filter delays not removed; None: not known yet, or contradicted.

        A clock without marks falls back on arrival stamps, whose error is milliseconds: see :meth:`sigma_ns`.

        Args:
            channel: its name.
            rows: with fields ``tick`` and ``host_ns``, (n,).
        """
        spec = self._specs[channel]
        if isinstance(spec, RecordedChannel):
            return rows["host_ns"].astype(np.int64)
        if isinstance(spec, PolledChannel):
            return self._brackets[channel].time_ns(rows)
        clock, delay_ns = self._clock(channel)
        return None if clock is None else clock.time_ns(rows["tick"]) + np.int64(delay_ns)

    def sigma_ns(self, channel: str, at_ns: int) -> float:
        """1-sigma of :meth:`time_ns` for samples of about vehicle time ``at_ns``; infinite while nothing is known."""
        spec = self._specs[channel]
        if isinstance(spec, RecordedChannel):
            return spec.sigma_ns
        if isinstance(spec, PolledChannel):
            return self._brackets[channel].sigma_ns
        clock, _ = self._clock(channel)
        return np.inf if clock is None else clock.sigma_ns(clock.tick_at(at_ns))

    def waited(self, channel: str, rows: Rows) -> NDArray[np.bool_] | None:
        """Which samples (n,) were taken later than their ticks say: the device's line was busy telling of an edge.

        None of a channel whose device does not tell of edges.
        """
        source = self._sources.get(channel)
        if isinstance(source, marking.LatchingSource):
            return source.waited(rows["tick"].astype(np.int64))
        return None

    def trusted(self, channel: str) -> bool:
        """Whether the channel's clock runs on the best it can have, and not on a stopgap."""
        spec = self._specs[channel]
        match spec:
            case RecordedChannel():
                return True
            case PolledChannel():
                return bool(self._brackets[channel].samples)
            case FollowerChannel():
                return self.trusted(spec.sync)
            case _:
                return self._sources[channel].main.trusted

    def _pulses(self, line: SyncLine, rows: Rows) -> None:
        for edge_ns in rows["edge_ns"].tolist():
            edge = marking.EdgeBounds(edge_ns - line.late_ns, edge_ns)
            self._edges.append(edge)
            place = self._train.edge(edge_ns) if self._train is not None else None
            if place is not None:
                for source in self._sources.values():
                    if isinstance(source, marking.SyncSource):
                        source.edge(edge, place)

    def _move(self, name: str, source: marking.TickSource, batches: dict[str, Rows]) -> bool:
        rows = batches.get(name, _NO_ROWS)
        match source, self._specs[name]:
            case marking.LatchingSource(), MarkedChannel(_, channel, _):
                marks = batches.get(channel, _NO_ROWS)
                return len(rows) + len(marks) > 0 and source.update(rows, marks, self._edges)
            case marking.FlaggingSource(), _:
                return len(rows) > 0 and source.update(rows, self._edges)
            case _:
                return len(rows) > 0 and source.take(rows)

    def only(self, channels: Collection[str]) -> "Timebase":
        """A fresh one that has the clocks of these channels alone."""
        wanted = {*channels, *map(self.clock_of, channels)}
        return Timebase({name: spec for name, spec in self._specs.items() if name in wanted}, self._line)

    def clock_of(self, channel: str) -> str:
        """The channel whose clock a channel's samples are timed by: itself, or what it follows."""
        spec = self._specs[channel]
        return spec.sync if isinstance(spec, FollowerChannel) else channel

    def _clock(self, channel: str) -> tuple[DeviceClock | ArrivalClock | None, float]:
        name = self.clock_of(channel)
        source = self._sources[name]
        clock = None if source.clock.contradicted else source.best
        return clock, source.delay_ns if isinstance(source, marking.SyncSource) and name != channel else 0.0

    def _records(self, now_ns: int, names: list[str]) -> Rows:
        rows = np.zeros(len(names), CLOCK)
        for row, name in zip(rows, names, strict=True):
            row["host_ns"], row["channel"] = now_ns, name.encode()
            if name in self._brackets:
                bracket = self._brackets[name]
                solution = ClockSolution(
                    bracket.newest_ns,
                    bracket.newest_ns,
                    1.0,
                    bracket.sigma_ns,
                    0.0,
                    0.0,
                    bracket.samples,
                    ClockState.LOCKED,
                )
            else:
                source = self._sources[name]
                clock = source.best or source.main
                row["rejected"], row["residual_ns"] = clock.rejected, clock.residual_ns
                flywheels = clock.state is ClockState.FLYWHEEL
                solution = clock.solution_at(clock.tick_at(now_ns)) if flywheels else clock.solution
                if clock is not source.main:
                    solution = solution._replace(state=source.main.state)
            for field, value in zip(solution._fields, solution, strict=True):
                row[field] = value
        return rows


def _source(spec: ChannelClock, line: SyncLine | None) -> marking.TickSource | None:
    match spec:
        case SampledChannel(period_ns):
            return marking.FlaggingSource(period_ns) if line else marking.FreeSource(period_ns, 0.0, period_ns)
        case MarkedChannel(period_ns, _, latches_counts):
            return (
                marking.LatchingSource(period_ns, latches_counts)
                if line
                else marking.FreeSource(period_ns, 0.0, UNTOLD_DELAY_NS)
            )
        case FreeChannel():
            return marking.FreeSource(*spec)
        case ProducerChannel(period_ns, delay_ns):
            return marking.SyncSource(period_ns, delay_ns, line is not None and line.coded)
        case _:
            return None
