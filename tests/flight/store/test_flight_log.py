"""What a real flight's log says in every segment, where its rings lie, and what becomes of them."""

import errno
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from drivers import records
from drivers.records import event
from onboard import cli, config
from onboard.cli.common import next_log
from onboard.flight.estimate import checkpoint
from onboard.flight.estimate.estimation import CHECKPOINT_NS, DurableEstimation, answer_rates_hz, create_rings
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store import directories, manifest, rings
from onboard.flight.store.flight_log import Started, open_recorder, preamble, step_ns, storage
from onboard.flight.store.harvest import harvest
from onboard.flight.supervise import runner
from onboard.flight.supervise.runner_processes import FlightError
from onboard.recording.format.segments import segments
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog
from onboard.ring import RingReader, RingWriter
from tests.flight.missions import Result

STARTED = Started(1_565_611_200_000_000_000, 5_000_000_000)


@pytest.fixture(autouse=True)
def _rings_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEFT_RINGS", str(tmp_path / "rings"))


@pytest.fixture
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


def begin(vehicle: config.Vehicle, log: Path, flight: str = "0123456789abcdef", **kept: int) -> manifest.Manifest:
    with manifest.new_flight(log, flight) as directory:
        pass
    settings = storage(vehicle.file.recording)._replace(reserve_bytes=1000, **kept)
    about = manifest.Manifest(directory, log, "rocksat", settings, preamble(vehicle, flight, STARTED))
    about.save()
    return about


def push_event(directory: Path, count: int = 1) -> None:
    ring = RingWriter(directory / "event.ring", records.EVENT, 400)
    for _ in range(count):
        row = event(1, 0, "code", "source", "text").rows
        row["sequence"] = ring.published
        ring.push(row)


def test_every_segment_says_what_flew_with_which_files_versions_and_clocks(
    vehicle: config.Vehicle, tmp_path: Path
) -> None:
    about = begin(vehicle, tmp_path / "flight", segment_span_ns=100_000_000)
    push_event(about.directory)
    recorder = open_recorder(about)
    for step in range(20):
        push_event(about.directory)
        recorder.step(step * 50_000_000)
    recorder.close(10**9)
    found = segments(tmp_path / "flight")
    assert len(found) > 2
    for path in found:
        log = LogReader([path])
        assert log.attachments["vehicle.toml"].data.decode() == vehicle.text
        assert log.attachments["rocksat.urdf"].data == vehicle.urdf_path.read_bytes()
        assert log.metadata["flight"]["vehicle"] == "rocksat"
        assert log.metadata["flight"]["wall_clock_ns"] == str(STARTED.wall_clock_ns)
        assert {"heft", "numpy", "revision"} <= log.metadata["versions"].keys()
        assert {"imu_base", "joint_1", "load_cell", "wall_clock"} <= log.metadata["clock_map"].keys()
        assert "1000 Hz" in log.metadata["clock_map"]["imu_base"]


def test_the_vehicle_file_says_how_often_it_is_synced(
    vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = vehicle.text.replace("[recording]", "[recording]\nsync_period_ms = 500\nreserve_mib = 0\nsegment_mib = 1")
    (tmp_path / "rocksat.urdf").write_bytes(vehicle.urdf_path.read_bytes())
    (tmp_path / "vehicle.toml").write_text(text, encoding="utf-8")
    kept = storage(config.load(tmp_path / "vehicle.toml").file.recording)
    assert kept == manifest.Storage(500_000_000, 120_000_000_000, 1 << 20, 0)
    assert step_ns(kept) == 50_000_000
    assert step_ns(kept._replace(sync_period_ns=20_000_000)) == 10_000_000
    about = begin(vehicle, tmp_path / "a.mcap", sync_period_ns=500_000_000)
    push_event(about.directory)
    recorder = open_recorder(about)
    recorder.step(0)
    synced = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (synced.append(now_ns), real(descriptor)))
    for now_ns in range(50_000_000, 5_000_000_001, 50_000_000):
        push_event(about.directory)
        recorder.step(now_ns)
    assert np.diff(synced).tolist() == [450_000_000] * 10  # what came just after one step waits for 500 ms at most
    recorder.close(now_ns)


def test_a_manifest_comes_back_as_it_was(vehicle: config.Vehicle, tmp_path: Path) -> None:
    about = begin(vehicle, tmp_path / "a.mcap")
    assert manifest.Manifest.load(about.directory) == about
    assert about.directory.stat().st_mode & 0o077 == 0


def test_a_flight_runs_while_a_process_belongs_to_it_and_is_abandoned_after(
    vehicle: config.Vehicle, tmp_path: Path
) -> None:
    about = begin(vehicle, tmp_path / "a.mcap")
    with directories.belong(about.directory), directories.belong(about.directory):
        assert [flight.log for flight in manifest.running()] == [about.log]
        with manifest.abandoned() as found:
            assert found == []
    assert manifest.running() == []
    with manifest.abandoned() as found:
        assert found == [about.directory]


def test_a_harvest_that_the_disk_refuses_is_made_the_next_time(vehicle: config.Vehicle, tmp_path: Path) -> None:
    about = begin(vehicle, tmp_path / "logs" / "a.mcap")
    push_event(about.directory, 7)
    (tmp_path / "logs").write_text("in the way")
    [failed] = harvest(10**9)
    assert failed.problem
    assert about.directory.exists()
    (tmp_path / "logs").unlink()
    [done] = harvest(2 * 10**9)
    assert (done.log, done.rows, done.problem) == (about.log, 7, "")
    assert not about.directory.exists()
    assert len(LogReader(about.log).read("event")) == 7
    assert harvest(3 * 10**9) == []


