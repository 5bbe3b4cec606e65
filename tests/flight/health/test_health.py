"""Health of a flight: the status word, what the computer says, and both records from counters of rings and beats."""

import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from drivers import records
from drivers.records import Batch, gap
from onboard import channels, config
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.health.computer import ComputerReader, ProcessReader
from onboard.flight.health.status import MEANINGS, Status, standing, words
from onboard.flight.health.stream import CHANNELS, Beat, HealthMonitor, WorkerState, rates_hz
from onboard.flight.store import rings
from onboard.ring import RingWriter

S = 1_000_000_000
DOCS = Path(__file__).parents[3] / "docs" / "health.md"


def test_every_bit_has_a_meaning_and_stands_in_the_documentation() -> None:
    text = DOCS.read_text(encoding="utf-8")
    assert set(MEANINGS) == set(Status)
    for number, bit in enumerate(Status):
        assert int(bit) == 1 << number
        assert f"| {number} | {words(bit)} | {MEANINGS[bit]} |" in text
    for name in [name for dtype in CHANNELS.values() for name in dtype.names or ()]:
        assert f"`{name}`" in text or name.endswith(("_cpu_percent", "_pss_mb", "_missed")), name


def test_the_word_in_words() -> None:
    assert words(0) == "ok"
    assert words(Status.ROWS_MISSING | Status.HOT) == "rows missing, hot"
    assert words(1 << 30 | 4) == "rows missing, bits 0x40000000"  # of a later version
    assert standing(0, int(Status.HOT)) == "status ok (before: hot)"
    assert standing(int(Status.HOT), int(Status.HOT)) == "status hot"


class _Proc(NamedTuple):
    """A tree like ``/``, of which the test writes what it needs."""

    root: Path

    def write(self, name: str, text: str) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")

    def stat(self, idle: int, busy: int) -> None:
        self.write("proc/stat", f"cpu {busy} 0 0 {idle} 0 0 0 0 0 0\ncpu0 0 0 0 0\n")

    def process(self, pid: int, ticks: int, pss_kb: int) -> None:
        self.write(f"proc/{pid}/stat", f"{pid} (a (b) c) S 1 1 1 0 -1 0 0 0 0 0 {ticks} 0 0 0 20 0 1 0 5 0 0")
        self.write(f"proc/{pid}/smaps_rollup", f"5-7 ---p 00 00:00 0 [rollup]\nRss: 9 kB\nPss: {pss_kb} kB\n")


@pytest.fixture
def proc(tmp_path: Path) -> _Proc:
    made = _Proc(tmp_path / "root")
    made.write("proc/meminfo", "MemTotal:       1000 kB\nMemFree:         10 kB\nMemAvailable:    400 kB\n")
    made.stat(0, 0)
    return made


def test_what_the_computer_does_not_say_is_unknown(tmp_path: Path) -> None:
    now = ComputerReader(tmp_path).read()
    assert math.isnan(now.idle)
    assert math.isnan(now.memory_free)
    assert math.isnan(now.temperature_deg_c)
    assert now.throttled == -1


def test_temperature_throttling_memory_and_idle_time(proc: _Proc) -> None:
    proc.write("sys/class/thermal/thermal_zone0/temp", "48312\n")
    proc.write("sys/class/thermal/thermal_zone1/temp", "-3000\n")
    proc.write("sys/class/thermal/thermal_zone2/temp", "none")  # a sensor that is off
    proc.write("sys/devices/platform/soc/soc:firmware/get_throttled", "50005\n")
    reader = ComputerReader(proc.root)
    reader.read()
    proc.stat(idle=75, busy=25)
    now = reader.read()
    assert now.idle == 0.75
    assert now.memory_free == 0.4
    assert now.temperature_deg_c == 48.312
    assert now.throttled == 0x50005
    proc.write("sys/devices/platform/soc/soc:firmware/get_throttled", "garbage")
    assert reader.read().throttled == -1


def test_a_cpu_that_counts_its_throttling(proc: _Proc) -> None:
    count = "sys/devices/system/cpu/cpu1/thermal_throttle/core_throttle_count"
    proc.write(count, "7")
    reader = ComputerReader(proc.root)
    assert reader.read().throttled == 0
    proc.write(count, "8")
    assert reader.read().throttled == 4
    assert reader.read().throttled == 0


