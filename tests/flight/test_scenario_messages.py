"""What is wrong in a scenario file is reported as in a vehicle file: line, key, the nearest known one, in our words."""

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
    2: r"'physics.step_us': a whole number is wanted here \(given: \"fast\"\)",
    3: r"'physics.gravity_m_s2': a list is wanted here, like \[1, 2\] \(given: 9.81\)",
    4: r"'physics.integration_steps': a whole number is wanted here \(given: 1.5\)",
    6: "unknown key 'paylod'; did you mean 'payload'",
    10: "'payload.mass_kg': 2 values at the most are wanted here",
    11: "'payload.size_mm': a list is wanted here",
    14: "unknown key 'release.rate_rads'; did you mean 'rate_rad_s'",
    15: "'release.velocity_m_s': a finite number is wanted here",
    19: "'sequence.0.action': \"swingg\" is none of hold, swing, .* did you mean 'swing'",
    20: r"'sequence.0.duration_s': more than 0 is wanted here \(given: -3\)",
    21: "unknown key 'sequence.0.joints'",
    24: "'bus.can_0.kind': \"cann\" is none of i2c, can, pulse, pair, spi, serial, tcp, udp; did you mean 'can'",
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


CAUGHT = "[capture]\nearliest_s = 9.0\nlatest_s = 9.0\n"


def test_what_is_wrong_between_tables_is_told_without_them(vehicle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = told(vehicle, CAUGHT.replace("9.0", "900.0"), capsys)
    assert re.fullmatch("over:1: capture must lie between earliest_s and latest_s, .* before the end, 29 s", line)


@pytest.mark.parametrize(
    ("over", "stated", "warned"),
    [
        (CAUGHT, "true", "held from the start: expect a wrong answer; state [estimation.exiddm] held_at_start = false"),
        ("capture = false\n", "false", "waits for a capture: expect no answer; state"),
        ("capture = false\n", "true", ""),
        (CAUGHT, "false", ""),
        ("payload = false\ncapture = false\n", "false", ""),
    ],
)
def test_a_payload_that_is_held_otherwise_than_the_vehicle_file_states(
    over: str, stated: str, warned: str, vehicle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = vehicle.parent / "over.toml", vehicle.parent / "other.toml"
    seconds = 10.0 if over == CAUGHT else 1.0
    path.write_text(f'{over}\n[[sequence]]\nphase = 1\naction = "hold"\nduration_s = {seconds}\n')
    file.write_text(vehicle.read_text().replace("held_at_start = true", f"held_at_start = {stated}"))
    assert cli.main(["hil", str(file), "--scenario", str(path), "--faults"]) == cli.OK
    said = capsys.readouterr().err
    assert said.startswith("heft: warning: the scenario ") == bool(warned)
    assert warned in said


def test_a_payload_that_is_taken_at_a_phase(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The file says from which phase on it is held; a scenario's sequence has to have it, and its capture."""
    path = tmp_path / "over.toml"
    step = '[[sequence]]\nphase = {}\naction = "hold"\nduration_s = 5.0\n'
    for over, fits in (
        (step.format(0) + step.format(2), True),
        (step.format(0) + step.format(1), False),
        (CAUGHT, False),
        ("[capture]\nphase = 1\n", False),
    ):
        path.write_text(over)
        assert cli.main(["hil", "workshop", "--scenario", str(path), "--faults"]) == cli.OK
        assert ("does not catch the payload at phase 2, from which on" in capsys.readouterr().err) != fits


@pytest.mark.parametrize("mission", ["rocksat", "rocksat_mixed", "dymaflex", "capture"])
def test_a_packaged_mission_is_not_blamed_for_the_file_over_it(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    over = tmp_path / "over.toml"
    over.write_text('sequenc = []\n\n[[sequence]]\nphase = 0\naction = "hold"\nspin = 1\nduration_s = -3\n')
    assert cli.main(["hil", mission, "--scenario", str(over), "--faults"]) == cli.BAD_INPUT
    lines = capsys.readouterr().err.removeprefix("heft: ").splitlines()
    assert f"{over}:1: unknown key 'sequenc'; did you mean 'sequence'? Units are in the key" in lines
    assert f"{over}:7: 'sequence.0.duration_s': more than 0 is wanted here (given: -3)" in " ".join(lines)
    assert any(line.startswith(f"{over}:6: unknown key 'sequence.0.spin'") for line in lines)
