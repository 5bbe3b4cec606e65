"""What a user does after a flight on the real clock, whose logs have wall time, restarts and segments: every reader."""

import contextlib
import io
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from onboard import cli, config
from onboard.ground.log.export import FORMATS
from onboard.recording.reader import LogReader
from tests.flight.missions import SHORT_REAL, inline

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]

FLOWN_S = 14.0  # less than that is no mission


def readings(log: Path, into: Path) -> list[list[str]]:
    """Every command that reads a log."""
    exports = [["dump", str(log), "--to", kind, str(into / kind)] for kind in (*FORMATS, "mcap")]
    return [
        *exports,
        ["dump", str(log), "--to", "csv", str(into / "aligned-csv"), "--aligned", "100"],
        ["dump", str(log), "--to", "npz", str(into / "aligned-npz"), "--aligned", "100"],
        ["dump", str(log), "--to", "csv", str(into / "raw"), "--raw"],
        ["dump", str(log), "--to", "csv", str(into / "phase"), "--phase", "4"],
        ["dump", str(log), "--to", "csv", "-", "--channel", "imu_base"],
        ["info", str(log), "--json", str(into / "info.json")],
        ["report", str(log), "-o", str(into / "report.html")],
        ["identify", str(log), "--json", str(into / "identify.json")],
        ["replay", str(log)],
        ["watch", str(log), "--speed", "0"],
        ["recover", str(log), "-o", str(into / "recovered.mcap")],
        ["compare", str(log), str(into / "recovered.mcap"), "--json", str(into / "compare.json")],
    ]


def after(log: Path, into: Path) -> None:
    """Run them all; the tables hold every row, and the instants the wall clock."""
    into.mkdir()
    failed = [told for one in readings(log, into) if (told := _failed(one))]
    assert not failed, "\n".join(failed)
    flight = LogReader(log)
    for channel in ("imu_base", "joint_1", "event_supervisor"):
        lines = (into / "csv" / f"{channel}.csv").read_text().splitlines()
        assert len(lines) - 1 == len(flight.read(channel)), channel
    header, *rows = (line.split(",") for line in (into / "csv" / "imu_base.csv").read_text().splitlines())
    utc = np.array([row[header.index("utc")].removesuffix("Z") for row in rows], "<M8[ns]")
    started = int(flight.metadata["flight"]["wall_clock_ns"])
    assert abs(int(utc[0].view("<i8")) - started) < 60e9
    assert (np.diff(utc).astype(np.int64) > 0).all()
    aligned = (into / "aligned-csv" / "aligned.csv").read_text().splitlines()
    assert len(aligned) > 50 * FLOWN_S
    assert LogReader(into / "recovered.mcap").read("imu_base").tobytes() == flight.read("imu_base").tobytes()


def _failed(arguments: Sequence[str]) -> str:
    """What a command said that did not end well; empty for one that did."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.TextIOWrapper(io.BytesIO())), contextlib.redirect_stderr(said):
        code = cli.main(list(arguments))
    return "" if code == cli.OK else f"heft {' '.join(arguments)}: exit {code}: {said.getvalue()}"


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A scenario of two sweeps."""
    path = tmp_path / "short.toml"
    path.write_text(f"sequence = [{', '.join(map(inline, SHORT_REAL))}]\n")
    return path


@pytest.mark.campaign  # on the real clock: the command in test_taken_log, masses in tests/kernel
@pytest.mark.timeout(900)
def test_a_rehearsal_in_real_time_gives_the_table(tmp_path: Path, short: Path) -> None:
    log, result = tmp_path / "rt.mcap", tmp_path / "rt.json"
    flown = ["hil", "rocksat", "--scenario", str(short), "--realtime", "--seed", "3"]
    code = cli.main([*flown, "--log", str(log), "--json", str(result)])
    table = json.loads(result.read_text())
    assert table["identified"]
    assert len(table["masses"]) == 3
    for mass in table["masses"]:
        assert mass["low"] < mass["truth"] < mass["high"]
    for name in ("joint_1", "load_cell", "can_sync", "pulse", "arm_phase"):
        counted = table["channels"][name]
        assert counted["recorded"] + counted["missing"] == counted["produced"], name
    assert code == cli.OK or not table["accounted"]


@pytest.mark.timeout(900)
def test_every_reader_reads_the_log_of_a_flight_against_served_devices(tmp_path: Path, short: Path) -> None:
    log, said = tmp_path / "fly.mcap", (tmp_path / "stderr").open("w")
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--over", str(short), "--seed", "3", "--wait"]
    fly = [sys.executable, "-m", "onboard.cli", "fly", str(config.packaged("rocksat")), "--log", str(log)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([*serve, "--directory", str(tmp_path)], text=True, **pipes) as devices:
        assert devices.stdin is not None
        assert devices.stdout is not None
        start = json.loads(devices.stdout.readline())
        urls = [f"--url={bus}={start[bus]}" for bus in ("i2c_1", "can_0", "sync_line")]
        with subprocess.Popen([*fly, *urls], stdout=said, stderr=said) as flight:
            deadline = time.monotonic() + 200
            while time.monotonic() < deadline and not log.exists():
                time.sleep(0.02)
            devices.stdin.write("start\n")  # the mission: acquisition starts last
            devices.stdin.flush()
            assert flight.wait(300) == cli.OK, (tmp_path / "stderr").read_text()
        devices.terminate()
    said.close()
    after(log, tmp_path / "read")
