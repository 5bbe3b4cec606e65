"""Vehicles that are not packaged, from ``heft init`` and a URDF to a rehearsed answer."""

import json
import shutil
from pathlib import Path

import pytest

from onboard.cli import main

OWN = Path(__file__).with_name("own")
FOUR_SIGMA = 4.0  # of answers that share their data, one in some hundred flights has one beyond


def rehearsed(directory, init, over="", seed=1):
    """The result of ``heft hil`` of a vehicle made by ``heft init``, and its exit code."""
    vehicle, result = directory / "mine", directory / f"result_{seed}.json"
    if not vehicle.exists():
        assert main(["init", str(vehicle), *init]) == 0
    scenario = directory / "over.toml"
    scenario.write_text(over)
    log = directory / f"flight_{seed}.mcap"
    asked = ["hil", str(vehicle / "vehicle.toml"), "--seed", str(seed), "--scenario", str(scenario)]
    code = main([*asked, "--json", str(result), "--log", str(log)])
    return json.loads(result.read_text()), code


def answers(result):
    """Rows of the table by quantity."""
    return {row["quantity"]: row for key in ("masses", "centres", "inertias", "parameters") for row in result[key]}


def honest(rows):
    """Each answer is right within four sigmas; what is not answered is weak."""
    for row in rows.values():
        if row["supported"]:
            assert abs(row["value"] - row["truth"]) < FOUR_SIGMA * row["sigma"], row
        else:
            assert row["standing"].startswith("weak"), row
            assert row["value"] is None


PAYLOAD = "[payload]\nmass_kg = [3.0, 6.0]\n"
SWING = """
[[sequence]]
phase = 1
action = "hold"
duration_s = 2.0
[[sequence]]
phase = 1
action = "swing"
duration_s = 10.0
band_Hz = [0.2, 1.0]
"""
SHORTER = SWING.replace("duration_s = 10.0", "duration_s = 6.0")


@pytest.mark.campaign  # such a one: test_joint_torques; its rehearsal: the body below; the forecast: test_foresee
def test_a_free_flyer_of_one_s_own(tmp_path, capsys):
    result, code = rehearsed(tmp_path, ["--base", "free", "--joints", "3"], PAYLOAD + SHORTER, seed=2)
    rows = answers(result)
    assert code == 0
    assert result["accounted"]
    assert rows["m_payload"]["supported"]
    assert abs(rows["m_payload"]["our_error_percent"]) < 10.0
    honest(rows)
    said = capsys.readouterr().out
    assert said.index("expected of this motion") < said.index("rehearsed (seed 2)")
    expected = {one["name"]: one["sigma"] for one in result["expected"]}
    assert expected["m_payload"] == pytest.approx(rows["m_payload"]["sigma"], rel=0.7)


@pytest.mark.campaign  # weak of what is not determined: the spinning body
def test_a_planar_arm_without_a_load_cell(tmp_path):
    """Both axes are parallel: what turns about them is determined, and nothing is claimed of the rest."""
    result, code = rehearsed(tmp_path, ["--base", "free", "--urdf", str(OWN / "planar_arm.urdf")], SWING, seed=2)
    rows = answers(result)
    assert code == 0
    assert result["accounted"]
    honest(rows)
    assert rows["m_payload"]["supported"]
    weak = [name for name, row in rows.items() if row["standing"].startswith("weak")]
    assert weak
    assert not any("converge" in row["standing"] for row in rows.values())


def test_a_light_robot_on_a_table(tmp_path):
    """Which its arm turns about: from none of the guesses does a fit of all its unknowns lead to the minimum."""
    result, code = rehearsed(tmp_path, ["--base", "planar", "--joints", "2"], seed=3)
    rows = answers(result)
    assert code == 0
    honest(rows)
    assert rows["m_payload"]["supported"]


BENCH = """
[[sequence]]
phase = 0
action = "hold"
duration_s = 1.0
[[sequence]]
phase = 1
action = "swing"
duration_s = 5.0
"""


REST_AND_MOTION = """
[[sequence]]
phase = 1
action = "hold"
duration_s = 3.0
[[sequence]]
phase = 1
action = "swing"
duration_s = 6.0
"""


