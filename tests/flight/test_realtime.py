"""The flight app's own processes against devices in another process, on the real clock (tier T1)."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from drivers import records
from onboard import cli, config
from onboard.recording.reader import LogReader
from tests.conftest import is_alive

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]


@pytest.mark.timeout(120)
def test_a_flight_without_a_single_bus_says_so_and_leaves_a_log(tmp_path: Path) -> None:
    vehicle = config.packaged("rocksat")
    log = tmp_path / "dark.mcap"
    missing = [f"--url={bus}={url}" for bus, url in (
        ("i2c_1", f"i2c:///{tmp_path}/none"),
        ("can_0", f"can+slcan:///{tmp_path}/none?bitrate=500000"),
        ("sync_line", "gpio:///dev/none?line=1"),
    )]  # fmt: skip
    command = [sys.executable, "-m", "onboard.cli", "fly", str(vehicle), "--log", str(log), "--duration", "1", *missing]
    told = os.environ | {"PYTHONPROFILEIMPORTTIME": "1"}  # its workers too say what they import
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False, env=told)
    assert done.returncode == cli.FAILED, done.stderr
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert imported >= {"onboard.flight.estimate.estimator", "onboard.flight.supervise.runner", "pinocchio"}
    asked_for = ("onboard.page", "onboard.telemetry", "onboard.live", "spacepackets", "foxglove", "websockets")
    assert not [name for name in imported if name.startswith(asked_for)]
    for bus in ("can_0", "i2c_1", "sync_line"):
        assert f"{bus}: bus_failed" in done.stderr
        assert f"bus {bus} was missing all flight" in done.stderr
    assert "rows/s" in done.stderr  # how it stands, once a second
    events = LogReader(log).read("event")
    assert sorted(events["source"][events["code"] == b"bus_failed"].tolist()) == [b"can_0", b"i2c_1", b"sync_line"]


@pytest.mark.timeout(120)
def test_sigterm_ends_a_flight_in_order(tmp_path: Path) -> None:
    vehicle = config.packaged("rocksat")
    log = tmp_path / "term.mcap"
    command = [sys.executable, "-m", "onboard.cli", "fly", str(vehicle), "--log", str(log)]
    flight = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (log.exists() and log.stat().st_size > 0):
        time.sleep(0.1)
    time.sleep(1.0)
    os.kill(flight.pid, signal.SIGTERM)
    out, err = flight.communicate(timeout=60)
    assert flight.returncode == cli.FAILED, err  # no bus of it is there
    assert str(log) in out
    read = LogReader(log)
    assert read.complete
    assert read.channels["imu_base"] == records.IMU


@pytest.mark.timeout(180)
def test_a_bus_that_appears_late_joins_and_the_gap_until_then_is_in_the_log(tmp_path: Path) -> None:
    log = tmp_path / "late.mcap"
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "3", "--directory", str(tmp_path)]
    fly = [sys.executable, "-m", "onboard.cli", "fly", str(config.packaged("rocksat")), "--log", str(log)]
    adapter = tmp_path / "adapter"
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as devices:
        assert devices.stdout is not None
        start = json.loads(devices.stdout.readline())
        terminal = Path(urlsplit(start["can_0"]).path)
        urls = [
            f"--url={bus}={start[bus]}".replace(str(terminal), str(adapter)) for bus in ("can_0", "i2c_1", "sync_line")
        ]
        said = (tmp_path / "stderr").open("w+")
        with subprocess.Popen([*fly, *urls], stderr=said) as flight:
            for code in ("can_0: bus_failed", "can_0: bus_opened"):
                deadline = time.monotonic() + 50
                while code not in (tmp_path / "stderr").read_text() and time.monotonic() < deadline:
                    time.sleep(0.1)
                time.sleep(4.0)
                if not adapter.exists():
                    adapter.symlink_to(terminal)
            flight.send_signal(signal.SIGTERM)
            assert flight.wait(60) == cli.OK, (tmp_path / "stderr").read_text()
        said.close()
        devices.terminate()
    read = LogReader(log)
    gaps = read.read("gap")
    absent = gaps[gaps["cause"] == b"absent_at_start"]
    for channel in ("can_sync", "joint_1", "load_cell"):
        [gap] = absent[absent["channel"] == channel.encode()]
        rows = read.read(channel)
        assert gap["first_missing"] == 0
        assert int(gap["last_missing"]) + 1 <= int(rows["sequence"][0])
        assert int(gap["last_missing"]) > 600  # 200 Hz, and more than three seconds of it
        assert len(rows) > 100
    assert b"imu_base" not in absent["channel"].tolist()
    assert gaps["channel"][gaps["cause"] == records.CHANGES_UNHEARD.encode()].tolist() == [b"arm_phase"]
    assert b"bus_opened" in read.read("event")["code"].tolist()


@pytest.mark.timeout(180)
@pytest.mark.parametrize("victim", ["flight", "devices"])
def test_a_rehearsal_that_is_ended_or_loses_its_devices_ends_and_leaves_nobody(tmp_path: Path, victim: str) -> None:
    log = tmp_path / "ended.mcap"
    command = [sys.executable, "-m", "onboard.cli", "hil", "rocksat", "--realtime", "--log", str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as rehearsal:
        deadline = time.monotonic() + 90
        while time.monotonic() < deadline and not log.exists():
            time.sleep(0.1)
        time.sleep(3.0)
        devices = _devices_of(rehearsal.pid)
        assert devices is not None
        os.kill(
            rehearsal.pid if victim == "flight" else devices, signal.SIGTERM if victim == "flight" else signal.SIGKILL
        )
        began = time.monotonic()
        said, complained = rehearsal.communicate(timeout=80)
    assert time.monotonic() - began < 30.0
    assert "Traceback" not in complained
    assert rehearsal.returncode == cli.FAILED  # nothing is identified yet
    assert ("accounted for" in said) if victim == "flight" else ("devices died in flight" in complained)
    assert not is_alive(devices)
    read = LogReader(log)
    assert read.complete
    assert read.read("imu_base").size > 1000


def _devices_of(rehearsal: int) -> int | None:
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == rehearsal and "hil_sim.serve" in (entry / "cmdline").read_text():
                return int(entry.name)
    return None


@pytest.mark.timeout(180)
def test_the_devices_of_a_rehearsal_that_is_killed_end_too(tmp_path: Path) -> None:
    log = tmp_path / "killed.mcap"
    command = [sys.executable, "-m", "onboard.cli", "hil", "rocksat", "--realtime", "--log", str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as rehearsal:
        deadline = time.monotonic() + 90
        while time.monotonic() < deadline and not (log.exists() and log.stat().st_size > 100_000):
            time.sleep(0.1)
        devices = _devices_of(rehearsal.pid)
        assert devices is not None
        rehearsal.kill()
        rehearsal.communicate(timeout=60)
        deadline = time.monotonic() + 20
        while is_alive(devices) and time.monotonic() < deadline:
            time.sleep(0.05)
    assert not is_alive(devices)
    assert LogReader(log).read("imu_base").size > 100
