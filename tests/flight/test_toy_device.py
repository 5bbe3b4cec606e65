"""A kind of device from outside the package, found by its entry points, measures the joint of a whole flight.

The toy package of ``tests/flight/toy`` is laid out as an installed distribution in a directory of its own. Nothing of
heft names it.
"""

import json
import os
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from onboard import config
from onboard.recording.reader import LogReader
from tests.flight.missions import inline
from tests.flight.test_scenarios import SHORT

ROOT = Path(__file__).parents[2]
TOY = Path(__file__).with_name("toy")
ENTRY_POINTS = """\
[heft.devices]
toy_angle = toy_angle.device:ToyAngleDevice
[heft.emulators]
toy_angle = toy_angle.emulator:ToyAngleTable
"""
VEHICLE_JOINT = """
[bus.tty_toy]
url = "serial:///dev/ttyUSB0?baud=115200"

[device.joint_1]
kind = "toy_angle"
bus = "tty_toy"
joint = "joint_1"
noise_rad = 4.0e-6

"""
SCENARIO_JOINT = """
[bus.tty_toy]
kind = "serial"

[clock.joint_1]
rate_sigma = 20.0e-6
rate_limit = 50.0e-6
drift_sigma_per_s = 1.0e-9

[device.joint_1]
kind = "toy_angle"
bus = "tty_toy"
at = "joint_1"
measures = "encoder"

"""


class Toys(NamedTuple):
    """Files of a flight with the toy, and the environment in which it is installed."""

    directory: Path
    vehicle: Path
    scenario: Path
    environment: dict[str, str]

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *arguments],
            env=self.environment,
            cwd=self.directory,
            capture_output=True,
            text=True,
            check=False,
        )


def replaced(text: str, header: str, other: str) -> str:
    """A TOML text with another table in the place of one."""
    start = text.index(header)
    end = text.find("\n[", start)
    return text[:start] + other + (text[end + 1 :] if end > 0 else "")


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> Toys:
    directory = tmp_path_factory.mktemp("toys")
    site = directory / "site"
    shutil.copytree(TOY, site / "toy_angle", ignore=shutil.ignore_patterns("__pycache__"))
    information = site / "toy_angle-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-angle\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(ENTRY_POINTS)
    packaged = config.packaged("rocksat")
    shutil.copy(packaged.parent / "rocksat.urdf", directory)
    vehicle, scenario = directory / "vehicle.toml", directory / "toy.toml"
    vehicle.write_text(replaced(packaged.read_text(), "[device.joint_1]", VEHICLE_JOINT))
    text = (resources.files("hil_sim.scenario") / "packaged" / "rocksat.toml").read_text()
    text = replaced(text, "[device.joint_1]", SCENARIO_JOINT)
    first, last = text.index("[[sequence]]"), text.index("[sensor.imu]")
    steps = ",\n".join(inline(step) for step in SHORT["sequence"])
    sequence = f"sequence = [\n{steps},\n]\n"
    scenario.write_text(sequence + text[:first] + text[last:])
    return Toys(directory, vehicle, scenario, {**os.environ, "PYTHONPATH": f"{site}:{ROOT}"})


@pytest.fixture(scope="module")
def flown(toys: Toys) -> tuple[dict[str, Any], LogReader]:
    log = toys.directory / "flight.mcap"
    done = toys.run(str(TOY / "fly.py"), str(toys.scenario), str(toys.vehicle), str(log))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), LogReader(log)


def test_its_samples_are_in_the_log_and_accounted_for(flown: tuple[dict[str, Any], LogReader]) -> None:
    result, log = flown
    assert result["accounted"], result["channels"]
    rows = np.concatenate([rows for channel, rows in log.batches() if channel == "joint_1"])
    assert len(rows) == result["channels"]["joint_1"]["recorded"] > 1000
    assert set(rows["unit"]) == {b"rad"}
    swept_rad = np.ptp(rows["value_raw"] * rows["scale"])
    assert np.degrees(swept_rad) > 20.0  # amplitude 11.5 deg


def test_it_is_estimated_with(flown: tuple[dict[str, Any], LogReader]) -> None:
    """Its role and its clock reach the estimator: there are rows, which need the joint's angle on vehicle time."""
    _, log = flown
    made: dict[str, list[np.ndarray]] = {}
    for channel, rows in log.batches():
        made.setdefault(channel, []).append(rows)
    used = np.concatenate(made["row"])
    assert np.count_nonzero(used["gate"] == 0) > 20
    joint_rad = used["joint_rad"][np.isfinite(used["joint_rad"])]
    assert len(joint_rad) > 100
    assert np.degrees(np.ptp(joint_rad)) > 20.0
    clock = np.concatenate(made["clock"])
    assert b"joint_1" in clock["channel"]


def test_its_samples_are_timed_within_what_is_stated(flown: tuple[dict[str, Any], LogReader]) -> None:
    """Two lines wait for each poll, always for as long: without the polls they were 4 ms, 20 stated sigmas, late."""
    result, log = flown
    clock = np.concatenate([rows for channel, rows in log.batches() if channel == "clock"])
    last = clock[clock["channel"] == b"joint_1"][-1]
    true_ns = result["start_ns"] + last["reference_tick"] * 5e6  # to 20e-6 of some seconds
    assert abs(last["reference_ns"] - true_ns) < 2.0 * last["sigma_ns"]
    assert last["sigma_ns"] < 4e6


def test_commands_know_its_kind_and_its_keys(toys: Toys) -> None:
    log = toys.directory / "flight.mcap"
    said = toys.run("-m", "onboard.cli", "info", str(log))
    assert said.returncode == 0, said.stderr
    assert "line on the wire" in said.stdout
    wrong = toys.vehicle.read_text().replace("noise_rad = 4.0e-6", "noise_deg = 4.0e-6", 1)
    path = toys.directory / "wrong.toml"
    path.write_text(wrong)
    said = toys.run("-m", "onboard.cli", "preflight", str(path))
    line = next(n for n, text in enumerate(wrong.splitlines(), 1) if text.startswith("noise_deg"))
    assert f"wrong.toml:{line}: unknown key 'device.joint_1.noise_deg'; did you mean 'noise_rad'" in said.stderr


def test_without_its_package_the_vehicle_and_the_scenario_are_refused_by_kind(toys: Toys) -> None:
    bare = toys._replace(environment={**toys.environment, "PYTHONPATH": str(ROOT)})
    said = bare.run("-m", "onboard.cli", "preflight", str(toys.vehicle))
    assert said.returncode != 0
    assert '"toy_angle" is none of' in said.stderr
    said = bare.run(str(TOY / "fly.py"), str(toys.scenario), str(config.packaged("rocksat")), "none.mcap")
    assert "device.joint_1: no device is a 'toy_angle'; there are: arm_controller" in said.stderr
