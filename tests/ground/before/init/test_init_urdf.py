"""``heft init --urdf``: what becomes of somebody's names, payload, IMU frames, wheels, pucks and mimic joints."""

from pathlib import Path

import pytest

from onboard import cli, config
from onboard.flight.estimate.readings.roles import roles_of

_GRIPPER = """<robot name="a"><link name="world"/>
<joint name="w" type="fixed"><parent link="world"/><child link="link_0"/></joint>{links}
<joint name="j_1" type="revolute"><parent link="link_0"/><child link="link_1"/><axis xyz="0 1 0"/>
<limit effort="87" velocity="2" lower="-2" upper="2"/></joint>
<joint name="h" type="fixed"><parent link="link_1"/><child link="hand"/></joint>
<joint name="f_1" type="prismatic"><parent link="hand"/><child link="jaw_1"/><axis xyz="0 1 0"/>
<limit effort="20" velocity="0.2" lower="0" upper="0.04"/></joint>
<joint name="f_2" type="prismatic"><parent link="hand"/><child link="jaw_2"/><axis xyz="0 -1 0"/>
<mimic joint="f_1"/><limit effort="20" velocity="0.2" lower="0" upper="0.04"/></joint>
<joint name="t" type="fixed"><parent link="hand"/><child link="tcp"/></joint><link name="tcp"/></robot>"""


