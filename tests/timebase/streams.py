"""Devices with clocks of their own on one sync line, as streams of records, and everything that may befall them."""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np

from drivers import records
from drivers.marks import MARK
from drivers.sync_pulse import code
from onboard.timebase import timebase
from onboard.timebase.clock import ClockState

SYNC_NS = 5_000_000
STEP_NS = 50_000_000
COUNTS_PER_RAD = 500_000 / (2 * np.pi)


class Mishap(NamedTuple):
    """Something that happens to ``device`` in step ``step``.

    miss: the device does not see the pulses of the step. deaf: the host does not. twice: the device marks them twice.
    echo: the host stamps them twice. reset: the device's ticks begin anew. told reset: and it says so. wrap: its
    counter loses its upper bits. jump: its ticks go on 120 samples further. slip: samples are lost, and counted wrong
    by one. late batch: the host stalls.
    """

    step: int
    device: str
    what: str


class Stream:
    """One device: its clock, its ticks, and when its samples are taken."""

    def __init__(self, rng: np.random.Generator, tick_ns: float, sample_ticks: float, rate_error: float) -> None:
        self.rng, self.sample_ticks = rng, sample_ticks
        self.tick_ns = tick_ns * (1.0 + rate_error)
        self.origin_ns = float(rng.uniform(0.0, tick_ns))  # of tick 0
        self.next = 0  # sample
        self.shift = 0  # of the ticks that it tells
        self.restarted = False

    def time_ns(self, tick: float) -> float:
        """When the tick that it tells now was."""
        return self.origin_ns + (tick - self.shift) * self.tick_ns

    def samples(self, until_ns: int) -> np.ndarray:
        """True ticks of the samples up to then, (n,)."""
        last = int(np.floor((until_ns - self.origin_ns) / self.tick_ns / self.sample_ticks))
        numbers = np.arange(self.next, last + 1)
        self.next = max(last + 1, self.next)
        return np.rint(numbers * self.sample_ticks).astype(np.int64)

    def tick_of(self, time_ns: float) -> int:
        """The true tick that lasts at ``time_ns``."""
        return int(np.floor((time_ns - self.origin_ns) / self.tick_ns))


