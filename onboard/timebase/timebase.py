"""Every channel's samples on vehicle time.

Marks come from the sync pulses: an IMU flags the sample into whose period the edge fell, and the SYNC producer's
counter stands in a known relation to the pulse code, so no latency of the bus can shift a CAN clock by whole periods.
Arrival stamps serve to say which pulse a flagged sample belongs to, and as a stopgap clock where the line is silent.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard.channels import CLOCK
from onboard.timebase.clock import ClockState, DeviceClock, Mark
from onboard.timebase.pulse_train import PulsePlace, PulseTrain

SYNC_COUNTER_MODULUS = 240  # CiA 301 1019h as the sync box is set


class SampledChannel(NamedTuple):
    """A channel with a sample clock of its own that flags sync pulses (an IMU)."""

    period_ns: float


class SyncChannel(NamedTuple):
    """SYNC messages; each pulse of the line rises at the start of one."""

    period_ns: float
    delay_ns: float  # a SYNC frame on the wire: nodes sample at its end


class FollowerChannel(NamedTuple):
    """A channel whose ticks are SYNC numbers of ``sync``."""

    sync: str


class RecordedChannel(NamedTuple):
    """A channel of somebody else's recording: its ticks are its times [ns]."""

    sigma_ns: float


ChannelClock = SampledChannel | SyncChannel | FollowerChannel | RecordedChannel


class _Sampled:
    """Clock of a channel that flags pulses in its own samples."""

    def __init__(self, spec: SampledChannel) -> None:
        self.period_ns = spec.period_ns
        self.clock = DeviceClock(spec.period_ns, wander=1e-6)
        self.coarse = DeviceClock(spec.period_ns, wander=1e-5, flywheel_after_s=5.0, invalid_sigma_ns=20e6)
        self._flagged: deque[int] = deque(maxlen=16)
        self._last_flagged = -2

    def update(self, rows: Rows, edges: "deque[int]") -> bool:
        restarts = np.flatnonzero(rows["status"] & SampleStatus.AFTER_RESET)
        if len(restarts):
            self.clock.restart()
            self.coarse.restart()
            self._flagged.clear()
            rows = rows[restarts[-1] :]
        # the newest sample of a drain is on average half a period old when it is counted
        newest = rows[-1]
        self.coarse.mark(Mark(float(newest["tick"]), int(newest["host_ns"] - self.period_ns / 2), 2e6))
        for tick in rows["tick"][rows["sync"] != 0].tolist():
            # a pulse still high when its sample is latched flags the next one too: the first is the one it rose in
            if tick != self._last_flagged + 1:
                self._flagged.append(tick)
            self._last_flagged = tick
        return self._match(edges)

    def _match(self, edges: "deque[int]") -> bool:
        changed = False
        finder = self.clock if self.clock.trusted else self.coarse
        while self._flagged and finder.trusted and edges:
            tick = self._flagged[0]
            estimate = int(finder.time_ns(np.array([tick - 0.5]))[0])
            edge_ns = min(edges, key=lambda edge: abs(edge - estimate))
            if estimate - edges[-1] > 60e6:
                break  # its edge has not been read yet
            self._flagged.popleft()
            if abs(edge_ns - estimate) < 60e6:  # pulses are at least 150 ms apart
                # latched in the period that ended with this sample: uniform over one period
                changed |= self.clock.mark(Mark(tick - 0.5, edge_ns, self.clock.solution.period_ns / np.sqrt(12)))
        return changed


class _Sync:
    """Clock of the SYNC producer."""

    EDGE_SIGMA_NS = 10e3

    def __init__(self, spec: SyncChannel) -> None:
        self.delay_ns, self.period_ns = spec.delay_ns, spec.period_ns
        self.clock = DeviceClock(spec.period_ns, tolerance=1e-3, wander=5e-8)
        self.coarse = DeviceClock(spec.period_ns, tolerance=1e-2, wander=1e-6, flywheel_after_s=5.0)
        self._recent: deque[tuple[int, int, int]] = deque(maxlen=400)  # (tick, counter, host_ns)
        self._unmatched: deque[tuple[int, PulsePlace]] = deque(maxlen=16)

    def edge(self, edge_ns: int, place: PulsePlace) -> None:
        self._unmatched.append((edge_ns, place))

    def update(self, rows: Rows) -> bool:
        self._recent.extend(
            zip(rows["tick"].tolist(), rows["sync_counter"].tolist(), rows["host_ns"].tolist(), strict=True)
        )
        newest = rows[-1]
        self.coarse.mark(Mark(float(newest["tick"]), int(newest["host_ns"] - self.delay_ns), 1e6))
        changed = False
        while self._unmatched:
            edge_ns, place = self._unmatched[0]
            if self._recent[-1][2] < edge_ns + 0.3e9:
                break  # its SYNC may still be on its way
            self._unmatched.popleft()
            counter = place.sync_count % SYNC_COUNTER_MODULUS + 1
            # the counter recurs after 1.2 s, so within 0.6 s it names one SYNC
            ticks = [t for t, c, host_ns in self._recent if c == counter and abs(host_ns - edge_ns) < 0.3e9]
            if len(ticks) == 1:
                tick = ticks[0] + place.dither_ns / self.period_ns
                changed |= self.clock.mark(Mark(tick, edge_ns, self.EDGE_SIGMA_NS))
        return changed


