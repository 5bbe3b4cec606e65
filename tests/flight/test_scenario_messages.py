"""What is wrong in a scenario file is told as in a vehicle file: line, key, the nearest known one, in our words."""

import re
from pathlib import Path

import pytest

from onboard import cli

WRONG = """[physics]
step_us = "fast"
gravity_m_s2 = 9.81
integration_steps = 1.5

[paylod]
mass_kg = 5

[payload]
mass_kg = [1, 2, 3]
size_mm = true

[release]
rate_rads = 0.1
velocity_m_s = inf

[[sequence]]
phase = 1
action = "swingg"
duration_s = -3
joints = { a = 1 }

[bus.can_0]
kind = "cann"
[sensor.imu_base]
quantity = "inertal"
[as_built]
link_1 = 3
"""
TOLD = {
    2: r"'physics.step_us': a whole number is wanted here \(found \"fast\"\)",
    3: r"'physics.gravity_m_s2': a list is wanted here, like \[1, 2\] \(found 9.81\)",
    4: r"'physics.integration_steps': a whole number is wanted here \(found 1.5\)",
    6: "unknown key 'paylod'; did you mean 'payload'",
    10: "'payload.mass_kg': 2 values at the most are wanted here",
    11: "'payload.size_mm': a list is wanted here",
    14: "unknown key 'release.rate_rads'; did you mean 'rate_rad_s'",
    15: "'release.velocity_m_s': a finite number is wanted here",
    19: "'sequence.0.action': \"swingg\" is none of hold, swing, .* did you mean 'swing'",
    20: r"'sequence.0.duration_s': more than 0 is wanted here \(found -3\)",
    21: "unknown key 'sequence.0.joints'",
    24: "'bus.can_0.kind': \"cann\" is none of i2c, can, pulse, serial, tcp; did you mean 'can'",
    26: "'sensor.imu_base.quantity': \"inertal\" is none of .* did you mean 'inertial'",
    28: "'as_built.link_1': a table is wanted here",
}


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("mine") / "v"
    assert cli.main(["init", str(directory), "--base", "free"]) == cli.OK
    return directory / "vehicle.toml"


def told(vehicle: Path, text: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    over = vehicle.parent / "wrong [1] \xe9.toml"
    over.write_text(text, encoding="utf-8")
    assert cli.main(["hil", str(vehicle), "--scenario", str(over), "--faults"]) == cli.BAD_INPUT
    said = capsys.readouterr().err
    assert not re.search(r"Input should|not permitted|valid tuple|Value error|after validation", said)
    return said.replace(f"{over}:", "over:").removeprefix("heft: ").splitlines()


def test_each_mistake_is_told_with_its_line(vehicle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(vehicle, WRONG, capsys)
    found = {int(line.split(":")[1]): line for line in lines}
    assert sorted(found) == sorted(TOLD)
    assert len(lines) == len(TOLD)
    for number, says in TOLD.items():
        assert re.match(f"over:{number}: {says}", found[number])


def test_keys_of_a_device_are_told_so_too(vehicle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = told(vehicle, "\n[device.imu_base]\nadress = 3\n", capsys)
    assert line.startswith("over:3: unknown key 'device.imu_base.adress'; did you mean 'address'?")


def test_what_is_missing_is_told_with_the_line_of_its_table(vehicle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(vehicle, "\n[[sequence]]\nphase = 1\n", capsys)
    assert "over:2: 'sequence.0.action' is missing; add it" in lines
    assert all(line.startswith("over:2: ") for line in lines)


@pytest.mark.parametrize("mission", ["rocksat", "rocksat_mixed", "dymaflex", "capture"])
def test_a_packaged_mission_is_not_blamed_for_the_file_over_it(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    over = tmp_path / "over.toml"
    over.write_text('sequenc = []\n\n[[sequence]]\nphase = 0\naction = "hold"\nspin = 1\nduration_s = -3\n')
    assert cli.main(["hil", mission, "--scenario", str(over), "--faults"]) == cli.BAD_INPUT
    lines = capsys.readouterr().err.removeprefix("heft: ").splitlines()
    assert f"{over}:1: unknown key 'sequenc'; did you mean 'sequence'? Units are in the key" in lines
    assert f"{over}:7: 'sequence.0.duration_s': more than 0 is wanted here (found -3)" in " ".join(lines)
    assert any(line.startswith(f"{over}:6: unknown key 'sequence.0.spin'") for line in lines)
