"""A rehearsal whose log somebody removes or cuts off: answers and losses are printed, the exit code is 1."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from onboard import cli
from onboard.recording.reader import LogReader
from tests.flight.missions import SHORT_REAL, inline
from tests.flight.test_full_disk import SHORTER

pytestmark = pytest.mark.usefixtures("own_rings")


def rehearse(place: Path, *options: str, take: Callable[[Path], object]) -> tuple[int, str, str, Path]:
    """``heft hil rocksat`` whose log ``take`` is called with in flight: exit code, what was printed, the log named."""
    log, short = place / "flights" / "flown.mcap", place / "short.toml"
    sequence = SHORT_REAL if "--realtime" in options else SHORTER
    short.write_text(f"sequence = [{', '.join(map(inline, sequence))}]\n")
    command = [sys.executable, "-m", "onboard.cli", "hil", "rocksat", "--scenario", str(short), "--log", str(log)]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, *options], stdout=pipe, stderr=pipe, text=True) as flight:
        while flight.poll() is None and not (log.exists() and log.stat().st_size > 200_000):
            time.sleep(0.01)
        take(log)
        out, err = flight.communicate()
    [named] = [line.removeprefix("log: ") for line in out.splitlines() if line.startswith("log: ")]
    return flight.returncode, out, " ".join(err.split()), Path(named)


@pytest.mark.campaign  # the log: test_taken_files; what a rehearsal prints then: test_full_disk
@pytest.mark.timeout(120)
def test_a_rehearsal_whose_log_is_removed_says_what_is_lost_and_keeps_the_rest(tmp_path: Path) -> None:
    code, out, err, log = rehearse(tmp_path, take=lambda log: shutil.rmtree(log.parent))
    assert code == cli.FAILED
    assert "of the log: flown.mcap was removed: " in err, out
    assert "goes on in flown_001.mcap" in err
    assert "Traceback" not in err
    answered = [line for line in out.splitlines() if line.startswith(" m4 (arm), g")]
    assert [".." in line for line in answered] == [True]
    assert "every sample accounted for: imu_base" in out  # recorded, or in gap records
    assert log.name == "flown_001.mcap"
    gaps = [gap for gap in LogReader(log).read("recorder_gap") if gap["channel"] == b"imu_base"]
    assert [gap["cause"] for gap in gaps] == [b"log_lost"]
    assert 0.2e9 * gaps[0]["last_missing"] / 200 < gaps[0]["duration_ns"]  # from the beginning of the file


@pytest.mark.timeout(120)
@pytest.mark.campaign  # the log: test_taken_files; one that is cut off in flight: test_kill
def test_a_rehearsal_whose_log_is_cut_off_says_what_is_lost(tmp_path: Path) -> None:
    code, _, err, log = rehearse(tmp_path, take=lambda log: os.truncate(log, 150_000))
    assert code == cli.FAILED
    assert "of the log: flown.mcap was cut off after 150000 of" in err
    assert "Traceback" not in err
    assert len(LogReader(tmp_path / "flights" / "flown.mcap").read("imu_base")) > 100
    assert log.name == "flown_001.mcap"


@pytest.mark.realtime
@pytest.mark.timeout(200)
def test_a_rehearsal_on_the_real_clock_does_not_end_as_a_success(tmp_path: Path) -> None:
    code, out, err, _ = rehearse(tmp_path, "--realtime", take=Path.unlink)
    assert code == cli.FAILED
    assert "of the log: flown.mcap was removed: " in err
    assert "every sample accounted for: imu_base" in out
    assert ".." in next(line for line in out.splitlines() if line.startswith(" m4 (arm), g"))