class Fleet:
    """An IMU, a node, a QSB, a SYNC producer and a serial IMU without marks."""

    PERIOD_NS: ClassVar = {"imu": 1e6, "node": 5e6, "qsb": 1.953e6, "sync": 5e6, "free": 6.67e6}

    def __init__(
        self, seed: int, first_pulse: int = 0, mishaps: tuple[Mishap, ...] = (), sync_ns: int = SYNC_NS
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.mishaps = mishaps
        errors = self.rng.uniform(-1.0, 1.0, 5)
        self.streams = {
            "imu": Stream(self.rng, 1e6, 1, 0.05 * errors[0]),
            "node": Stream(self.rng, 1e3, 5000, 0.02 * errors[1]),
            "qsb": Stream(self.rng, 1e9 / 512, 1, 0.01 * errors[2]),
            "sync": Stream(self.rng, sync_ns, 1, 0.0),
            "free": Stream(self.rng, 2170.1, 6_667_000 / 2170.1, 1e-4 * errors[4]),
        }
        self.start_ns = 50_000_000_000
        for stream in self.streams.values():
            stream.origin_ns += self.start_ns
        numbers = np.arange(first_pulse, first_pulse + 400)
        sync = code.sync_numbers()[numbers % code.CODE_LENGTH] + numbers // code.CODE_LENGTH * code.cycle_sync_periods()
        self.first_sync = int(sync[0])
        dither = code.dither_ns()[numbers % code.CODE_LENGTH]
        self.edges = self.start_ns + 20_000_000 + (sync - sync[0]) * sync_ns + dither
        self.streams["sync"].origin_ns = self.start_ns + 20_000_000 - 4 * sync_ns
        self.channels: dict[str, timebase.ChannelClock] = {
            "imu": timebase.SampledChannel(1e6),
            "node": timebase.MarkedChannel(1e3, "node_mark"),
            "qsb": timebase.MarkedChannel(1.925e6, "qsb_mark", latches_counts=True),
            "sync": timebase.ProducerChannel(sync_ns, 110_000.0),
            "free": timebase.FreeChannel(2170.1, 3e6, 1e6),
        }
        self.timebase = timebase.Timebase(self.channels, timebase.SyncLine("pulse", sync_ns))
        self.states: dict[str, ClockState] = {}  # as recorded
        self.newest: dict[str, tuple[int, float]] = {}  # tick told, and when it was
        self._marked = dict.fromkeys(self.streams, -1)
        self._held: dict[str, list[np.ndarray]] = {}

    def run(self, steps: int, judge: "Callable[[Fleet], None]") -> None:
        """Step the timebase, and judge it after each step."""
        for step in range(1, steps + 1):
            now = self.start_ns + step * STEP_NS
            happens = {(m.device, m.what) for m in self.mishaps if m.step == step}
            batches = self._line(now, happens)
            for name, stream in self.streams.items():
                before = self.newest.get(name)
                made = self._device(name, stream, now, happens)
                if (name, "late batch") in happens:
                    self._held.update({c: [*self._held.get(c, []), rows] for c, rows in made.items()})
                    self.newest |= {name: before} if before is not None else {}
                    continue
                for channel, rows in made.items():
                    held = self._held.pop(channel, [])
                    for late in held:
                        late["host_ns"] = now + 400_000
                    batches[channel] = np.concatenate([*held, rows])
            clocks = self.timebase.update(now, {c: rows for c, rows in batches.items() if len(rows)})
            self.states |= {row["channel"].decode(): ClockState(row["state"]) for row in clocks}
            judge(self)

    def _line(self, now: int, happens: set[tuple[str, str]]) -> dict[str, np.ndarray]:
        edges = self.edges[(self.edges >= now - STEP_NS) & (self.edges < now)]
        if any(what == "deaf" for _, what in happens):
            edges = edges[:0]
        stamps = edges + 3000 + self.rng.exponential(2000, len(edges)).astype(np.int64)
        if any(what == "echo" for _, what in happens):
            stamps = np.sort(np.concatenate([stamps, stamps + 40_000]))
        rows = np.zeros(len(stamps), records.PULSE)
        rows["edge_ns"], rows["host_ns"] = stamps, now
        return {"pulse": rows}

    def _device(self, name: str, stream: Stream, now: int, happens: set[tuple[str, str]]) -> dict[str, np.ndarray]:
        told = (name, "told reset") in happens
        ticks = self._ticks(name, stream, now, {what for device, what in happens if device == name})
        first_ns, deaf = now - STEP_NS - 5_000_000, (name, "miss") in happens
        edges = self.edges[
            (self.edges > self._marked[name]) & (self.edges >= first_ns) & (self.edges < now - 3_000_000)
        ]
        if len(edges):
            self._marked[name] = int(edges[-1])
        if deaf:
            edges = edges[:0]
        dtype = {"imu": records.IMU, "sync": records.CAN_SYNC}.get(name, records.SCALAR)
        rows = np.zeros(len(ticks), dtype)
        rows["tick"] = ticks + stream.shift
        taken = stream.origin_ns + ticks * stream.tick_ns
        rows["host_ns"] = now + 400_000 if name in ("imu", "free", "node") else taken + 1_500_000
        if name == "free":
            rows["host_ns"] = np.maximum(taken + 3_300_000 + self.rng.exponential(300_000, len(taken)), 0)
        if name == "sync":
            rows["host_ns"] = taken + 300_000 + self.rng.exponential(50_000, len(taken))
            rows["sync_counter"] = (self.first_sync - 4 + ticks) % 240 + 1
        if told and len(rows) and name not in ("sync",):
            rows["status"][0] = records.SampleStatus.AFTER_RESET
        if len(rows):
            self.newest[name] = (int(rows["tick"][-1]), float(taken[-1]))
        if name == "imu":
            for edge in edges:
                flagged = stream.tick_of(edge) + 1
                for again in range(2 if (name, "twice") in happens else 1):
                    rows["sync"][ticks == flagged + again] = 1
            self._marked[name] = int(taken[-1]) if len(taken) else self._marked[name]
            return {"imu": rows}
        if name == "qsb":
            rows["value_raw"] = np.rint(angle(taken) * COUNTS_PER_RAD)
        made = {name: rows}
        if name in ("node", "qsb"):
            marks = np.zeros(len(edges), MARK)
            marks["tick"] = [max(stream.tick_of(edge) + stream.shift, 0) for edge in edges]
            marks["host_ns"] = now + 400_000
            marks["value_raw"] = np.rint(angle(edges) * COUNTS_PER_RAD) if name == "qsb" else 0
            made[f"{name}_mark"] = np.repeat(marks, 2) if (name, "twice") in happens else marks
        return made

    def _ticks(self, name: str, stream: Stream, now: int, mishaps: set[str]) -> np.ndarray:
        """True ticks of the samples up to ``now`` (n,), after what happens to the ticks that the device tells."""
        ticks = stream.samples(now)
        if mishaps & {"told reset", "reset"} and len(ticks):
            stream.shift = -int(ticks[0])
        if "wrap" in mishaps and len(ticks):
            stream.shift -= min(1 << 16, int(ticks[0]) + stream.shift)
        if "jump" in mishaps:
            stream.shift += round(2.0 * self.PERIOD_NS[name] * 60 / stream.tick_ns)
        if "slip" in mishaps and len(ticks) > 30:
            ticks = ticks[20:]
            if name == "imu":  # the only one whose ticks are the driver's own count
                stream.shift += int(self.rng.choice([-1, 1]))
        return ticks

    def error_ns(self, name: str) -> float:
        """Of the newest sample's time."""
        tick, taken_ns = self.newest[name]
        rows = np.zeros(1, records.SCALAR)
        rows["tick"] = tick
        times = self.timebase.time_ns(name, rows)
        assert times is not None
        return float(times[0]) - taken_ns


def angle(time_ns: np.ndarray) -> np.ndarray:
    """Of the QSB's shaft, rad."""
    s = np.asarray(time_ns, np.float64) * 1e-9
    return 0.4 * s + 0.3 * np.sin(s)