class Timebase:
    """Vehicle time for every channel that has a clock.

    Args:
        channels: clock specification by channel name.
        pulse_channel: the channel of the sync line's edges, if there is one.
        sync_period_ns: nominal SYNC period that pulse intervals are counted in.
    """

    def __init__(
        self, channels: dict[str, ChannelClock], pulse_channel: str | None, sync_period_ns: float = 5e6
    ) -> None:
        self._specs = channels
        self._pulse_channel = pulse_channel
        self._train = PulseTrain(sync_period_ns)
        self._edges: deque[int] = deque(maxlen=64)
        self._sampled = {n: _Sampled(s) for n, s in channels.items() if isinstance(s, SampledChannel)}
        self._syncs = {n: _Sync(s) for n, s in channels.items() if isinstance(s, SyncChannel)}
        self._states: dict[str, ClockState] = {}

    def update(self, now_ns: int, batches: dict[str, Rows]) -> Rows:
        """Take in what arrived; returns CLOCK rows of the clocks that moved (``sequence`` to be filled in)."""
        changed: list[str] = []
        rows = batches.get(self._pulse_channel or "")
        if rows is not None:
            for edge_ns in rows["edge_ns"].tolist():
                self._edges.append(edge_ns)
                place = self._train.edge(edge_ns)
                if place is not None:
                    for sync in self._syncs.values():
                        sync.edge(edge_ns, place)
        for name, rows in batches.items():
            if not len(rows):
                continue
            if name in self._sampled and self._sampled[name].update(rows, self._edges):
                changed.append(name)
            if name in self._syncs and self._syncs[name].update(rows):
                changed.append(name)
        for name, clock in self._clocks():
            state = clock.at(now_ns)
            if state is not self._states.get(name, ClockState.ACQUIRING) and name not in changed:
                changed.append(name)
            self._states[name] = state
        return self._records(now_ns, changed)

    def time_ns(self, channel: str, ticks: NDArray[np.generic]) -> NDArray[np.int64] | None:
        """When samples ``ticks`` (n,) of ``channel`` were taken, filter delays not removed; None: not known yet.

        A clock without marks falls back on arrival stamps, whose error is milliseconds: see :meth:`sigma_ns`.
        """
        if isinstance(self._specs[channel], RecordedChannel):
            return ticks.astype(np.int64)
        clock, delay_ns = self._find(channel)
        if clock is None:
            return None
        return clock.time_ns(ticks) + np.int64(delay_ns)

    def sigma_ns(self, channel: str, tick: float) -> float:
        """1-sigma of :meth:`time_ns`; infinite while nothing is known."""
        spec = self._specs[channel]
        if isinstance(spec, RecordedChannel):
            return spec.sigma_ns
        clock, _ = self._find(channel)
        return np.inf if clock is None else clock.sigma_ns(tick)

    def trusted(self, channel: str) -> bool:
        """Whether the channel's clock runs on pulses (locked or flywheel) and not on arrival stamps."""
        spec = self._specs[channel]
        if isinstance(spec, RecordedChannel):
            return True
        name = spec.sync if isinstance(spec, FollowerChannel) else channel
        return dict(self._clocks())[name].trusted

    def _find(self, channel: str) -> tuple[DeviceClock | None, float]:
        spec = self._specs[channel]
        if isinstance(spec, FollowerChannel):
            delay_ns = self._syncs[spec.sync].delay_ns
            channel = spec.sync
        else:
            delay_ns = 0.0
        source = self._sampled.get(channel) or self._syncs[channel]
        for clock in (source.clock, source.coarse):
            if clock.trusted:
                return clock, delay_ns
        return None, delay_ns

    def _clocks(self) -> list[tuple[str, DeviceClock]]:
        return [(n, s.clock) for n, s in self._sampled.items()] + [(n, s.clock) for n, s in self._syncs.items()]

    def _records(self, now_ns: int, changed: list[str]) -> Rows:
        clocks = dict(self._clocks())
        rows = np.zeros(len(changed), CLOCK)
        for row, name in zip(rows, changed, strict=True):
            solution = clocks[name].solution
            row["host_ns"] = now_ns
            for field in (
                "reference_tick",
                "reference_ns",
                "period_ns",
                "sigma_ns",
                "sigma_period_ns",
                "residual_rms_ns",
                "marks",
            ):
                row[field] = getattr(solution, field)
            row["rejected"], row["state"], row["channel"] = clocks[name].rejected, solution.state, name.encode()
        return rows
