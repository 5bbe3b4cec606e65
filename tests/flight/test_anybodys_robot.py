"""``heft init --urdf`` of robots as other people draw them: a vehicle at once, and one that can be rehearsed."""

import re
from pathlib import Path

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import cli, config
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.flight.estimate.problem.identification import build_online

# As exporters and converters write robots: the floor is the root, frames have a mass of nothing or next to nothing, a
# sensor is a point, a link and a joint share a name, a jaw follows another, transmissions name joints too.
ROBOT = """<?xml version="1.0"?>
<robot name="arm">
  <!-- <joint name="jaw_2" type="revolute"/> -->
  <transmission name="t"><joint name="jaw_2"><hardwareInterface>E</hardwareInterface></joint></transmission>
  <link name="world"/>
  <link name="foot"><inertial><mass value="4"/><inertia ixx=".01" iyy=".01"
    izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="floor" type="fixed"><parent link="world"/><child link="foot"/></joint>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="3"/>
    <inertia ixx="0.001" iyy="0.04" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="foot"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="3"/></joint>
  <link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="fore" type="continuous"><parent link="upper"/>
    <child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
    <limit effort="50" velocity="3"/></joint>
  <link name="sensor"><inertial><mass value="0.1"/><inertia ixx="0" iyy="0" izz="0"
    ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="s" type="fixed"><parent link="fore"/><child link="sensor"/><origin xyz="0.4 0 0"/></joint>
  <link name="tool0"><inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0"
    ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="t0" type="fixed"><parent link="sensor"/><child link="tool0"/></joint>
  <link name="tcp"><inertial><mass value="1e-9"/><inertia ixx="0" iyy="0" izz="0"
    ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="t1" type="fixed"><parent link="tool0"/><child link="tcp"/></joint>
  <link name="left"><inertial><mass value=".05"/><inertia ixx="1e-5" iyy="1e-5"
    izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="jaw_1" type="prismatic"><parent link="tool0"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>
  <link name="right"><inertial><mass value=".05"/><inertia ixx="1e-5" iyy="1e-5"
    izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="jaw_2" type="prismatic"><parent link="tool0"/><child link="right"/><axis xyz="0 -1 0"/>
    <mimic joint="jaw_1"/><limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>
</robot>
"""
ZERO = '<mass value="0"/><inertia ixx="0" iyy="0" izz="0"'


def begin(directory: Path, text: str, base: str, *more: str) -> Path:
    (directory / "robot.urdf").write_text(text)
    made = ["init", str(directory / "v"), "--urdf", str(directory / "robot.urdf"), "--base", base, *more]
    assert cli.main([*made, "--encoder", "cia402"]) == cli.OK
    return directory / "v" / "vehicle.toml"


def model_of(path: Path) -> VehicleModel:
    return build_online(config.load(path))[1]


@pytest.mark.parametrize(
    "base",
    ["free", "prescribed", "fixed", pytest.param("planar", marks=pytest.mark.campaign)],  # test_air_bearing
)
def test_it_is_a_vehicle_and_flies(base: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = begin(tmp_path, ROBOT, base, "--joints", "shoulder,fore", "--payload-link", "tcp")
    said = capsys.readouterr().out
    assert "note: joint jaw_1 is fixed at zero\n" in said
    assert "note: joint jaw_2 is fixed at zero: it follows jaw_1\n" in said
    model = model_of(path)
    assert set(model.links) == {"foot", "upper", "fore", "sensor", "tcp", "left", "right"}
    assert [joint.name for joint in model.joints] == ["shoulder", "fore"]
    assert {model.links[k] for k in model.distal_links("fore")} == set(model.links) - {"foot", "upper"}
    assert '<!-- <joint name="jaw_2" type="revolute"/> -->' in (path.parent / "vehicle.urdf").read_text()
    world, _ = open_in_process(scenario_of(path), 3)
    with world:
        world.advance(50_000_000)


def test_without_names_the_joints_that_follow_others_are_fixed(tmp_path: Path) -> None:
    model = model_of(begin(tmp_path, ROBOT, "fixed"))
    assert [joint.name for joint in model.joints] == ["shoulder", "fore", "jaw_1"]


def test_a_free_base_that_weighs_nothing_is_given_a_mass_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    floating = re.sub(r'<mass value="4"/><inertia ixx=".01" iyy=".01"\s+izz=".01"', ZERO, ROBOT)
    assert floating != ROBOT
    model = model_of(begin(tmp_path, floating, "free"))
    assert "link world, the base, weighed nothing: 10 kg are put in, yours to correct" in capsys.readouterr().out
    assert model.links[0] == "world"
    np.testing.assert_array_equal(model.chi[:4], [10.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--joints", "elbow"], "has no moving joint 'elbow'; it has shoulder, fore, jaw_1, jaw_2"),
        (["--joints", "2"], "name those that are measured"),
        (["--payload-link", "hand"], "no link 'hand'"),
    ],
)
def test_what_it_has_not_is_named(
    more: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.urdf").write_text(ROBOT)
    given = ["init", str(tmp_path / "v"), "--urdf", str(tmp_path / "robot.urdf"), "--base", "free"]
    assert cli.main([*given, *more]) == cli.BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "v").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="a"/></robot>',
            "write it out first: xacro",
        ),
        ("<mujoco><worldbody/></mujoco>", "its first tag is <mujoco>, not <robot>"),
        ("<robot><!-- \xe9 --></robot>", "is not UTF-8"),
        ("<robot/>", "it has no <link>"),
        ("robot", "no XML"),
    ],
)
def test_what_is_no_urdf_is_said(text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.urdf").write_text(text, encoding="latin-1")
    assert (
        cli.main(["init", str(tmp_path / "v"), "--urdf", str(tmp_path / "robot.urdf"), "--base", "free"])
        == cli.BAD_INPUT
    )
    assert said in capsys.readouterr().err
