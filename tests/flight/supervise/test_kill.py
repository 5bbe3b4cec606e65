"""SIGKILL in a real flight: one worker after the other, the supervisor, and everything at once.

What is done to a flight from outside: its log removed and cut off, its terminal gone, its computer busy.
"""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard import cli, config
from onboard.flight.health.status import Status
from onboard.flight.store import directories, manifest
from onboard.flight.supervise.resume import load, path_of
from onboard.flight.supervise.runner_forks import ForkServer
from onboard.flight.supervise.runner_processes import Worker
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.ground.log.views.info import info
from onboard.recording.format.segments import segment_path
from onboard.recording.reader import LogReader
from onboard.ring import RingReader
from tests.flight import forked


def until(true: Callable[[], bool], seconds: float = 90.0) -> bool:
    """Wait for it."""
    deadline = time.monotonic() + seconds
    while not true() and time.monotonic() < deadline:
        time.sleep(0.05)
    return true()


@pytest.mark.timeout(300)
def test_a_flight_whose_log_is_removed_and_cut_off_and_whose_terminal_goes_accounts_for_every_row(
    tmp_path: Path,
) -> None:
    log, place = tmp_path / "flights" / "unkind.mcap", tmp_path / "sockets"
    place.mkdir()
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "3", "--directory", str(place)]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True, start_new_session=True) as devices:
        assert devices.stdout is not None
        start = json.loads(devices.stdout.readline())
        urls = [f"--url={bus}={start[bus]}" for bus in ("i2c_1", "can_0", "sync_line")]
        command = [sys.executable, "-m", "onboard.cli", "fly", str(config.packaged("rocksat")), "--log", str(log)]
        terminal, end = pty.openpty()
        # a session of its own, whose terminal this is
        shell = ["setsid", "--ctty", "--wait", *command, "--duration", "300", *urls]
        with subprocess.Popen(shell, stdin=end, stdout=end, stderr=end) as flight:
            os.close(end)
            said = Said(terminal)
            assert until(lambda: said.has("every worker is at work")), said.text
            time.sleep(2.0)
            log.unlink()
            assert until(lambda: said.has("log_lost: unkind.mcap was removed"), 20.0), said.text
            assert until(lambda: segment_path(log, 1).stat().st_size > 200_000)
            os.truncate(segment_path(log, 1), 100_000)  # what it says of the first is left
            assert until(lambda: said.has("log_lost: unkind_001.mcap was cut off after 100000 of"), 20.0), said.text
            os.close(terminal)
            assert until(lambda: segment_path(log, 2).stat().st_size > 200_000)
            assert flight.poll() is None
            flight.send_signal(signal.SIGTERM)  # setsid has become it: what is forked leads no process group
            code = flight.wait(60)
        devices.terminate()
    assert code == cli.FAILED  # rows are lost
    hangups = [text for code, text in events(log, "event_supervisor") if code == "hangup"]
    assert [text.partition(";")[0] for text in hangups] == ["the terminal is gone"]
    about = info(log)
    assert {channel.name: channel.unexplained for channel in about.channels if channel.unexplained} == {}
    assert sum(channel.gaps for channel in about.channels) > 1000
    assert [code for code, _ in events(log, "recorder_event")].count("log_lost") == 2


def events(log: Path, channel: str) -> list[tuple[str, str]]:
    return [(row["code"].decode(), row["text"].decode()) for row in LogReader(log).read(channel)]


class Said:
    """What comes from a terminal."""

    def __init__(self, terminal: int) -> None:
        os.set_blocking(terminal, False)
        self._terminal, self.text = terminal, ""

    def has(self, words: str) -> bool:
        with contextlib.suppress(BlockingIOError, OSError):
            while part := os.read(self._terminal, 1 << 16):
                self.text += part.decode(errors="replace")
        return words in self.text


@pytest.mark.timeout(60)
def test_the_end_of_a_worker_is_bounded_and_tended_meanwhile(light: ForkServer) -> None:
    worker = Worker("test", partial(light.fork, forked.work_long))
    worker.start()
    worker.wait_ready()
    waited: list[float] = []
    assert 2.0 <= worker.finish(2.0, waited.append) < 4.0
    assert len(waited) >= 5
    assert waited == sorted(waited)
    assert worker.exit_code == -signal.SIGKILL
    assert not worker.died  # the answer of its last step is the answer


pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]

WORKERS = ("heft-record", "heft-estimate", "heft-acquire")
DEVICES = ("imu_base", "can_sync", "joint_1", "load_cell", "pulse")


@pytest.fixture
def urls(tmp_path: Path) -> Iterator[list[str]]:
    """Simulated devices in a process of their own."""
    command = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "3", "--directory", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as devices:
        assert devices.stdout is not None
        start = json.loads(devices.stdout.readline())
        yield [f"--url={bus}={start[bus]}" for bus in ("i2c_1", "can_0", "sync_line")]
        devices.terminate()


@contextlib.contextmanager
def flying(log: Path, urls: list[str], seconds: float, named: bool = True) -> Iterator[subprocess.Popen[str]]:
    """``heft fly``, once every worker is at work; not ``named``: it gives its log that name by itself."""
    vehicle = str(config.packaged("rocksat"))
    command = [sys.executable, "-m", "onboard.cli", "fly", vehicle, "--duration", str(seconds), *urls]
    command += ["--log", str(log)] if named else []
    where, pipe = None if named else log.parent.parent, subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=where, start_new_session=True) as flight:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not (log.exists() and len(pids(flight.pid)) == len(WORKERS)):
            time.sleep(0.1)
        time.sleep(2.0)
        yield flight


def pids(supervisor: int) -> dict[str, int]:
    """The workers' processes by name."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            name, _, rest = entry.read_text().partition("(")[2].rpartition(")")
            if name in WORKERS and int(rest.split()[1]) == supervisor:
                found[name] = int(entry.parent.name)
    return found


def await_another(supervisor: int, name: str, victim: int, deadline_s: float) -> None:
    """Wait until another process stands for a worker."""
    while pids(supervisor).get(name, victim) == victim and time.monotonic() < deadline_s:
        time.sleep(0.1)
    assert pids(supervisor)[name] != victim


def adds_up(log: Path) -> None:
    """Every number of every channel is in the log once, or in a gap record."""
    about = info(log)
    assert {(c.name, c.repeated, c.unexplained) for c in about.channels} == {(c.name, 0, 0) for c in about.channels}
    assert {c.first_sequence for c in about.channels if c.rows} == {0}
    assert about.exit_code == 0


@pytest.mark.timeout(180)
def test_each_worker_that_is_killed_or_hangs_is_started_again_and_the_log_replays(
    tmp_path: Path, urls: list[str]
) -> None:
    log = tmp_path / "killed.mcap"
    with flying(log, urls, 200) as flight:
        for name in (*WORKERS, "heft-record", "heft-estimate"):
            victim = pids(flight.pid)[name]
            os.kill(victim, signal.SIGKILL)
            await_another(flight.pid, name, victim, time.monotonic() + 15)
            time.sleep(2.0)
        hung = {name: pids(flight.pid)[name] for name in ("heft-record", "heft-estimate")}
        for victim in hung.values():
            os.kill(victim, signal.SIGSTOP)
        deadline = time.monotonic() + 60
        for name, victim in hung.items():
            await_another(flight.pid, name, victim, deadline)
        time.sleep(2.0)
        flight.send_signal(signal.SIGTERM)
        _, err = flight.communicate(timeout=100)
    assert flight.returncode == cli.OK, err
    adds_up(log)
    read = LogReader(log)
    supervisor = read.read("event_supervisor")
    assert [code.decode() for code in supervisor["code"]].count("worker_restarted") == 7
    hung_again = supervisor["source"][supervisor["code"] == b"worker_hung"]
    assert sorted(hung_again.tolist()) == [b"estimation", b"recording"]
    gaps = read.read("gap")
    restart = gaps[gaps["cause"] == b"worker_restart"]
    assert {row["channel"].decode() for row in restart} >= {"joint_1", "load_cell"}  # acquisition was away
    assert len(read.read("recorder_gap")) == 0
    imu = read.read("imu_base")
    assert np.count_nonzero(imu["status"] & SampleStatus.AFTER_RESET) == 1
    assert not read.read("tick")["fresh"].any()
    health = read.read("health")
    assert health["restarts"][-1] == 7
    assert health["status_latched"][-1] & Status.WORKER_DOWN
    assert np.abs(np.diff(health["host_ns"]) * 1e-9 - 1.0).max() < 0.5
    assert np.nanmax(health["acquisition_cpu_percent"]) > 1.0
    assert cli.main(["replay", str(log)]) == cli.OK
    assert not list(directories.root().iterdir())


@pytest.mark.timeout(180)
def test_everything_killed_at_once_is_harvested_and_gone_on_with_by_the_next_start(
    tmp_path: Path, urls: list[str]
) -> None:
    log, following = (tmp_path / "flights" / f"rocksat-001{part}.mcap" for part in ("", "-part2"))
    with flying(log, urls, 100, named=False) as flight:
        deadline = time.monotonic() + 15
        while not (checkpoint := path_of(log)).exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)
        [dead] = manifest.running()
        os.killpg(flight.pid, signal.SIGKILL)
        flight.wait()
    kept = load(checkpoint)
    assert dead.log == log
    held = {path.stem: RingReader(path).read()[0] for path in dead.directory.glob("*.ring")}
    assert all(len(held[name]) for name in DEVICES)
    dark = [f"--url={bus}=i2c:///none" if bus == "i2c_1" else f"--url={bus}={url}" for bus, url in DARK.items()]
    with flying(following, dark, 1, named=False) as flight:
        _, err = flight.communicate(timeout=100)
    assert flight.returncode == cli.FAILED, err  # its own buses are dark
    adds_up(log)
    read = LogReader(log)
    for name, rows in held.items():
        assert read.read(name)[-len(rows) :]["sequence"].tolist() == rows["sequence"].tolist(), name
    assert [row["code"] for row in read.read("recorder_event")] == [b"harvested"]
    after = LogReader(following)
    said = after.read("event_supervisor")
    assert [row["source"].decode() for row in said if row["code"] in (b"harvest", b"resumed")] == [log.name] * 2
    phases, killed_ns = held["arm_phase"], max(int(rows["host_ns"][-1]) for rows in held.values() if len(rows))
    before = phases["value_raw"][phases["host_ns"] < killed_ns - KEPT_EVERY_NS]
    assert kept.phase in [*before[-1:], *phases["value_raw"][len(before) :]]
    phase = kept.phase
    resumed = vehicle_of(after, tmp_path).file.estimation.phases.resumed
    assert (resumed.log, resumed.phase) == (log.name, phase)
    assert after.metadata["flight"]["continues"] == log.name
    told = [row["text"].decode() for row in said if row["code"] in (b"phase", b"mode")]
    assert told[0] == f"phase {phase}, from before the restart"
    assert [text.partition(":")[0] for text in told[1:]] == ["boot", "checkout", "safe", "stopped"]
    assert not list(log.parent.glob("*.resume"))  # that one has ended
    assert cli.main(["replay", str(log)]) == cli.OK
    assert not list(directories.root().iterdir())


KEPT_EVERY_NS = 3_000_000_000  # a checkpoint is as old as that at most
DARK = {"i2c_1": "", "can_0": "can+slcan:///none?bitrate=500000", "sync_line": "gpio:///dev/none?line=1"}


@pytest.mark.timeout(180)
def test_without_its_supervisor_a_flight_ends_in_order(tmp_path: Path, urls: list[str]) -> None:
    log = tmp_path / "orphaned.mcap"
    with flying(log, urls, 100) as flight:
        workers = pids(flight.pid)
        os.kill(flight.pid, signal.SIGKILL)
        deadline = time.monotonic() + 30
        while manifest.running() and time.monotonic() < deadline:
            time.sleep(0.1)
    assert len(workers) == len(WORKERS)
    assert not manifest.running()
    adds_up(log)
    assert LogReader(log).read("tick")["final"][-1] == 1
