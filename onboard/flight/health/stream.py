"""Health of a real flight: a HEALTH record a second, and one of HEALTH_STREAM for each device channel.

The supervisor makes them from counters of the rings, from what the workers say with their beats, and from what the
computer says of itself. A flight on a virtual clock has neither workers nor a computer of its own, so it has no such
record, and its log stays the same to the byte. The estimator does not read them: a replay is not touched.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import Batch, Rows
from onboard import config
from onboard.channels import HEALTH, HEALTH_STREAM
from onboard.flight.acquire.expected import expected
from onboard.flight.health.computer import CAPPED, SOFT_LIMIT, THROTTLED, UNDERVOLTAGE, ComputerReader, ProcessReader
from onboard.flight.health.status import (
    BACKLOG,
    HOT_DEG_C,
    LATE_S,
    LITTLE_IDLE,
    LITTLE_MEMORY,
    SILENT_S,
    SLOW,
    Status,
    standing,
)
from onboard.ring import RingError, RingReader

CHANNELS = {"health": HEALTH, "health_stream": HEALTH_STREAM}
PERIOD_NS = 1_000_000_000
NO_CLOCK = 255
_STATES = ("acquiring", "locked", "flywheel", "invalid")  # ClockState
_MOST = (1 << 64) - 1
_FEWEST = 10.0  # rows that must be due in a second for a rate to be judged: pulses come at uneven intervals
_PERIODS = 5.0  # without a row a channel is silent, and a second at the least


class Beat(NamedTuple):
    """What a worker says to the supervisor once a second.

    Attributes:
        missed: ticks that came while the step before still ran, since the worker's start.
        status: bits that it knows of.
        backlog: the recorder's: rows in each ring that are not in the log.
        lost: the recorder's: rows that it could not record, since its start.
        disk_free: the recorder's: bytes; -1 where unknown.
    """

    missed: int = 0
    status: Status = Status(0)
    backlog: Mapping[str, int] | None = None
    lost: int = 0
    disk_free: int = -1


class WorkerState(NamedTuple):
    """A worker as its supervisor knows it; ``restarts`` since the start of the flight."""

    name: str
    pid: int | None
    answers: bool
    restarts: int
    beat: Beat


class _Stream(NamedTuple):
    channel: str
    nominal_hz: float
    reader: RingReader
    expected_ns: int  # after the start: no row is missed before


def rates_hz(vehicle: config.Vehicle) -> dict[str, float]:
    """How often rows of the channels of health come."""
    return {"health": 1.0, "health_stream": float(len(vehicle.channels))}


class HealthMonitor:
    """Makes the records.

    Args:
        vehicle: what flies.
        directory: of its rings, those of the device channels made.
        pid: of the supervisor.
        now_ns: time of the call.
        computer: says how the computer stands.
        processes: says how processes stand.
    """

    def __init__(
        self,
        vehicle: config.Vehicle,
        directory: Path,
        pid: int,
        now_ns: int,
        computer: ComputerReader | None = None,
        processes: ProcessReader | None = None,
    ) -> None:
        self._directory, self._pid = directory, pid
        self._computer, self._processes = computer or ComputerReader(), processes or ProcessReader()
        self._looked_ns = now_ns
        self._streams = _streams(vehicle, directory)
        self._came = dict.fromkeys((stream.channel for stream in self._streams), 0)
        self._came_ns = {stream.channel: now_ns + stream.expected_ns for stream in self._streams}
        self._readers: dict[str, RingReader] = {}
        self._gaps: dict[str, tuple[int, int]] = {}
        self._clocks: dict[str, int] = {}
        self._skipped_ns = self._taken_in_ns = self._row_ns = 0
        self._missed: dict[str, int] = {}
        self._lost = self._lost_before = 0
        self._restarts = 0
        self._made = 0
        self._latched = Status(0)
        self.said = ""  # the status in words

    def step(self, now_ns: int, workers: Sequence[WorkerState]) -> list[Batch]:
        """The records of the last second, if it is over."""
        if now_ns - self._looked_ns < PERIOD_NS:
            return []
        passed_s, self._looked_ns = 1e-9 * (now_ns - self._looked_ns), now_ns
        row = np.zeros(1, HEALTH)
        beats = {worker.name: worker.beat for worker in workers}
        recorder = beats.get("recording", Beat())
        word = self._take_in_rings() | self._of_workers(workers, row)
        streams, of_streams = self._of_streams(now_ns, passed_s, recorder.backlog or {}, row)
        word |= of_streams | self._of_estimator(now_ns, row) | self._of_recorder(recorder, row)
        word |= self._of_computer(workers, passed_s, row)
        self._latched |= word
        row["host_ns"], row["sequence"], row["status_word"] = now_ns, self._made, int(word)
        row["status_latched"] = int(self._latched)
        streams["host_ns"], streams["sequence"] = now_ns, self._made * len(streams) + np.arange(len(streams))
        self._made += 1
        self.said = standing(word, self._latched)
        return [Batch("health", row), Batch("health_stream", streams)]

    def _take_in_rings(self) -> Status:
        """Gap records, clocks, steps and rows since the last look."""
        word = Status(0)
        for row in self._read("gap"):
            channel = row["channel"].decode(errors="replace")
            gaps, missing = self._gaps.get(channel, (0, 0))
            count = int(row["last_missing"]) - int(row["first_missing"]) + 1
            self._gaps[channel] = gaps + 1, min(_MOST, missing + max(0, count))  # a damaged counter may say anything
            word |= Status.ROWS_MISSING
        clocks = self._read("clock")
        for channel, index in zip(*np.unique(clocks["channel"][::-1], return_index=True), strict=True):
            self._clocks[channel.decode(errors="replace")] = int(clocks["state"][::-1][index])
        ticks, rows = self._read("tick"), self._read("row")
        if len(ticks):
            self._taken_in_ns = int(ticks["host_ns"][-1])
            skipped_ns = int(ticks["skipped_ns"].sum())
            self._skipped_ns += skipped_ns
            word |= Status.ESTIMATOR_SKIPS if skipped_ns else Status(0)
        if len(rows):
            self._row_ns = int(rows["vehicle_ns"].max())
        return word

    def _of_streams(self, now_ns: int, passed_s: float, backlog: Mapping[str, int], row: Rows) -> tuple[Rows, Status]:
        word, slowest = Status(0), math.nan
        made = np.zeros(len(self._streams), HEALTH_STREAM)
        for into, (channel, nominal_hz, reader, _) in zip(made, self._streams, strict=True):
            rows = reader.published
            came, self._came[channel] = rows - self._came[channel], rows
            gaps, missing = self._gaps.get(channel, (0, 0))
            due = nominal_hz * passed_s
            if came:
                self._came_ns[channel] = now_ns
            elif nominal_hz and now_ns - self._came_ns[channel] >= max(1e9, _PERIODS * 1e9 / nominal_hz):
                word |= Status.STREAM_SILENT
            if due >= _FEWEST and rows > came:
                slowest = min(slowest, came / due) if not math.isnan(slowest) else came / due
                if 0 < came < SLOW * due:
                    word |= Status.STREAM_SLOW
            into["rate_hz"], into["nominal_hz"], into["rows"] = came / passed_s, nominal_hz, rows
            into["gaps"], into["missing"], into["capacity"] = gaps, missing, reader.capacity
            into["unrecorded"] = min(backlog.get(channel, -1), np.iinfo(np.int32).max)
            into["clock_state"], into["channel"] = self._clocks.get(channel, NO_CLOCK), channel.encode()
            if backlog.get(channel, 0) > BACKLOG * reader.capacity:
                word |= Status.RECORDER_BEHIND
        row["rows"], row["rows_hz"], row["slowest_percent"] = made["rows"].sum(), made["rate_hz"].sum(), 100 * slowest
        row["gaps"] = sum(gaps for gaps, _ in self._gaps.values())
        row["missing"] = min(_MOST, sum(missing for _, missing in self._gaps.values()))
        known = made["unrecorded"] >= 0
        filled = made["unrecorded"][known] / made["capacity"][known]
        row["recorder_backlog_percent"] = 100 * filled.max(initial=0.0) if known.any() else math.nan
        states = list(self._clocks.values())
        for number, state in enumerate(_STATES):
            row[f"clocks_{state}"] = min(255, states.count(number))
        word |= Status.CLOCK_FLYWHEEL if row["clocks_flywheel"][0] else Status(0)
        return made, word | (Status.CLOCK_INVALID if row["clocks_invalid"][0] else Status(0))

    def _of_estimator(self, now_ns: int, row: Rows) -> Status:
        lag_s = 1e-9 * (now_ns - self._taken_in_ns) if self._taken_in_ns else math.nan
        row["estimator_lag_s"] = lag_s
        row["row_age_s"] = 1e-9 * (now_ns - self._row_ns) if self._row_ns else math.nan
        row["estimator_skipped_s"] = 1e-9 * self._skipped_ns
        return Status.ESTIMATOR_LATE if lag_s > LATE_S else Status(0)

    def _of_recorder(self, beat: Beat, row: Rows) -> Status:
        """Rows that it lost are counted over its restarts."""
        new = beat.lost - self._lost_before if beat.lost >= self._lost_before else beat.lost
        self._lost_before, self._lost = beat.lost, self._lost + new
        row["not_recorded"] = self._lost
        row["disk_free_mb"] = 1e-6 * beat.disk_free if beat.disk_free >= 0 else math.nan
        return Status.ROWS_NOT_RECORDED if new else Status(0)

    def _of_workers(self, workers: Sequence[WorkerState], row: Rows) -> Status:
        word = Status(0)
        for worker in workers:
            word |= worker.beat.status
            row[f"{worker.name}_missed"] = worker.beat.missed
            if worker.beat.missed > self._missed.get(worker.name, 0):
                word |= Status.TICKS_MISSED
            self._missed[worker.name] = worker.beat.missed
            if not worker.answers:
                word |= Status.WORKER_DOWN
        restarts = sum(worker.restarts for worker in workers)
        if restarts > self._restarts:
            word |= Status.WORKER_DOWN
        self._restarts = restarts
        row["restarts"] = restarts
        return word

    def _of_computer(self, workers: Sequence[WorkerState], passed_s: float, row: Rows) -> Status:
        own = {worker.name: [worker.pid] for worker in workers if worker.pid is not None}
        named = {pid for pids in own.values() for pid in pids}
        of = {**own, "supervisor": [self._pid]}
        of["others"] = [pid for pid in self._processes.children(self._pid) if pid not in named]
        self._processes.look_at_next([pid for pids in of.values() for pid in pids])
        for name in ("supervisor", "acquisition", "estimation", "recording", "others"):
            pids = of.get(name, [])
            cpu_s = [self._processes.cpu_s(pid) for pid in pids]
            row[f"{name}_cpu_percent"] = 100 * _sum(cpu_s) / passed_s
            row[f"{name}_pss_mb"] = _sum([self._processes.pss_mb(pid) for pid in pids])
        now = self._computer.read()
        row["computer_idle_percent"], row["memory_free_mb"] = 100 * now.idle, now.memory_free_mb
        row["temperature_deg_c"], row["throttled"] = now.temperature_deg_c, now.throttled
        slowed = 0 if now.throttled < 0 else now.throttled
        bits = {
            Status.MEMORY_LOW: now.memory_free < LITTLE_MEMORY,
            Status.CPU_BUSY: now.idle < LITTLE_IDLE,
            Status.HOT: now.temperature_deg_c >= HOT_DEG_C,
            Status.THROTTLED: bool(slowed & (CAPPED | THROTTLED | SOFT_LIMIT)),
            Status.UNDERVOLTAGE: bool(slowed & UNDERVOLTAGE),
        }
        return Status(sum(bit for bit, stands in bits.items() if stands))

    def _read(self, name: str) -> Rows:
        """New rows of a ring, none of one that is not there; those that were overwritten are in the log."""
        if name not in self._readers:
            try:
                self._readers[name] = RingReader(self._directory / f"{name}.ring")
            except (OSError, RingError, ValueError):
                return np.zeros(0, _NOTHING)
        return self._readers[name].read()[0]


_NOTHING = np.dtype(
    [("channel", "S31"), ("state", "u1"), ("host_ns", "<i8"), ("skipped_ns", "<i8"), ("vehicle_ns", "<i8")]
)


def _sum(values: list[float]) -> float:
    """Of those that are known; NaN where none is."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) if known else math.nan


def _streams(vehicle: config.Vehicle, directory: Path) -> list[_Stream]:
    within_ns = round(SILENT_S * 1e9)
    return [
        _Stream(
            channel,
            1e9 / one.period_ns if one.period_ns else 0.0,
            RingReader(directory / f"{channel}.ring"),
            max(within_ns, one.within_ns),
        )
        for bus in vehicle.buses
        for channel, one in expected(vehicle, bus).items()
    ]