@pytest.mark.campaign  # rest and motion with other devices: test_as5048_flight, test_i2c_devices
def test_an_arm_with_a_cell_that_rests_before_it_moves(tmp_path):
    """Was refused: "load_cell reads -18% of the motion from one time on". A resting encoder has no noise."""
    result, code = rehearsed(
        tmp_path, ["--base", "fixed", "--joints", "2", "--load-cell", "cia404"], REST_AND_MOTION, seed=3
    )
    rows = answers(result)
    assert code == 0
    honest(rows)
    assert rows["MY_payload"]["supported"]


@pytest.mark.campaign  # currents and friction: test_lab_arm, test_servo_arm; a URDF of its own: above
def test_a_six_joint_arm_on_a_bench_by_the_currents_of_its_motors(tmp_path):
    """Torques of CiA 402 drives in gravity: friction and the groups that gravity and motion determine."""
    init = ["--base", "fixed", "--encoder", "cia402", "--urdf", str(OWN / "bench_arm.urdf")]
    result, code = rehearsed(tmp_path, init, BENCH, seed=2)
    rows = answers(result)
    assert code == 0
    assert result["accounted"]
    honest(rows)
    told = {name for name, row in rows.items() if row["supported"]}
    assert {f"Fc_a{n}" for n in (1, 2, 3)} <= told
    assert len(told) > 20
    assert abs(rows["Fc_a1"]["our_error_percent"]) < 5.0
    assert abs(rows["m_payload"]["our_error_percent"]) < 3.0  # beside the last link, which is stated to 2 %


def test_a_spinning_body_with_a_mass_on_a_boom(tmp_path):
    """One IMU and a telescoping mass: the mass of a payload of 0.13 kg on 8.5 kg is determined, the rest is weak."""
    spin = "[release]\nspin_rad_s = [0.1, -0.05, 1.2]\n"
    result, code = rehearsed(
        tmp_path, ["--base", "free", "--urdf", str(OWN / "spinner.urdf")], spin + SHORTER, seed=61004
    )
    rows = answers(result)
    assert code == 0
    assert result["accounted"]
    assert rows["m_payload"]["covered"]
    honest(rows)
    assert not rows["I_xx_payload"]["supported"]


def test_a_urdf_at_hand_keeps_its_links_and_gets_the_frames_it_lacks(tmp_path):
    urdf = tmp_path / "mine.urdf"
    text = (OWN / "planar_arm.urdf").read_text()
    urdf.write_text(text.replace('"shoulder"', '"shoulder joint-1"'))
    asked = ["init", str(tmp_path / "v"), "--base", "free", "--urdf", str(urdf), "--payload-link", "fore"]
    assert main(asked) == 0
    file = (tmp_path / "v" / "vehicle.toml").read_text()
    assert "[device.joint_1]" in file
    assert 'joint = "shoulder joint-1"' in file
    assert 'payload_link = "fore"' in file
    assert '<link name="imu_base"/>' in (tmp_path / "v" / "vehicle.urdf").read_text()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--urdf", "none.urdf"], "none.urdf: No such file"),
        (["--urdf", str(OWN / "planar_arm.urdf"), "--joints", "2"], "name those that are measured"),
        (["--urdf", str(OWN / "planar_arm.urdf"), "--imu-frame", "nose"], "no link 'nose'"),
        (["--payload-link", "fore"], "give the --urdf"),
    ],
)
def test_what_cannot_be_begun_with_says_why(tmp_path, capsys, options, why):
    assert main(["init", str(tmp_path / "v"), "--base", "free", *options]) == 2
    assert why in capsys.readouterr().err
    assert not (tmp_path / "v").exists()


def test_a_torque_that_is_a_row_must_be_recorded(tmp_path, capsys):
    asked = ["--base", "fixed", "--encoder", "cia402", "--urdf", str(OWN / "bench_arm.urdf")]
    assert main(["init", str(tmp_path / "v"), *asked]) == 0
    path = tmp_path / "v" / "vehicle.toml"
    path.write_text(path.read_text().replace("torque = true ", "torque = false", 1))
    assert main(["hil", str(path)]) == 2
    assert "give torque = true" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "v")
