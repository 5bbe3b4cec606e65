"""The flight app's own processes against devices in another process, on the real clock (tier T1)."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers import records
from onboard import cli, config
from onboard.recording.reader import LogReader

pytestmark = pytest.mark.realtime


@pytest.mark.timeout(240)
def test_the_mission_in_real_time_gives_the_table(tmp_path: Path) -> None:
    log, result = tmp_path / "rt.mcap", tmp_path / "rt.json"
    code = cli.main(["hil", "rocksat", "--realtime", "--seed", "3", "--log", str(log), "--json", str(result)])
    table = json.loads(result.read_text())
    assert table["identified"]
    assert len(table["masses"]) == 3
    for mass in table["masses"]:
        assert mass["low"] < mass["truth"] < mass["high"]
    for name in ("joint_1", "load_cell", "can_sync", "pulse", "arm_phase"):
        counted = table["channels"][name]
        assert counted["recorded"] + counted["missing"] == counted["produced"], name
    assert code == cli.OK or not table["accounted"]
    assert cli.main(["replay", str(log)]) == cli.OK


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
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == cli.FAILED, done.stderr
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
