"""A device of another package with a quantity that heft has no record for: flown, accounted for, in the log, dumped."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from onboard.recording.reader import LogReader
from tests.flight import elsewhere
from tests.flight.elsewhere import heft

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


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("warm")
    code, site = Path(__file__).with_name("thermometer"), elsewhere.installed(directory, "thermometer", POINTS)
    shutil.copytree(code, site / code.name, ignore=shutil.ignore_patterns("__pycache__"))
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
