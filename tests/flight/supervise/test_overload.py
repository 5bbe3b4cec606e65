"""A computer that is too busy: long pauses are worked off in steps, slow is not hung, nothing is lost in silence."""

import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.records import Rows
from onboard import config
from onboard.flight.estimate.estimation import LONGEST_STEP_NS, DurableEstimation
from onboard.flight.estimate.shedding import LATE_NS, SKIP_NS
from onboard.flight.supervise import runner_processes
from onboard.flight.supervise.runner_forks import ForkServer
from onboard.flight.supervise.runner_processes import Worker
from onboard.ground.identify.replay.replay import replay
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from onboard.ring import RingReader
from tests.flight import forked
from tests.flight.missions import Result
from tests.flight.supervise.test_takeover import STEP_NS, Stretch, record


@pytest.fixture(scope="module")
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


@pytest.mark.parametrize("killed", [pytest.param(False, marks=pytest.mark.campaign), True])
def test_a_pause_of_seconds_is_worked_off_in_steps_and_replays_to_the_bit(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path, killed: bool
) -> None:
    stretch = Stretch(mission.log, vehicle, tmp_path / "rings")
    worker = DurableEstimation(vehicle, tmp_path / "rings", stretch.start_ns)
    paused = range(stretch.start_ns + 2_000_000_000, stretch.start_ns + 7_000_000_000)
    last_ns = stretch.start_ns + 9_000_000_000
    for now_ns in range(stretch.start_ns, last_ns, STEP_NS):
        stretch.feed(now_ns)
        if now_ns in paused:
            continue  # it gets no CPU at all
        if killed and now_ns - STEP_NS in paused:
            worker = DurableEstimation(vehicle, tmp_path / "rings", now_ns)
        worker.step(now_ns)
    worker.finish(last_ns)
    log = record(tmp_path / "rings", vehicle, tmp_path / "log.mcap")
    ticks, events = log.read("tick"), log.read("event_estimation")
    assert np.diff(ticks["host_ns"]).max() <= LONGEST_STEP_NS
    assert ticks["host_ns"][-1] == last_ns  # it has caught up
    codes = events["code"].tolist()
    assert codes.count(b"estimator_late") == codes.count(b"estimator_in_time") == 1
    assert b"estimator_overrun" not in codes
    for column, name in enumerate(vehicle.channels):  # each row once, none twice, none left out
        assert int(ticks["consumed"][:, column].sum()) == len(log.read(name))
    assert len(RingReader(tmp_path / "rings" / "row.ring").read()[0]) > 700
    replayed = replay(tmp_path / "log.mcap")
    assert replayed.identical, replayed.summary


def test_what_is_not_worked_off_in_time_at_the_end_is_left_out_and_told(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path
) -> None:
    stretch = Stretch(mission.log, vehicle, tmp_path / "rings")
    worker = DurableEstimation(vehicle, tmp_path / "rings", stretch.start_ns)
    last_ns, chances = stretch.start_ns + 9_000_000_000, iter([False] * 3)
    for now_ns in range(stretch.start_ns, last_ns, STEP_NS):
        stretch.feed(now_ns)
        if now_ns < stretch.start_ns + 2_000_000_000:
            worker.step(now_ns)
    worker.finish(last_ns, lambda: next(chances, True))
    log = record(tmp_path / "rings", vehicle, tmp_path / "log.mcap")
    events, reached_ns = log.read("event_estimation"), int(log.read("tick")["host_ns"][-1])
    [said] = [row["text"].decode() for row in events if row["code"] == b"estimator_unfinished"]
    left_s = 1e-9 * (last_ns - reached_ns)
    assert 9.0 - 2.0 - 3 * 1e-9 * LONGEST_STEP_NS - 0.1 < left_s < 7.0
    assert f"the last {left_s:.1f} s of the flight are not taken in" in said
    assert replay(tmp_path / "log.mcap").identical


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_a_worker_that_works_is_slow_and_one_that_stands_hangs(
    light: ForkServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_processes, "HUNG_S", 1.5)
    monkeypatch.setattr(runner_processes, "LOOK_S", 1.0)
    monkeypatch.setattr(runner_processes, "LONGEST_SILENCE_S", 5.0)
    for body, expected in ((forked.work_long, ["slow", "slow"]), (forked.stand, [])):
        worker = Worker("test", partial(light.fork, body))
        worker.start()
        worker.wait_ready()
        happened: list[str] = []
        deadline = time.monotonic() + 30
        while "hung" not in happened and time.monotonic() < deadline:
            happened += [one] if (one := worker.watch()) else []
            time.sleep(0.02)
        assert happened[: len(expected)] == expected
        assert happened[-1] == "hung"  # in the end whatever says nothing is killed
        assert ("slow" in happened) == bool(expected)
        assert worker.finish() == 0.0


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_at_the_end_a_worker_is_waited_for_while_it_works(light: ForkServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner_processes, "STOP_TIMEOUT_S", 1.0)
    monkeypatch.setattr(runner_processes, "HUNG_S", 1.0)
    monkeypatch.setattr(runner_processes, "LONGEST_SILENCE_S", 4.0)
    waited_s = []
    for body in (forked.work_long, forked.stand):
        worker = Worker("test", partial(light.fork, body))
        worker.start()
        worker.wait_ready()
        waited_s.append(worker.finish())
        assert worker.died
    assert waited_s[0] >= 4.0 > waited_s[1] >= 1.0