def test_a_payload_is_held_by_the_hand_and_not_by_a_jaw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody's arm with a gripper, whose jaws are its last joints, and a frame for its tool."""
    link = (
        '<link name="{}"><inertial><mass value="2"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    links = "".join(link.format(name) for name in ("link_0", "link_1", "hand", "jaw_1", "jaw_2"))
    urdf = tmp_path / "a.urdf"
    urdf.write_text(_GRIPPER.format(links=links))
    asked = ["--base", "fixed", "--encoder", "recorded", "--urdf", str(urdf)]
    for name, more, said in (
        ("all", [], "in a new link 'payload' at the origin of hand; --payload-link tcp"),
        ("arm", ["--joints", "j_1"], "in a new link 'payload' at the origin of link_1; --payload-link tcp"),
        ("link", ["--payload-link", "hand"], "link hand has a mass in the URDF"),
    ):
        assert cli.main(["init", str(tmp_path / name), *asked, *more]) == cli.OK
        assert said in capsys.readouterr().out
    urdf.write_text(urdf.read_text().replace('"tcp"', '"tool [tip]"'))
    assert cli.main(["init", str(tmp_path / "quoted"), *asked]) == cli.OK
    assert "; --payload-link 'tool [tip]' for a frame" in capsys.readouterr().out
    assert cli.main(["init", str(tmp_path / "tip"), *asked, "--payload-link", "tool [tip]"]) == cli.OK
    assert "what is held" not in capsys.readouterr().out
    mount = (tmp_path / "all" / "vehicle.urdf").read_text().split("payload_mount")[1]
    assert '<parent link="hand"/>' in mount.split("</joint>")[0]


_MASS = '<inertial><mass value="{}"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
_FRAME = '<link name="{0}"/><joint name="{0}_j" type="fixed"><parent link="{1}"/><child link="{0}"/></joint>'
_ONE_JOINT = (
    f'<link name="bus">{_MASS.format(9)}</link><link name="arm">{_MASS.format(1)}</link>'
    '<joint name="j" type="revolute"><parent link="bus"/><child link="arm"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
)
_PAN_TILT = (
    '<robot name="r"><link name="bus">{mass}</link><link name="pan">{mass}</link><link name="{hand}">{mass}</link>'
    '<joint name="{pan}" type="revolute"><parent link="bus"/><child link="pan"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
    '<joint name="{tilt}" type="revolute"><parent link="pan"/><child link="{hand}"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot >\n<!-- once </robot> -->\n'
)


@pytest.mark.parametrize(
    ("pan", "tilt", "channels"),
    [
        ("imu_base", "imu_base_mount", ["joint_1", "imu_base_mount"]),
        ("can_sync", "pulse", ["joint_1", "joint_2"]),
        ("load_cell", "fx", ["joint_1", "joint_2"]),
        ("joint_2", "b [x]", ["joint_2", "joint_3"]),
        ("a", "a_torque", ["a", "joint_2"]),
        ("payload_mount", "q'2&quot;", ["payload_mount", "joint_2"]),
    ],
)
def test_names_of_somebody_s_urdf_are_in_no_way_of_those_that_are_added(
    pan: str, tilt: str, channels: list[str], tmp_path: Path
) -> None:
    """Joints like devices or frames of ours, a link with a quote, and a last tag that is written otherwise."""
    urdf = tmp_path / "a.urdf"
    urdf.write_text(_PAN_TILT.format(mass=_MASS.format(3), hand="hand &quot;&amp;", pan=pan, tilt=tilt))
    for name, more in (
        ("free", ["--base", "free"]),
        ("torques", ["--base", "fixed", "--encoder", "recorded"]),
        ("wrist", ["--base", "fixed", "--load-cell", "bota_ft"]),
        ("cell", ["--base", "fixed", "--load-cell", "cia404"]),
        ("imu", ["--base", "free", "--imu", "mpu6050", "--imu-frame", "bus"]),
    ):
        assert cli.main(["init", str(tmp_path / name), "--urdf", str(urdf), *more]) == cli.OK
        made = config.load(tmp_path / name / "vehicle.toml").file.device
        angles = [channel for channel, keys in made.items() if hasattr(keys, "joint")]
        assert [channel for channel in angles if not channel.endswith("_torque")] == channels


def test_a_joint_that_follows_another_and_carries_the_arm_is_measured_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A parallelogram: fixed at zero, all that it carries would be drawn where it is not."""
    arm = _PAN_TILT.format(mass=_MASS.format(3), hand="hand", pan="shoulder", tilt="parallel")
    follows = arm.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="-1"/>')
    wrist = (
        f'<link name="tool">{_MASS.format(1)}</link><joint name="wrist" type="continuous">'
        '<parent link="hand"/><child link="tool"/><axis xyz="0 0 1"/></joint>'
    )
    urdf = tmp_path / "a.urdf"
    urdf.write_text(follows.replace("</robot >", f"{wrist}</robot>"))
    asked = ["init", str(tmp_path / "v"), "--base", "free", "--urdf", str(urdf)]
    assert cli.main(asked) == cli.BAD_INPUT
    assert "joint 'parallel' follows 'shoulder' and carries joints" in capsys.readouterr().err
    assert cli.main([*asked, "--joints", "wrist"]) == cli.OK
    assert "parallel is fixed at zero" in capsys.readouterr().out


@pytest.mark.parametrize(("kind", "told"), [("continuous", True), ("revolute", False)])
def test_wheels_on_a_free_base_are_no_arm(
    kind: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their speeds are recorded. A file of an arm asks for their angles, which no recording of wheels has."""
    wheel = (
        '<link name="wheel"><inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="2e-5" ixy="0" ixz="0" '
        f'iyz="0"/></inertial></link><joint name="spin" type="{kind}"><parent link="body"/><child link="wheel"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )
    moments = 'ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"'
    body = f'<link name="body"><inertial><mass value="5"/><inertia {moments}/>'
    drawn = tmp_path / "body.urdf"
    drawn.write_text(f'<robot name="sat">{body}</inertial></link>{wheel}</robot>')
    asked = ["init", str(tmp_path / "lab"), "--base", "free", "--urdf", str(drawn), "--encoder", "recorded"]
    assert cli.main(asked) == cli.OK
    said = "on the base: spin; of a wheel a speed is recorded, no angle" in capsys.readouterr().out
    assert said == told


def test_an_imu_is_where_the_urdf_has_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for frames, used, said in (
        ((("Imu_link", "bus"), ("arm_imu", "arm"), ("maximum", "bus")), "Imu_link", "the place of link Imu_link"),
        ((("imu_1", "bus"), ("imu_2", "bus")), "imu_1", "each of imu_1, imu_2 is the place and the axes of an IMU"),
        ((("arm_imu", "arm"),), "imu_base", "at the origin of bus: put its place in"),
    ):
        urdf, lab = tmp_path / "a.urdf", tmp_path / used / frames[0][0]
        urdf.write_text(f'<robot name="a">{_ONE_JOINT}{"".join(_FRAME.format(*one) for one in frames)}</robot>')
        asked = ["--base", "free", "--encoder", "recorded", "--urdf", str(urdf)]
        assert cli.main(["init", str(lab), *asked]) == cli.OK
        assert said in capsys.readouterr().out
        imus = roles_of(config.load(lab / "vehicle.toml")).imus
        on_the_bus = [name for name, where in frames if where == "bus" and name.lower().startswith("imu")]
        assert [imu.frame for imu in imus] == (on_the_bus or [used])


def test_of_two_imus_in_the_urdf_a_device_is_at_the_first(tmp_path, capsys):
    """A second one of the same kind would need an address of its own; a base that is carried has one IMU."""
    urdf = tmp_path / "a.urdf"
    frames = "".join(_FRAME.format(name, "bus") for name in ("imu_1", "imu_2"))
    urdf.write_text(f'<robot name="a">{_ONE_JOINT}{frames}</robot>')
    for base, kinds in (("free", ()), ("prescribed", ("--encoder", "recorded"))):
        lab = tmp_path / base
        assert cli.main(["init", str(lab), "--base", base, "--urdf", str(urdf), *kinds]) == cli.OK
        assert "place of link imu_1; --imu-frame imu_2" in capsys.readouterr().out
        assert [imu.frame for imu in roles_of(config.load(lab / "vehicle.toml")).imus] == ["imu_1"]


def test_pucks_are_where_the_urdf_has_them_or_in_the_middle_and_around_it(tmp_path, capsys):
    """A disc of 9 kg and 0.1 kg m^2 about z is 0.149 m in radius; pucks that are in the middle alone do not turn it."""
    for frames, used, said in (
        (("Puck_a", "puck_b"), ("Puck_a", "puck_b"), "at Puck_a, puck_b"),
        ((), ("puck_1", "puck_2", "puck_3", "puck_4"), "0.15 m around it"),
    ):
        urdf, lab = tmp_path / "a.urdf", tmp_path / used[0]
        urdf.write_text(f'<robot name="a">{_ONE_JOINT}{"".join(_FRAME.format(one, "bus") for one in frames)}</robot>')
        assert cli.main(["init", str(lab), "--base", "planar", "--encoder", "recorded", "--urdf", str(urdf)]) == cli.OK
        assert said in capsys.readouterr().out
        asked = config.load(lab / "vehicle.toml").file.planar
        assert asked is not None
        assert tuple(one.frame for one in asked.puck) == used
        assert asked.sag_sigma > 0.0
    assert '<origin xyz="0.1491 0 0"' in (lab / "vehicle.urdf").read_text()


@pytest.mark.parametrize("encoder", ["cia406", "recorded"])
def test_units_of_a_joint_that_slides_are_said_beside_it(encoder: str, tmp_path: Path) -> None:
    """An encoder's counts in a revolution were left to guess."""
    urdf = tmp_path / "a.urdf"
    urdf.write_text(_PAN_TILT.format(mass=_MASS.format(3), hand="hand", pan="pan", tilt="tilt"))
    text = urdf.read_text().replace('name="pan" type="revolute"', 'name="pan" type="prismatic"')
    assert text != urdf.read_text()
    urdf.write_text(text)
    more = ["--load-cell", "cia404"] if encoder == "cia406" else []
    assert (
        cli.main(["init", str(tmp_path / "a"), "--urdf", str(urdf), "--base", "fixed", "--encoder", encoder, *more])
        == 0
    )
    lines = (tmp_path / "a" / "vehicle.toml").read_text().splitlines()
    told = [line for line in lines if line.startswith("joint = ") and "of the URDF" in line]
    assert ["6.2832 m" in line for line in told] == [True, False]
