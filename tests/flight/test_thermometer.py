"""A device of another package with a quantity that heft has no record for: flown, accounted for, in the log, dumped."""

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from onboard.recording.reader import LogReader

ROOT = Path(__file__).parents[2]
POINTS = """\
[heft.devices]
thermometer = thermometer.device:ThermometerDevice
[heft.emulators]
thermometer = thermometer.emulator:ThermometerTable
"""
TABLES = """
[bus.tty]
url = "serial:///dev/ttyUSB0?baud=9600"

[device.outside]
kind = "thermometer"
bus = "tty"
"""
SHORT = '[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 6.0\n'


def heft(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{directory / 'site'}:{ROOT}"}
    command = [sys.executable, "-m", "onboard.cli", *arguments]
    return subprocess.run(command, env=environment, cwd=directory, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("warm")
    information = directory / "site" / "thermometer-1.0.dist-info"
    information.mkdir(parents=True)
    code = Path(__file__).with_name("thermometer")
    shutil.copytree(code, directory / "site" / code.name, ignore=shutil.ignore_patterns("__pycache__"))
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: thermometer\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(POINTS)
    (directory / "short.toml").write_text(SHORT)
    said = heft(directory, "init", "mine", "--base", "fixed", "--joints", "1", "--load-cell", "cia404")
    assert said.returncode == 0, said.stderr
    with (directory / "mine" / "vehicle.toml").open("a") as file:
        file.write(TABLES)
    options = ("--scenario", "short.toml", "--seed", "1", "--log", "flight.mcap", "--json", "flight.json")
    said = heft(directory, "hil", "mine/vehicle.toml", *options)
    assert (directory / "flight.json").is_file(), said.stderr
    return directory


def test_its_rows_are_in_the_log_by_their_own_record(flown: Path) -> None:
    rows = LogReader(flown / "flight.mcap").read("outside")
    account = json.loads((flown / "flight.json").read_text())["channels"]["outside"]
    assert len(rows) == account["recorded"] == account["produced"] > 80
    assert rows["temperature_k"] == pytest.approx(293.15 + 1e-3 * rows["sequence"])
    assert rows.dtype["humid"] == np.uint8


def test_it_is_dumped_with_its_field_and_unit(flown: Path) -> None:
    said = heft(flown, "dump", "flight.mcap", "--to", "csv", "tables", "--channel", "outside")
    assert said.returncode == 0, said.stderr
    with next((flown / "tables").glob("*outside*.csv")).open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["temperature_k"]) for row in table[:3]] == pytest.approx([293.15, 293.151, 293.152])
