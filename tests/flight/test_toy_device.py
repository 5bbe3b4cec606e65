"""Kinds of devices from outside the package, found by their entry points, take part in a whole flight.

The packages of ``tests/flight/toy``, which measures the joint, and ``tests/flight/thermometer``, which has a quantity
that heft has no record for, are laid out as installed distributions in a directory of their own. Nothing of heft names
them.
"""

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_sim.mission import VIRTUAL_START_NS
from onboard import cli
from onboard.recording.reader import LogReader
from tests.flight import elsewhere
from tests.flight.elsewhere import heft

POINTS = """\
[heft.devices]
toy_angle = toy_angle.device:ToyAngleDevice
[heft.emulators]
toy_angle = toy_angle.emulator:ToyAngleTable
"""
WARM_POINTS = """\
[heft.devices]
thermometer = thermometer.device:ThermometerDevice
[heft.emulators]
thermometer = thermometer.emulator:ThermometerTable
"""
WARM = """
[bus.tty]
url = "serial:///dev/ttyUSB1?baud=9600"

[device.outside]
kind = "thermometer"
bus = "tty"
"""
JOINT = """
[bus.tty_toy]
url = "serial:///dev/ttyUSB0?baud=115200"

[device.joint_1]
kind = "toy_angle"
bus = "tty_toy"
joint = "joint_1"
noise_rad = 4.0e-6
"""
SHORT = """\
[[sequence]]
phase = 1
action = "strokes"
amplitude = { joint_1 = 0.2007 }
stroke_s = 0.6
strokes = 7
pause_s = 0.05
transfer_s = 0.5
"""


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where they are installed, and a vehicle that has them."""
    directory = tmp_path_factory.mktemp("toys")
    code, site = Path(__file__).with_name("toy"), elsewhere.installed(directory, "toy_angle", POINTS)
    shutil.copytree(code, site / "toy_angle", ignore=shutil.ignore_patterns("__pycache__"))
    code, site = Path(__file__).with_name("thermometer"), elsewhere.installed(directory, "thermometer", WARM_POINTS)
    shutil.copytree(code, site / code.name, ignore=shutil.ignore_patterns("__pycache__"))
    (directory / "short.toml").write_text(SHORT)
    said = heft(directory, "init", "mine", "--base", "fixed", "--joints", "1", "--load-cell", "cia404")
    assert said.returncode == 0, said.stderr
    vehicle = directory / "mine" / "vehicle.toml"
    text, times = re.subn(r"\n\[device\.joint_1\]\n(?:(?!\[).*\n)*", f"\n{JOINT}\n", vehicle.read_text())
    assert times == 1
    vehicle.write_text(text + WARM)
    return directory


@pytest.fixture(scope="module")
def flown(toys: Path) -> tuple[dict[str, Any], LogReader]:
    options = ("--scenario", "short.toml", "--seed", "3", "--log", "flight.mcap", "--json", "flight.json")
    said = heft(toys, "hil", "mine/vehicle.toml", *options)
    assert (toys / "flight.json").is_file(), said.stderr
    return json.loads((toys / "flight.json").read_text()), LogReader(toys / "flight.mcap")


def test_its_samples_are_in_the_log_and_accounted_for(flown: tuple[dict[str, Any], LogReader]) -> None:
    result, log = flown
    assert result["accounted"], result["channels"]
    rows = log.read("joint_1")
    assert len(rows) == result["channels"]["joint_1"]["recorded"] > 1000
    assert set(rows["unit"]) == {b"rad"}
    swept_rad = np.ptp(rows["value_raw"] * rows["scale"])
    assert np.degrees(swept_rad) > 20.0  # amplitude 11.5 deg


def test_it_is_estimated_with(flown: tuple[dict[str, Any], LogReader]) -> None:
    """Its role and its clock reach the estimator: there are rows, which need the joint's angle on vehicle time."""
    _, log = flown
    used = log.read("row")
    assert np.count_nonzero(used["gate"] == 0) > 20
    joint_rad = used["joint_rad"][np.isfinite(used["joint_rad"])]
    assert len(joint_rad) > 100
    assert np.degrees(np.ptp(joint_rad)) > 20.0
    assert b"joint_1" in log.read("clock")["channel"]


def test_its_samples_are_timed_within_what_is_stated(flown: tuple[dict[str, Any], LogReader]) -> None:
    """Two lines wait for each poll, always for as long: without the polls they were 4 ms, 20 stated sigmas, late."""
    _, log = flown
    clock = log.read("clock")
    last = clock[clock["channel"] == b"joint_1"][-1]
    true_ns = VIRTUAL_START_NS + last["reference_tick"] * 5e6  # to 20e-6 of some seconds
    assert abs(last["reference_ns"] - true_ns) < 2.0 * last["sigma_ns"]
    assert last["sigma_ns"] < 4e6


def test_a_thermometers_rows_are_in_the_log_by_their_own_record(flown: tuple[dict[str, Any], LogReader]) -> None:
    result, log = flown
    rows, account = log.read("outside"), result["channels"]["outside"]
    assert len(rows) == account["recorded"] == account["produced"] > 80
    assert rows["temperature_k"] == pytest.approx(293.15 + 1e-3 * rows["sequence"])
    assert rows.dtype["humid"] == np.uint8


def test_a_thermometer_is_dumped_with_its_field_and_unit(toys: Path, flown: tuple[dict[str, Any], LogReader]) -> None:
    del flown
    said = heft(toys, "dump", "flight.mcap", "--to", "csv", "tables", "--channel", "outside")
    assert said.returncode == 0, said.stderr
    with next((toys / "tables").glob("*outside*.csv")).open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["temperature_k"]) for row in table[:3]] == pytest.approx([293.15, 293.151, 293.152])


def test_commands_know_its_kind_and_its_keys(toys: Path, flown: tuple[dict[str, Any], LogReader]) -> None:
    del flown
    said = heft(toys, "info", "flight.mcap")
    assert said.returncode == 0, said.stderr
    assert "line on the wire" in said.stdout
    path = toys / "mine" / "wrong.toml"
    wrong = (toys / "mine" / "vehicle.toml").read_text().replace("noise_rad = 4.0e-6", "noise_deg = 4.0e-6", 1)
    path.write_text(wrong)
    said = heft(toys, "preflight", str(path))
    line = next(n for n, text in enumerate(wrong.splitlines(), 1) if text.startswith("noise_deg"))
    assert f"wrong.toml:{line}: unknown key 'device.joint_1.noise_deg'; did you mean 'noise_rad'" in said.stderr


def test_without_its_package_the_vehicle_and_the_scenario_are_refused_by_kind(
    toys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process, which does not see it."""
    assert cli.main(["preflight", str(toys / "mine" / "vehicle.toml")]) != cli.OK
    assert '"toy_angle" is none of' in capsys.readouterr().err
    (tmp_path / "over.toml").write_text('[device.toy]\nkind = "toy_angle"\nbus = "i2c_1"\n')
    assert cli.main(["hil", "rocksat", "--scenario", str(tmp_path / "over.toml")]) != cli.OK
    assert "device.toy: no device is a 'toy_angle'; there are: arm_controller" in capsys.readouterr().err
