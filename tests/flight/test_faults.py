"""Devices that are not there or not what they should be: named, and the rest of the mission goes on."""

from pathlib import Path

import pytest

from hil_sim.scenario.load import load
from tests.flight.missions import BRIEF, SHORT, Result, fly


def fly_with(
    path: Path, *faults: dict[str, object], seed: int = 3, sequence: list[dict[str, object]] = SHORT
) -> Result:
    return fly(path, seed, load("rocksat", {"sequence": sequence, "fault": list(faults)}))


def test_the_short_mission_is_identified_when_nothing_is_wrong(short_mission: Result) -> None:
    assert short_mission.table["identified"]
    assert short_mission.table["accounted"]
    assert short_mission.table["events"] == []
    assert abs(short_mission.mass("m_tip_mass")["our_error_percent"]) < 5.0


@pytest.mark.parametrize(
    ("fault", "code", "text"),
    [
        ({"kind": "who_am_i", "device": "imu_base", "start_s": 0.0, "value": 0x42}, "wrong_device", "0x42"),
        pytest.param(
            {"kind": "nack", "device": "imu_base", "start_s": 0.0}, "no_answer", "0x68", marks=pytest.mark.campaign
        ),
    ],
)
def test_an_imu_that_is_wrong_or_silent_is_named_and_the_log_goes_on(
    tmp_path: Path, fault: dict[str, object], code: str, text: str
) -> None:
    result = fly_with(tmp_path / "log.mcap", fault, sequence=BRIEF)
    said = result.events(code)
    assert said
    assert said[0].startswith("imu_base: ")
    assert text in said[0]
    assert result.table["channels"]["imu_base"]["recorded"] == 0
    assert result.table["channels"]["load_cell"]["recorded"] > 1500
    assert not result.table["identified"]  # without base motion there is no row, and so no answer
    assert [mass["supported"] for mass in result.table["masses"]] == [False] * 3


def test_a_missing_load_cell_is_named_and_nothing_is_made_up(tmp_path: Path) -> None:
    result = fly_with(tmp_path / "log.mcap", {"kind": "off", "device": "load_cell", "start_s": 0.0}, sequence=BRIEF)
    assert any(said.startswith("load_cell: ") for said in result.events("no_answer"))
    assert result.table["channels"]["imu_base"]["recorded"] > 5_000
    assert result.table["channels"]["joint_1"]["recorded"] > 1000
    assert not result.table["identified"]


@pytest.mark.campaign  # times without a pulse: check/test_preflight; answers: test_ur_arm
def test_without_pulses_the_mission_is_still_identified(tmp_path: Path) -> None:
    """Arrival stamps are a worse clock, and the sweep of one joint forgives a few milliseconds."""
    result = fly_with(tmp_path / "log.mcap", {"kind": "pulse_drop", "device": "sync_line", "start_s": 0.0})
    assert result.table["channels"]["pulse"]["recorded"] == 0
    assert result.table["identified"]
    assert abs(result.mass("m_tip_mass")["our_error_percent"]) < 5.0


@pytest.mark.campaign  # of an encoder: test_fault_matrix; of IMUs: test_i2c_devices, test_bmi088_flight
def test_a_brown_out_of_the_imu_is_a_gap_and_the_answer_survives(tmp_path: Path) -> None:
    fault = {"kind": "reset", "device": "imu_base", "start_s": 6.0, "end_s": 6.2}
    result = fly_with(tmp_path / "log.mcap", fault)
    assert result.table["channels"]["imu_base"]["missing"] > 100
    assert result.table["identified"]
    assert abs(result.mass("m_tip_mass")["our_error_percent"]) < 5.0


@pytest.mark.campaign  # on another mission: test_fault_campaign
def test_lost_frames_are_gaps_that_add_up(tmp_path: Path) -> None:
    fault = {"kind": "frame_drop", "device": "can_0", "start_s": 7.0, "end_s": 7.05, "value": 0x182}
    result = fly_with(tmp_path / "log.mcap", fault)
    cell = result.table["channels"]["load_cell"]
    assert cell["missing"] in (10, 11)  # 50 ms at 200 Hz
    assert result.table["accounted"]
    assert result.table["identified"]
