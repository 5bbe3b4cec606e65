"""Test beds: every one is a rehearsal of a packaged vehicle, and `heft hil` knows it by its name."""

from pathlib import Path

import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.planned import default_plan
from hil_sim.scenario import bed
from hil_sim.scenario.tables import ScenarioError
from onboard import config
from onboard.cli import main
from onboard.cli.hil import held_otherwise

BASES = {
    "air_bearing": "planar",
    "capture": "free",
    "dymaflex": "free",
    "dymaflex_wheels": "free",
    "fixed_arm": "fixed",
    "lab_ur": "fixed",
    "parabolic": "free",
    "spherical_bearing": "pivot",
    "student_arm": "fixed",
    "tumble": "free",
    "workshop": "fixed",
}


@pytest.mark.parametrize("name", bed.names())
def test_a_bed_is_the_rehearsal_of_a_packaged_vehicle(name: str) -> None:
    found = bed.find(name)
    assert found is not None
    assert found.vehicle.samefile(config.packaged(name))
    scenario = scenario_of(name)
    assert scenario.vehicle.base == BASES[name]
    assert not scenario.scenario.description.startswith("the rehearsal of")
    if name == "tumble":  # nothing is held: the body itself is drawn
        assert scenario.payload is None
        assert scenario.as_built["body"].inertia_relative > 0.1
        return
    assert scenario.payload is not None
    low, high = scenario.payload.mass_kg
    if name == "spherical_bearing":  # a known mass is set on, and the body itself is drawn
        assert low == high == 0.03
        assert scenario.as_built["platform"].inertia_relative == 0.1
        return
    assert low < high or (low == high == 5.0 and "dymaflex" in name)  # section 4.3: one payload, drawn elsewhere


@pytest.mark.parametrize("name", [*bed.names(), "rocksat"])
def test_a_bed_holds_its_payload_from_when_the_vehicle_file_states(name: str) -> None:
    assert list(held_otherwise(config.named(name), scenario_of(name))) == []


def test_a_payload_that_is_captured_tumbles() -> None:
    scenario = scenario_of("capture")
    assert scenario.capture is not None
    assert scenario.capture.rate_sigma_rad_s == 0.1
    assert scenario.capture.earliest_s < scenario.capture.latest_s


@pytest.mark.parametrize(("day", "runs", "slow"), [("day1", 32, 13), ("day2", 33, 0)])
def test_a_day_has_the_runs_of_table_4_4(day: str, runs: int, slow: int) -> None:
    scenario = scenario_of("parabolic", campaign=day)
    assert scenario.parabolas is not None
    strapped, *flown = scenario.parabolas.flown
    assert strapped is None
    assert len(flown) == runs
    assert sum(one is not None and one.speed == "slow" for one in flown) == slow
    moving = [step for step in scenario.sequence if step.action == "sweep"]
    assert len(moving) == runs + sum(one is not None and one.joints == "pitch_then_yaw" for one in flown)
    assert bed.campaigns("capture") == ()
    with pytest.raises(ScenarioError, match=r"no campaign .day3.: .*parabolic has day1, day2"):
        scenario_of("parabolic", campaign="day3")


@pytest.mark.parametrize("joints", ["pitch", "yaw", "both"])
def test_the_table_is_run_at_three_speeds(joints: str) -> None:
    scenario = scenario_of("air_bearing", campaign=joints)
    assert scenario.backlash is not None
    moved = [step.rates for step in scenario.sequence if step.action == "sweep"]
    assert len(moved) == 3
    slow, _, fast = ({name: abs(rate) for name, rate in one.items()} for one in moved)
    assert all(fast[name] == pytest.approx(5.0 * slow[name], rel=0.02) for name in slow)
    plan = default_plan(scenario, 0.05)
    assert abs(plan.dq).max() == pytest.approx(max(fast.values()), rel=0.01)
    assert abs(plan.q[0] - plan.q[-1]).max() < 1e-9


def test_a_wheel_runs_by_its_sweep_and_does_not_swing(tmp_path: Path) -> None:
    scenario = scenario_of("tumble")
    plan = default_plan(scenario, 0.01)
    assert abs(plan.dq).max() == pytest.approx(1250.0)
    assert abs(plan.q[0] - plan.q[-1]).max() < 1e-9
    over = tmp_path / "over.toml"
    over.write_text('[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 5.0\n')
    swinging = scenario_of("tumble", over)
    assert not default_plan(swinging, 0.01).dq.any()


def test_other_names_are_no_beds() -> None:
    assert bed.find("rocksat") is None
    assert bed.find("../packaged/rocksat") is None


def test_a_scenario_file_lies_over_a_bed(tmp_path: Path) -> None:
    over = tmp_path / "over.toml"
    over.write_text("payload.mass_kg = [2.5, 2.5]\n")
    scenario = scenario_of("fixed_arm", over)
    assert scenario.payload is not None
    assert scenario.payload.mass_kg == (2.5, 2.5)
    over.write_text("[vehicle]\nbase = 'free'\n")
    with pytest.raises(ScenarioError, match=r"over.toml: \[vehicle\] is the vehicle file's"):
        scenario_of("fixed_arm", over)


def test_hil_flies_beds_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hil", "fixed_arm", "--faults"]) == 0
    assert "a6" in capsys.readouterr().out
    assert main(["hil", "air_baering"]) == 2
    assert "did you mean 'air_bearing'" in capsys.readouterr().err
    assert main(["hil", "dymaflex_air_bearing"]) == 2
    said = capsys.readouterr().err
    assert all(name in said for name in (*bed.names(), "rocksat", "columns of a recording"))


def test_a_packaged_scenario_that_was_copied_whole_does_not_bring_its_drawing_along(tmp_path: Path) -> None:
    """``heft hil rocksat --scenario COPY.toml`` had said that rocksat.urdf is no XML."""
    over = tmp_path / "copy.toml"
    over.write_text((Path(bed.__file__).with_name("packaged") / "rocksat.toml").read_text())
    with pytest.raises(ScenarioError, match=r"copy\.toml: \[vehicle\] is the vehicle file's; take it out"):
        scenario_of("rocksat", over)