def test_processes_are_measured_one_at_a_time(proc: _Proc) -> None:
    reader = ProcessReader(proc.root / "proc")
    for pid in (5, 6):
        proc.process(pid, ticks=100, pss_kb=1000 * pid)
    assert math.isnan(reader.cpu_s(5))
    proc.process(5, ticks=150, pss_kb=9000)
    assert reader.cpu_s(5) == pytest.approx(50 / os.sysconf("SC_CLK_TCK"))
    reader.look_at_next([5, 6])
    assert [math.isnan(reader.pss_mb(pid)) for pid in (5, 6)] == [False, True]
    reader.look_at_next([5, 6])
    assert reader.pss_mb(6) == pytest.approx(6.144)
    proc.process(5, ticks=150, pss_kb=10_000)
    reader.look_at_next([5, 6])  # the one measured longest ago
    assert reader.pss_mb(5) == pytest.approx(10.24)
    reader.look_at_next([6])
    assert math.isnan(reader.pss_mb(5))
    assert math.isnan(reader.cpu_s(7))


class _Flight:
    """Rings, and a monitor of them."""

    def __init__(self, directory: Path, proc: _Proc) -> None:
        self.vehicle = config.load(config.packaged("rocksat"))
        made = rings.create(directory, self.vehicle, rings.device_channels(self.vehicle))
        self.devices, self.directory, self._proc = Publisher(made), directory, proc
        computer, processes = ComputerReader(proc.root), ProcessReader(proc.root / "proc")
        self.monitor = HealthMonitor(self.vehicle, directory, 1, 0, computer, processes)
        self._sequence, self._now_s = 0, 0
        self.beats = dict.fromkeys(("acquisition", "estimation", "recording"), Beat())
        self.restarts = 0

    def push(self, **counts: int) -> None:
        for channel, count in counts.items():
            self.devices.publish([Batch(channel, np.zeros(count, self.vehicle.channels[channel]))])

    def second(self, *, idle: int = 50, answers: bool = True) -> tuple[np.void, records.Rows]:
        self._now_s += 1
        self._proc.stat(idle=idle * self._now_s, busy=(100 - idle) * self._now_s)
        workers = [WorkerState(name, None, answers, self.restarts, beat) for name, beat in self.beats.items()]
        made = self.monitor.step(self._now_s * S, workers)
        assert [batch.channel for batch in made] == list(CHANNELS)
        assert [batch.rows.dtype for batch in made] == list(CHANNELS.values())
        assert self.monitor.step(self._now_s * S + S // 2, workers) == []
        return made[0].rows[0], made[1].rows


FULL = {"imu_base": 1000, "can_sync": 200, "joint_1": 200, "load_cell": 200, "pulse": 4}


@pytest.fixture
def flight(tmp_path: Path, proc: _Proc) -> _Flight:
    return _Flight(tmp_path / "rings", proc)


def test_a_healthy_second_sets_no_bit(flight: _Flight) -> None:
    flight.beats["recording"] = Beat(backlog={"imu_base": 50}, disk_free=5_000_000)
    flight.push(**FULL)
    assert math.isnan(flight.second()[0]["slowest_percent"])  # the first second with rows is not a whole one
    flight.push(**FULL)
    row, streams = flight.second()
    assert (row["status_word"], row["status_latched"], flight.monitor.said) == (0, 0, "status ok")
    assert (row["rows"], row["rows_hz"], row["slowest_percent"]) == (3208, 1604.0, 100.0)
    assert (row["disk_free_mb"], row["throttled"]) == (5.0, -1)
    assert row["recorder_backlog_percent"] == pytest.approx(100 * 50 / 12_000)
    [imu] = streams[streams["channel"] == b"imu_base"]
    assert (imu["rate_hz"], imu["nominal_hz"], imu["rows"], imu["unrecorded"]) == (1000.0, 1000.0, 2000, 50)
    assert streams["sequence"].tolist() == list(range(len(streams), 2 * len(streams)))
    assert rates_hz(flight.vehicle) == {"health": 1.0, "health_stream": len(streams)}


def test_a_stream_that_slows_then_falls_silent_and_comes_back(flight: _Flight) -> None:
    said = []
    for count in (1000, 800, 0, 0, 1000):
        flight.push(**{**FULL, "imu_base": count})
        row, _ = flight.second()
        said.append(words(row["status_word"]))
    assert said == ["ok", "stream slow", "stream silent", "stream silent", "ok"]
    assert flight.monitor.said == "status ok (before: stream silent, stream slow)"


def test_a_device_is_given_time_to_be_set_up(flight: _Flight) -> None:
    others = {name: count for name, count in FULL.items() if name != "imu_base"}
    said = []
    for _ in range(7):
        flight.push(**others)
        said.append(words(flight.second()[0]["status_word"]))
    assert said == ["ok"] * 5 + ["stream silent"] * 2


@pytest.mark.parametrize(
    ("worker", "beat", "bit"),
    [
        ("recording", Beat(backlog={"imu_base": 7000}), Status.RECORDER_BEHIND),
        ("recording", Beat(lost=3), Status.ROWS_NOT_RECORDED),
        ("recording", Beat(status=Status.DISK_LOW), Status.DISK_LOW),
        ("estimation", Beat(missed=2), Status.TICKS_MISSED),
        ("acquisition", Beat(status=Status.NOT_REALTIME), Status.NOT_REALTIME),
    ],
)
def test_what_a_worker_says(flight: _Flight, worker: str, beat: Beat, bit: Status) -> None:
    flight.beats[worker] = beat
    flight.push(**FULL)
    row, _ = flight.second()
    assert Status(int(row["status_word"])) == bit
    flight.beats[worker] = beat._replace(status=Status(0), backlog=None)
    flight.push(**FULL)
    row, _ = flight.second()
    assert row["status_word"] == 0  # counts that stay are no news
    assert Status(int(row["status_latched"])) == bit


def test_rows_that_a_recorder_lost_add_up_over_its_restarts(flight: _Flight) -> None:
    for lost in (5, 8, 2, 2):
        flight.beats["recording"] = Beat(lost=lost)
        row, _ = flight.second()
    assert row["not_recorded"] == 10


def test_gaps_clocks_and_the_estimator(flight: _Flight) -> None:
    clock = RingWriter(flight.directory / "clock.ring", channels.CLOCK, 50)
    tick = RingWriter(flight.directory / "tick.ring", channels.tick_dtype(3), 50)
    made = RingWriter(flight.directory / "row.ring", channels.row_dtype(1, 1), 50)
    flight.devices.publish([gap(1, "joint_1", 5, 14, 100, "bus")])
    states = np.zeros(4, channels.CLOCK)
    states["channel"], states["state"] = [b"imu_base", b"can_sync", b"imu_base", b"x"], [0, 3, 2, 1]
    clock.push(states)
    step, row_ = np.zeros(2, tick.dtype), np.zeros(1, made.dtype)
    step["host_ns"], step["skipped_ns"], row_["vehicle_ns"] = [S // 10, S // 5], [0, S // 2], S // 2
    tick.push(step)
    made.push(row_)
    flight.push(**FULL)
    flight.second()
    row, streams = flight.second()
    assert (row["gaps"], row["missing"], row["estimator_skipped_s"]) == (1, 10, 0.5)
    assert row["estimator_lag_s"] == pytest.approx(1.8)
    assert row["row_age_s"] == pytest.approx(1.5)
    assert [int(row[f"clocks_{state}"]) for state in ("acquiring", "locked", "flywheel", "invalid")] == [0, 1, 1, 1]
    now, latched = Status(int(row["status_word"])), Status(int(row["status_latched"]))
    assert now & (Status.ESTIMATOR_LATE | Status.CLOCK_FLYWHEEL | Status.CLOCK_INVALID)
    assert not now & (Status.ROWS_MISSING | Status.ESTIMATOR_SKIPS)
    assert Status.ROWS_MISSING in latched
    assert Status.ESTIMATOR_SKIPS in latched
    of = {stream["channel"]: stream for stream in streams}
    assert (of[b"joint_1"]["gaps"], of[b"joint_1"]["missing"]) == (1, 10)
    assert (of[b"imu_base"]["clock_state"], of[b"joint_1"]["clock_state"]) == (2, 255)


def test_counts_beyond_a_field_stay_at_its_largest(flight: _Flight) -> None:
    flight.beats["recording"] = Beat(backlog={"imu_base": 1 << 40})
    for channel in ("joint_1", "load_cell", "load_cell"):
        flight.devices.publish([gap(1, channel, 0, (1 << 64) - 2, 100, "bus")])
    row, streams = flight.second()
    assert (row["gaps"], row["missing"]) == (3, (1 << 64) - 1)
    assert streams["unrecorded"].max() == (1 << 31) - 1


def test_a_worker_that_is_down_and_a_busy_computer(flight: _Flight) -> None:
    flight.push(**FULL)
    flight.second()
    flight.push(**FULL)
    row, _ = flight.second(answers=False)
    assert Status(int(row["status_word"])) == Status.WORKER_DOWN
    flight.restarts = 1
    flight.push(**FULL)
    row, _ = flight.second(idle=0)
    assert Status(int(row["status_word"])) == Status.WORKER_DOWN | Status.CPU_BUSY
    assert row["restarts"] == 3
