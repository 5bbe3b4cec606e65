"""A student's arm: four servos on one line, an IMU and a load cell on one I2C bus; flown in virtual time."""

import json
from pathlib import Path

import pytest

from onboard import config
from onboard.cli import OK, main
from onboard.flight.estimate.problem.identification import build_identifier
from tests.flight.missions import Result, fly

HELD = {"mass_kg": [0.25, 0.25], "size_mm": [60, 50, 50], "centre_of_mass_mm": [4, -6, 28]}
SERVOS = [f"joint_{k}" for k in range(1, 5)]


def flown(path: Path, swing_s: float, *faults: dict[str, object]) -> Result:
    """The packaged mission, shorter, with 250 g."""
    steps = ((0, "hold", 1.0), (1, "swing", swing_s), (9, "hold", 0.5))
    sequence = [{"phase": phase, "action": action, "duration_s": lasts} for phase, action, lasts in steps]
    return fly(path / "arm.mcap", vehicle="student_arm", payload=HELD, sequence=sequence, fault=list(faults))


def mass(run: Result) -> dict[str, float]:
    """Answers on the payload's mass."""
    [row] = [row for row in run.table["parameters"] if row["quantity"] == "M_payload"]
    return row


@pytest.mark.campaign  # servos' currents: test_servo_arm; a cell: test_workshop; a width asked for: test_verdict
def test_a_payload_is_weighed_on_board_and_from_the_log(tmp_path: Path) -> None:
    run = flown(tmp_path, 7.5)
    assert run.table["accounted"]
    told = mass(run)
    assert told["truth"] == 0.25
    assert told["low"] < 0.25 < told["high"]
    assert abs(told["value"] / 0.25 - 1.0) < 0.03
    assert 0.0 < told["high"] - told["low"] < 0.025
    currents = [channel for channel in run.log.channels if channel.endswith("_torque")]
    assert currents == [f"{joint}_torque" for joint in SERVOS]
    assert main(["init", str(tmp_path / "mine"), "--from", "student_arm"]) == OK
    file, answer = tmp_path / "mine/vehicle.toml", tmp_path / "answer.json"
    assert told["standing"].startswith("good")
    file.write_text(f"{file.read_text()}\n[estimation.useful]\nmass = 0.01\n")
    assert main(["identify", str(run.path), "--vehicle", str(file), "--json", str(answer)]) == OK
    [log] = json.loads(answer.read_text())["logs"]
    assert log["verdict"]["level"] == "weak"
    [reason] = log["verdict"]["reasons"]  # it would be good but for the width that is asked for
    assert reason.startswith("M_payload: its interval is as wide as")


@pytest.mark.campaign  # servos: test_servos; a cell: above; an IMU: test_bmi088_flight
def test_what_is_unplugged_for_a_while_costs_its_rows_and_no_more(tmp_path: Path) -> None:
    """A servo, then the cell, then the IMU: each is named, comes back, and the mass stays inside its interval."""
    away = [("joint_3", 1.5, 2.2), ("load_cell", 3.0, 3.7), ("imu_base", 4.5, 5.2)]
    run = flown(tmp_path, 6.0, *({"kind": "off", "device": d, "start_s": a, "end_s": b} for d, a, b in away))
    assert run.table["accounted"]
    assert any(text.startswith("joint_3: ") for text in run.events("silent"))
    assert any(text.startswith("joint_3: ") for text in run.events("recovered"))
    told = mass(run)
    assert told["low"] < 0.25 < told["high"]


def test_what_calibration_leaves_of_the_accelerometer_is_part_of_the_weight() -> None:
    """Its bias is gravity's error on a base that stands, too."""
    identifier, _ = build_identifier(config.load(config.packaged("student_arm")))
    keys = [cause.key for cause in identifier.considered]
    assert keys.count("imu_prior.accelerometer_bias_m_s2") == 3
    assert keys.count("imu_prior.gyro_bias_rad_s") == 3
