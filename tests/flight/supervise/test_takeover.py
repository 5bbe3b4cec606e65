"""Workers that take over from one that died: the estimator to the bit, acquisition with its numbers."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers import records
from drivers.records import Batch, Rows, SampleStatus, event, gap
from onboard import config
from onboard.flight.acquire.publisher import ExpectedChannel, Publisher
from onboard.flight.estimate import estimation
from onboard.flight.estimate.checkpoint import Checkpoint, Checkpoints
from onboard.flight.estimate.estimation import CHECKPOINT_CPU_NS, CHECKPOINT_NS, DurableEstimation
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store import rings
from onboard.ground.identify.replay.replay import replay
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from onboard.ring import RingReader, RingWriter
from tests.flight.missions import Result

STEP_NS = 50_000_000
SECONDS = 8.0


class KilledError(Exception):
    """What stands for SIGKILL: nothing runs after it."""


class Mortal(Publisher):
    """A publisher whose process is killed before it has published so many batches."""

    left: int | None = None
    armed: ClassVar[bool] = True

    def publish(self, batches: Iterator[Batch] | list[Batch]) -> None:  # type: ignore[override]
        for batch in batches:
            if self.armed and self.left is not None:
                if not self.left:
                    raise KilledError
                self.left -= 1
            super().publish([batch])


@pytest.fixture(scope="module")
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


class Stretch:
    """A stretch of the mission, fed to rings step by step as acquisition did."""

    def __init__(self, log: LogReader, vehicle: config.Vehicle, directory: Path, after_s: float = 18.0) -> None:
        self._rows = {name: log.read(name) for name in vehicle.channels}
        self._rings = rings.create(directory, vehicle, rings.device_channels(vehicle))
        self.start_ns = min(int(rows["host_ns"][0]) for rows in self._rows.values()) + round(1e9 * after_s)
        self.end_ns = max(int(rows["host_ns"][-1]) for rows in self._rows.values())
        for name, rows in self._rows.items():
            self._rows[name] = rows[rows["host_ns"] >= self.start_ns - 200_000_000]

    def feed(self, now_ns: int) -> None:
        for name, rows in self._rows.items():
            due = int(np.searchsorted(rows["host_ns"], now_ns, side="right"))
            self._rings[name].push(rows[:due])
            self._rows[name] = rows[due:]


def fly_with_kills(
    mission: Result, vehicle: config.Vehicle, directory: Path, rng: np.random.Generator, *, while_taking_over: bool
) -> int:
    """The estimator over a stretch of the mission, killed between any two things that it publishes; how often."""
    stretch = Stretch(mission.log, vehicle, directory)
    Mortal.left, Mortal.armed = None, True
    worker: DurableEstimation | None = None
    kills = 0
    for now_ns in range(stretch.start_ns, stretch.start_ns + int(SECONDS * 1e9), STEP_NS):
        stretch.feed(now_ns)
        try:
            if worker is None:
                if rng.integers(3):
                    continue  # it takes a while to be started again
                Mortal.left = int(rng.integers(0, 60)) if while_taking_over and rng.integers(2) else None
                worker = DurableEstimation(vehicle, directory, now_ns)
            Mortal.left = int(rng.integers(0, 25))
            worker.step(now_ns)
        except KilledError:
            worker, kills = None, kills + 1
    Mortal.left, Mortal.armed = None, False
    (worker or DurableEstimation(vehicle, directory, now_ns)).finish(now_ns)
    return kills


def record(directory: Path, vehicle: config.Vehicle, log: Path) -> LogReader:
    """What the rings hold, as a log."""
    with LogWriter.create(log, durable=False) as writer:
        writer.attach("vehicle.toml", "application/toml", vehicle.text.encode())
        writer.attach(vehicle.file.vehicle.urdf, "application/xml", vehicle.urdf_path.read_bytes())
        for path in sorted(directory.glob("*.ring")):
            reader = RingReader(path)
            writer.register(reader.name, reader.dtype)
            rows, lost = reader.read()
            assert lost == 0
            writer.write(reader.name, rows)
    return LogReader(log)


@pytest.mark.parametrize("while_taking_over", [pytest.param(False, marks=pytest.mark.campaign), True])
def test_an_estimator_killed_at_random_is_replayed_to_the_bit(
    mission: Result,
    vehicle: config.Vehicle,
    tmp_path: Path,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    while_taking_over: bool,
) -> None:
    monkeypatch.setattr(estimation, "Publisher", Mortal)
    kills = fly_with_kills(mission, vehicle, tmp_path / "rings", rng, while_taking_over=while_taking_over)
    log = record(tmp_path / "rings", vehicle, tmp_path / "log.mcap")
    assert kills > 10
    for name in ("tick", "clock", "row", "estimate", "quantity", "event_estimation"):
        assert log.read(name)["sequence"].tolist() == list(range(len(log.read(name)))), name
    ticks, events = log.read("tick"), log.read("event_estimation")
    consumed = {name: int(ticks["consumed"][:, n].sum()) for n, name in enumerate(vehicle.channels)}
    assert consumed == {name: len(log.read(name)) for name in vehicle.channels}  # each row once
    said = [(row["host_ns"], row["code"], row["text"]) for row in events]
    assert len(set(said)) == len(said)
    assert int(ticks["fresh"].sum()) == (events["code"] == b"estimator_anew").sum()
    assert bool(ticks["fresh"].any()) == while_taking_over
    assert len(log.read("row")) > 300
    replayed = replay(tmp_path / "log.mcap")
    assert replayed.identical, replayed.summary


def test_an_estimator_killed_again_while_it_repeats_steps_goes_on_from_where_it_was(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = tmp_path / "rings"
    stretch = Stretch(mission.log, vehicle, directory)
    now_ns = stretch.start_ns
    worker = DurableEstimation(vehicle, directory, now_ns)
    assert 19 * STEP_NS < CHECKPOINT_NS  # the only checkpoint is that of the start
    for _ in range(19):
        now_ns += STEP_NS
        stretch.feed(now_ns)
        worker.step(now_ns)
    process, repeated, cost_ns = Estimator.process, [0], [0]

    def mortal(self: Estimator, *given: Any) -> list[Batch]:
        if repeated[-1] == 5:
            raise KilledError
        repeated[-1] += 1
        cost_ns[0] += CHECKPOINT_CPU_NS + 1  # each step is a costly one
        return process(self, *given)

    monkeypatch.setattr(Estimator, "process", mortal)
    while repeated[-1] in (0, 5) and len(repeated) < 10:
        repeated.append(0)
        with contextlib.suppress(KilledError):
            DurableEstimation(vehicle, directory, now_ns, cpu_ns=lambda: cost_ns[0])
    assert repeated[1:] == [5, 5, 5, 4]
    assert not pushed(directory, "tick")["fresh"].any()
    assert b"estimator_anew" not in pushed(directory, "event_estimation")["code"].tolist()


def test_checkpoints_take_a_tenth_of_the_time_that_steps_take(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stretch = Stretch(mission.log, vehicle, tmp_path / "rings")
    now_ns, cost_ns, saved, steps = stretch.start_ns, [0], [0], 19
    process = Estimator.process

    def step(self: Estimator, *given: Any) -> list[Batch]:
        cost_ns[0] += CHECKPOINT_CPU_NS
        return process(self, *given)

    def save(_: Checkpoints, __: Checkpoint) -> None:
        cost_ns[0] += CHECKPOINT_CPU_NS // 2
        saved[0] += 1

    monkeypatch.setattr(Estimator, "process", step)
    monkeypatch.setattr(Checkpoints, "save", save)
    worker = DurableEstimation(vehicle, tmp_path / "rings", now_ns, cpu_ns=lambda: cost_ns[0])
    for _ in range(steps):
        now_ns += STEP_NS
        stretch.feed(now_ns)
        worker.step(now_ns)
    assert saved[0] == 1 + (steps - 1) // 6  # the first is that of the start; more than five steps cost ten times one


def pushed(directory: Path, name: str) -> Rows:
    return RingReader(directory / f"{name}.ring").read()[0]


def scalars(first: int, count: int, host_ns: int) -> Rows:
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = rows["tick"] = range(first, first + count)
    rows["host_ns"] = host_ns + np.arange(count) * 2_000_000
    return rows


def test_acquisition_that_is_started_again_goes_on_with_the_numbers(tmp_path: Path) -> None:
    def rings_of() -> dict[str, RingWriter]:
        kinds = {"joint": records.SCALAR, "pulse": records.PULSE, "event": records.EVENT, "gap": records.GAP}
        return {name: RingWriter(tmp_path / f"{name}.ring", dtype, 500) for name, dtype in kinds.items()}

    first = Publisher(rings_of(), renumber=True)
    first.publish([Batch("joint", scalars(0, 100, 0)), event(5, 0, "a", "b", "c")])
    second = Publisher(rings_of(), renumber=True)
    back_ns = 99 * 2_000_000 + 80 * 2_000_000  # 79 samples were not taken
    second.publish([Batch("joint", scalars(0, 10, back_ns)), event(6, 0, "a", "b", "c")])
    second.publish([gap(back_ns + 30_000_000, "joint", 10, 14, 10_000_000, "bus"), Batch("joint", scalars(15, 5, 0))])
    joint = pushed(tmp_path, "joint")
    assert joint["sequence"].tolist() == [*range(100), *range(179, 189), *range(194, 199)]
    assert joint["tick"].tolist() == [*range(100), *range(10), *range(15, 20)]
    assert np.flatnonzero(joint["status"] & SampleStatus.AFTER_RESET).tolist() == [100]
    gaps = pushed(tmp_path, "gap")
    assert [(int(g["first_missing"]), int(g["last_missing"]), g["cause"]) for g in gaps] == [
        (100, 178, b"worker_restart"),
        (189, 193, b"bus"),
    ]
    assert gaps["duration_ns"][0] == 80 * 2_000_000
    assert pushed(tmp_path, "event")["sequence"].tolist() == [0, 1]


def test_a_device_that_begins_with_a_gap_is_numbered_on_too(tmp_path: Path) -> None:
    kinds = {"joint": records.SCALAR, "gap": records.GAP}
    writers = {name: RingWriter(tmp_path / f"{name}.ring", dtype, 500) for name, dtype in kinds.items()}
    Publisher(writers, renumber=True).publish([Batch("joint", scalars(0, 50, 0))])
    second = Publisher(writers, renumber=True)
    second.publish([gap(49 * 2_000_000 + 2_000_000, "joint", 0, 4, 10_000_000, "bus")])
    second.publish([Batch("joint", scalars(5, 3, 60 * 2_000_000))])
    assert [(int(g["first_missing"]), int(g["last_missing"])) for g in pushed(tmp_path, "gap")] == [(50, 54)]
    assert pushed(tmp_path, "joint")["sequence"].tolist() == [*range(50), 55, 56, 57]


@pytest.mark.parametrize(("value", "lost"), [(4, 0), (5, 1)])
def test_a_channel_that_tells_changes_lost_one_at_least_if_its_value_is_another(
    tmp_path: Path, value: int, lost: int
) -> None:
    kinds = {"phase": records.SCALAR, "gap": records.GAP}
    writers = {name: RingWriter(tmp_path / f"{name}.ring", dtype, 500) for name, dtype in kinds.items()}
    before, after = scalars(0, 20, 0), scalars(0, 2, 90_000_000_000)
    before["value_raw"], after["value_raw"] = 4, value
    Publisher(writers, renumber=True).publish([Batch("phase", before)])
    Publisher(writers, renumber=True, changes=["phase"]).publish([Batch("phase", after)])
    assert pushed(tmp_path, "phase")["sequence"].tolist() == [*range(20), 20 + lost, 21 + lost]
    assert [(g["cause"], g["counted"]) for g in pushed(tmp_path, "gap")] == [(b"worker_restart", 0)] * lost


def test_changes_before_a_bus_is_there_are_a_gap_of_at_least_one(tmp_path: Path) -> None:
    kinds = {"phase": records.SCALAR, "door": records.SCALAR, "lamp": records.SCALAR, "gap": records.GAP}
    writers = {name: RingWriter(tmp_path / f"{name}.ring", dtype, 500) for name, dtype in kinds.items()}
    publisher = Publisher(writers, renumber=True, changes=["phase", "door", "lamp"])
    expected = {"phase": ExpectedChannel(0.0, 0, unheard=True), "door": ExpectedChannel(0.0, 0, unheard=True)}
    publisher.expect({**expected, "lamp": ExpectedChannel(0.0, 0)}, 1_000_000_000)
    publisher.publish([Batch(name, scalars(0, 2, 9_000_000_000)) for name in ("phase", "lamp")])
    publisher.finish(20_000_000_000)
    assert pushed(tmp_path, "phase")["sequence"].tolist() == [1, 2]
    assert pushed(tmp_path, "lamp")["sequence"].tolist() == [0, 1]
    gaps = [(g["channel"], g["cause"], int(g["duration_ns"]), g["counted"]) for g in pushed(tmp_path, "gap")]
    assert gaps == [
        (b"phase", b"changes_unheard", 8_000_000_000, 0),
        (b"door", b"changes_unheard", 19_000_000_000, 0),
    ]