def slowed(
    stretch: Stretch, vehicle: config.Vehicle, directory: Path, share: float, last_ns: int, dies_ns: int
) -> LogReader:
    """The log of an estimator that needs 1 / ``share`` seconds for each second of rows; its process dies once."""
    worker, busy_until_ns, reached_ns = DurableEstimation(vehicle, directory, stretch.start_ns), 0, stretch.start_ns
    logged = Growing(directory)
    for now_ns in range(stretch.start_ns, last_ns, STEP_NS):
        stretch.feed(now_ns)
        logged.step()
        if now_ns < busy_until_ns:
            continue
        if now_ns > dies_ns:
            worker, dies_ns = DurableEstimation(vehicle, directory, now_ns), last_ns
        worker.step(now_ns)
        tick = RingReader(directory / "tick.ring").read()[0][-1]
        took_ns = int(tick["host_ns"]) - int(tick["skipped_ns"]) - reached_ns
        reached_ns = int(tick["host_ns"])
        assert now_ns - reached_ns <= SKIP_NS  # so late it answers
        busy_until_ns = now_ns + round(took_ns / share)
    worker.finish(last_ns)
    logged.step()
    return logged.log(vehicle, directory.parent / "log.mcap")


@pytest.mark.parametrize("killed", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_at_a_quarter_of_the_cpu_rows_are_left_out_by_the_rule_and_the_log_replays(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path, killed: bool
) -> None:
    stretch = Stretch(mission.log, vehicle, tmp_path / "rings")
    last_ns = stretch.start_ns + 30_000_000_000
    dies_ns = stretch.start_ns + 15_000_000_000 if killed else last_ns
    log = slowed(stretch, vehicle, tmp_path / "rings", 0.25, last_ns, dies_ns)
    ticks, events = log.read("tick"), log.read("event_estimation")
    assert b"estimator_overrun" not in events["code"].tolist()
    left_out = {
        name: len(log.read(name)) - int(ticks["consumed"][:, n].sum()) for n, name in enumerate(vehicle.channels)
    }
    assert left_out["arm_phase"] == left_out["pulse"] == 0
    assert left_out["imu_base"] > 5000
    skipped_ns = ticks["skipped_ns"][ticks["skipped_ns"] > 0]
    assert skipped_ns.min() > SKIP_NS - LATE_NS  # in few pieces: windows need seconds without a hole
    taken_s = 30.0 - 1e-9 * skipped_ns.sum()
    assert 6.5 < taken_s < 7.5 + 1e-9 * SKIP_NS  # a quarter, and at most what waits at the end
    said = [row["text"].decode() for row in events if row["code"] == b"estimator_skips"]
    if not killed:
        assert int(said[-1].split(";")[1].split()[0]) <= sum(left_out.values())
    assert int(ticks["fresh"].sum()) == 0
    assert len(log.read("row")) > 500
    replayed = replay(tmp_path / "log.mcap")
    assert replayed.identical, replayed.summary


class Growing:
    """Everything that rings ever held."""

    def __init__(self, directory: Path) -> None:
        self._readers = [RingReader(path) for path in sorted(directory.glob("*.ring"))]
        self._rows: dict[str, list[Rows]] = {reader.name: [] for reader in self._readers}

    def step(self) -> None:
        for reader in self._readers:
            rows, lost = reader.read()
            assert lost == 0
            self._rows[reader.name].append(rows)

    def log(self, vehicle: config.Vehicle, path: Path) -> LogReader:
        with LogWriter.create(path, durable=False) as writer:
            writer.attach("vehicle.toml", "application/toml", vehicle.text.encode())
            writer.attach(vehicle.file.vehicle.urdf, "application/xml", vehicle.urdf_path.read_bytes())
            for reader in self._readers:
                writer.register(reader.name, reader.dtype)
                writer.write(reader.name, np.concatenate(self._rows[reader.name]))
        return LogReader(path)
