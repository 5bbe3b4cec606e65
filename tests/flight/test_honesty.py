"""Instruments that lie, flown: the answer is right, or none is given, and the log says which instrument and why.

``docs/honesty.md`` has the whole table; ``bench/plans/honesty.toml`` is the campaign that a slice of is flown here.
"""

from pathlib import Path
from typing import Any

import pytest

from bench.honest_flights.drawn import MISSION
from bench.honest_flights.flown import flight
from hil_sim.scenario.load import load
from onboard import config
from onboard.estimation.gates import GateReason
from onboard.ground.identify.identify import identify
from tests.flight.missions import BRIEF, Result, fly

SEED = 5
SHORT = [MISSION[0], MISSION[3] | {"strokes": 5}, *MISSION[4:6], *MISSION[8:]]  # 12 s: the fast sweeps


def lied_to(path: Path, vehicle: str, *faults: dict[str, Any], sequence: list[dict[str, Any]] = SHORT) -> Result:
    return fly(path / "log.mcap", SEED, load(vehicle, {"sequence": sequence, "fault": list(faults)}), vehicle)


def fault(kind: str, device: str, value: float = 0.0, start_s: float = 0.5, **end: float) -> dict[str, Any]:
    return {"kind": kind, "device": device, "value": value, "start_s": start_s, **end}


def standings(flown: Result) -> set[str]:
    return {row["standing"].split(":")[0].split(";")[0] for row in (*flown.table["masses"], *flown.table["inertias"])}


def test_a_cell_that_is_stuck_gives_no_answer_and_says_so(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("stuck", "load_cell"), sequence=BRIEF)
    assert not any(mass["supported"] for mass in flown.table["masses"])
    assert any(said.startswith("load_cell: ") for said in flown.events("stuck"))
    gates = flown.log.read("row")["gate"]
    assert (gates & int(GateReason.STUCK) != 0).mean() > 0.9


def test_a_scale_that_jumps_in_mid_flight_withdraws_the_answers(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "load_cell", 0.1, 5.0))
    assert standings(flown) == {"do not use"}
    assert not any(mass["supported"] for mass in flown.table["masses"])
    assert any("load_cell reads +" in said for said in flown.events("withdrawn"))


def test_an_encoder_that_becomes_another_one_when_enough_was_seen_leaves_answers_of_before(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "joint_1", 0.3, 7.5))
    [said] = flown.events("angle_jumped")
    assert said.endswith("no row from there on is used")
    [held] = [one for one in flown.table["inertias"] if one["quantity"] == "ZZ_joint_1_R_held"]
    assert held["low"] < held["truth"] < held["high"]
    assert held["high"] - held["low"] < 0.15 * held["truth"]
    assert held["standing"].startswith("weak: joint_1: its angle jumps between two samples")


@pytest.mark.campaign  # later: above; at any time: test_jump_watch
def test_an_encoder_that_becomes_another_one_early_leaves_no_answer(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "joint_1", 0.3, 3.62))
    [said] = flown.events("angle_jumped")
    assert said.startswith("joint_1: its angle jumps by +3")
    assert not any(row["supported"] for row in (*flown.table["masses"], *flown.table["inertias"]))
    log = flown.log
    [verdict] = (one.verdict for one in identify(config.load(config.packaged("rocksat")), [log]).logs)
    assert any("angle of a joint jumps" in reason for reason in verdict.reasons)
    gates, at_ns = (log.read("row")[field] for field in ("gate", "vehicle_ns"))
    after = at_ns > flown.flown.truth["start_ns"] + 3_770_000_000
    assert (gates[after] & int(GateReason.JUMPED)).all()


@pytest.mark.campaign  # of rows: test_drawing
def test_a_cell_at_half_its_scale_is_told_by_the_drawn_arm(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "load_cell", -0.5, 0.0))
    assert standings(flown) == {"do not use"}
    assert "check load_cell scale_sigma" in flown.mass("m_arm")["standing"]
    assert not any(mass["supported"] for mass in flown.table["masses"])


def test_an_answer_says_which_calibration_it_leans_on(mission: Result) -> None:
    tip = mission.mass("m_tip_mass")
    assert tip["supported"]
    assert tip["leans"].startswith("leans on load_cell scale_sigma and lever_sigma_m 0.354 %, joint_1 scale_sigma 0.05")


def test_an_imu_that_warms_up_does_not_cost_the_answers(tmp_path: Path) -> None:
    """By 40 K: where its offset is not followed, 84 % of the rows are refused as drag, and nothing is answered."""
    warm = {"sensor": {"imu": {"temperature_rise_K": 40.0, "temperature_time_s": 10.0}}}
    flown = fly(tmp_path / "log.mcap", 3012, load("rocksat", {"sequence": SHORT, **warm}))
    assert all(mass["supported"] and mass["covered"] for mass in flown.table["masses"])
    rows = flown.log.read("row")
    later = rows["vehicle_ns"] > flown.flown.truth["start_ns"] + 3_000_000_000
    assert (rows["gate"][later] & int(GateReason.DRAG) != 0).mean() < 0.05


@pytest.mark.campaign  # a scale as the half of it
def test_a_cell_of_the_wrong_sign_finds_no_body(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "load_cell", -2.0, 0.0))
    assert standings(flown) == {"do not use"}
    assert "m_arm is -0.2" in flown.mass("m_tip_mass")["standing"]


@pytest.mark.campaign  # of rows: test_cells_and_releases
def test_a_release_that_is_told_by_a_glitch_is_outvoted_and_the_true_one_is_not(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat", fault("wrong", "arm_phase", 1.0, 3.5, end_s=4.0))
    assert len(flown.events("release_contradicted")) == 1
    assert all(mass["supported"] and mass["covered"] for mass in flown.table["masses"])


@pytest.mark.campaign  # of rows: test_cells_and_releases; one of two in flight: test_fault_matrix
@pytest.mark.parametrize(
    ("kind", "value", "code"),
    [("stuck", 0.0, "stuck"), ("wrong", -2.0, "left_out")],
)
def test_of_two_cells_the_one_that_lies_is_named_and_the_other_answers(
    tmp_path: Path, kind: str, value: float, code: str
) -> None:
    flown = lied_to(tmp_path, "rocksat_mixed", fault(kind, "load_cell_2", value, 0.0 if value else 0.5))
    assert any("load_cell_2" in said for said in flown.events(code))
    assert all(mass["supported"] and mass["covered"] for mass in flown.table["masses"])


def test_a_slice_of_the_campaign_holds_no_confident_nonsense() -> None:
    flown = flight(4002, {})
    assert flown.answers
    assert not flown.nonsense


@pytest.mark.campaign  # of rows: test_cells_and_releases
def test_of_two_cells_that_differ_by_5_percent_the_answer_holds_both_and_identify_says_it_too(tmp_path: Path) -> None:
    flown = lied_to(tmp_path, "rocksat_mixed", fault("wrong", "load_cell", 0.05, 0.0))
    assert all(mass["supported"] and mass["covered"] for mass in flown.table["masses"])
    said = "load_cell and load_cell_2 contradict each other: "
    assert flown.mass("m_tip_mass")["standing"].startswith(f"weak: {said}")
    [verdict] = (one.verdict for one in identify(config.load(config.packaged("rocksat_mixed")), [flown.log]).logs)
    assert any(reason.startswith(said) for reason in verdict.reasons)
