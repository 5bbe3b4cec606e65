"""``heft init --drives``: what is written flies on simulated drives as it stands, and its motion is made to the end."""

from pathlib import Path

import numpy as np
import pytest

from hil_sim.serve_driven import world
from onboard import cli, config
from onboard.config.driving import joint_ranges, read_motion
from onboard.flight import hil
from onboard.recording.reader import LogReader
from tests.flight.test_driven_flight import plugged

ARMS = {
    "fixed cia402": ["--base", "fixed", "--encoder", "cia402"],
    "free dynamixel": ["--base", "free", "--encoder", "dynamixel"],
}


def written(directory: Path, *arguments: str) -> Path:
    assert cli.main(["init", str(directory / "it"), *arguments, "--drives"]) == cli.OK
    return directory / "it" / "vehicle.toml"


@pytest.mark.parametrize("arm", ["fixed cia402", pytest.param("free dynamixel", marks=pytest.mark.campaign)])
def test_the_file_as_written_flies_and_its_motion_begins(arm: str, tmp_path: Path) -> None:
    """Of its 21 s the first; a motion that was played to its end: test_driven_flight, test_servo_arm."""
    path, log = written(tmp_path, *ARMS[arm]), tmp_path / "flight.mcap"
    mission = world(path, None, 8, 3.5)
    with plugged(mission) as urls:
        hil.fly_simulated(config.load(path).model_copy(update={"arm": True}), mission, urls, log)
    read = LogReader(log)
    codes = [code for code in read.read("event")["code"].tolist() if code.startswith(b"drive_")]
    assert codes[:2] == [b"drive_armed", b"drive_started"]
    for joint in ("joint_1", "joint_2"):
        rows = read.read(joint)
        assert np.ptp(rows["value_raw"] * rows["scale"]) > 0.02


@pytest.mark.campaign  # that it begins: above; what its answers are: test_driven_flight
@pytest.mark.parametrize("arm", ["fixed cia402", "free dynamixel"])
def test_the_file_as_written_flies_and_its_motion_is_made(arm: str, tmp_path: Path) -> None:
    path, log = written(tmp_path, *ARMS[arm]), tmp_path / "flight.mcap"
    mission = world(path, None, 8, 22.0)  # a motion of 21 s
    with plugged(mission) as urls:
        hil.fly_simulated(config.load(path).model_copy(update={"arm": True}), mission, urls, log)
    read = LogReader(log)
    codes = read.read("event")["code"].tolist()
    assert [code for code in codes if code.startswith(b"drive_")][:3] == [
        b"drive_armed",
        b"drive_started",
        b"drive_done",
    ]
    for joint in ("joint_1", "joint_2"):
        rows = read.read(joint)
        assert np.ptp(rows["value_raw"] * rows["scale"]) > 0.8
    truth, rows = mission.truth()["quantities"], read.read("quantity")
    if arm.startswith("free"):
        last = rows[rows["name"] == b"m_payload"][-1]
        assert abs(last["value"] - truth["m_payload"]) < 3.0 * last["sigma"]
        assert last["sigma"] < 0.4 * truth["m_payload"]
        assert len(read.read("joint_1_sent")) > 700
        assert {drive.drive_state for drive in mission.drives.values()} == {1}  # they hold


@pytest.mark.parametrize("joints", ["1", "2", "5"])
def test_its_motion_leaves_room_to_every_limit(joints: str, tmp_path: Path) -> None:
    path = written(tmp_path, "--base", "free", "--encoder", "dynamixel", "--joints", joints)
    names = [f"joint_{n + 1}" for n in range(int(joints))]
    ranges = joint_ranges((path.parent / "vehicle.urdf").read_text())
    time_s, q = read_motion(path.parent / "motion.csv", names)
    assert (q[[0, -1]] == 0.0).all()
    rate = np.abs(np.diff(q, axis=0) / np.diff(time_s)[:, None]).max(axis=0)
    assert (rate < 0.61).all()
    assert (rate > 0.2).all()
    assert (np.abs(q) < 0.61).all()
    assert {ranges[name] for name in names} == {(-1.5, 1.5, 1.0)}


def test_what_moves_nothing_and_what_has_no_range_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["init", str(tmp_path / "it"), "--base", "free", "--drives"]
    assert cli.main([*asked, "--encoder", "qsb"]) == cli.BAD_INPUT
    assert "--encoder cia402 or dynamixel" in capsys.readouterr().err
    urdf = tmp_path / "arm.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = '<joint name="j" type="continuous"><parent link="b"/><child link="l"/><axis xyz="0 0 1"/></joint>'
    urdf.write_text(f'<robot name="a"><link name="b">{inertial}</link><link name="l">{inertial}</link>{joint}</robot>')
    assert cli.main([*asked, "--encoder", "cia402", "--urdf", str(urdf)]) == cli.BAD_INPUT
    assert "'j' no range" in capsys.readouterr().err
    assert not (tmp_path / "it").exists()