def test_two_flights_that_died_with_one_name_keep_a_log_each(vehicle: config.Vehicle, tmp_path: Path) -> None:
    flights = {flight: begin(vehicle, tmp_path / "a.mcap", flight) for flight in ("11111111aa", "22222222bb")}
    for rows, about in enumerate(flights.values(), 3):
        push_event(about.directory, rows)
    done = harvest(10**9)
    assert [(one.rows, one.problem) for one in done] == [(3, ""), (4, "")]
    logs = [LogReader(one.log) for one in done]
    assert [len(log.read("event")) for log in logs] == [3, 4]
    assert [log.metadata["segment"]["flight"] for log in logs] == list(flights)
    assert [one.log.name for one in done] == ["a.mcap", "a-22222222.mcap"]


def test_a_name_that_a_dead_flight_still_waits_for_is_not_given_again(
    vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(vehicle, tmp_path / "rocksat-001.mcap")
    assert next_log(str(tmp_path), "rocksat").name == "rocksat-002.mcap"
    monkeypatch.setattr(runner, "harvest", lambda now_ns: [])
    with pytest.raises(FileExistsError):
        runner.fly(vehicle, tmp_path / "rocksat-001.mcap")


def test_a_harvest_removes_no_earlier_flight(vehicle: config.Vehicle, tmp_path: Path) -> None:
    SegmentedLog(tmp_path / "earlier.mcap", Preamble("earlier")).close()
    about = begin(vehicle, tmp_path / "a.mcap")
    push_event(about.directory)
    content = json.loads((about.directory / "manifest.json").read_text())
    content["storage"]["min_free_bytes"] = 10**18  # as somebody would write who wants them gone
    (about.directory / "manifest.json").write_text(json.dumps(content))
    harvest(10**9)
    assert (tmp_path / "earlier.mcap").exists()


def test_a_start_that_is_refused_leaves_nothing(
    vehicle: config.Vehicle, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    for log in (tmp_path / "file" / "a.mcap", tmp_path / "file"):
        assert cli.main(["fly", str(vehicle.path), "--log", str(log)]) == cli.BAD_INPUT
    assert capsys.readouterr().err.count("file exists") == 2

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "ring")

    monkeypatch.setattr(rings, "create", refuse)
    assert cli.main(["fly", str(vehicle.path), "--log", str(tmp_path / "b" / "a.mcap")]) == cli.BAD_INPUT
    assert list((tmp_path / "rings").iterdir()) == []
    assert manifest.waiting() == []


@pytest.mark.parametrize("command", [["fly"], ["hil", "--realtime"]])
@pytest.mark.parametrize("left", ["a.mcap", "a_001.mcap", "a_017.mcap"])
def test_a_log_whose_name_or_that_of_a_segment_is_taken_is_refused_before_anything_starts(
    vehicle: config.Vehicle,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: list[str],
    left: str,
) -> None:
    def start(*_: object, **__: object) -> None:
        raise AssertionError("something was started")

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(runner, "Servers", start)
    place = tmp_path / "logs"
    place.mkdir()
    SegmentedLog(place / left, Preamble("earlier")).close()
    before = (place / left).read_bytes()
    assert cli.main([*command, "rocksat", "--log", str(place / "a.mcap")]) == cli.BAD_INPUT
    said = capsys.readouterr().err
    assert str(place / left) in said
    assert "name another" in said
    assert "Traceback" not in said
    assert os.listdir(place) == [left]
    assert (place / left).read_bytes() == before
    assert manifest.waiting() == []


@pytest.mark.realtime
def test_a_recorder_that_cannot_begin_ends_the_flight_and_leaves_nothing(
    vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(runner, "_require_place", lambda log: None)
    with pytest.raises(FlightError, match="recording"):
        runner.fly(vehicle, tmp_path / "file" / "a.mcap", duration_s=1)
    assert list((tmp_path / "rings").iterdir()) == []


def test_rings_of_another_version_do_not_keep_a_flight_on_the_ground(vehicle: config.Vehicle, tmp_path: Path) -> None:
    about = begin(vehicle, tmp_path / "a.mcap")
    (about.directory / "manifest.json").write_text('{"log": "a.mcap"}', encoding="utf-8")
    [failed] = harvest(10**9)
    assert failed.log == about.directory
    assert "another version" in failed.problem
    assert about.directory.exists()


def test_an_estimator_without_room_for_a_checkpoint_says_so_and_goes_on(
    vehicle: config.Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rings.create(tmp_path, vehicle, rings.device_channels(vehicle))

    def refuse(path: Path, *, keep: bool) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(checkpoint, "open_private", refuse)
    worker = DurableEstimation(vehicle, tmp_path, 0)
    for step in range(100):
        worker.step(step * 50_000_000)
    said = RingReader(tmp_path / "event_estimation.ring").read()[0]["code"].tolist()
    assert said.count(b"no_checkpoint") == 1 + 99 * 50_000_000 // CHECKPOINT_NS
    assert len(RingReader(tmp_path / "tick.ring").read()[0]) == 100


def test_rings_hold_ten_seconds_of_every_channel(vehicle: config.Vehicle, mission: Result, tmp_path: Path) -> None:
    estimator = Estimator(vehicle)
    made = create_rings(tmp_path, estimator) | rings.create(tmp_path, vehicle, rings.device_channels(vehicle))
    assert answer_rates_hz(estimator).keys() <= made.keys()
    looked_at = 0
    for name, ring in made.items():
        host_ns = mission.log.read(name)["host_ns"]
        in_ten_seconds = np.searchsorted(host_ns, host_ns + 10_000_000_000) - np.arange(len(host_ns))
        assert ring.capacity >= in_ten_seconds.max(initial=0), name
        looked_at += len(host_ns)
    assert looked_at > 100_000
