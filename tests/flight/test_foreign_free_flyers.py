"""Free-flyers and air-bearing robots as they are found: they fly, or are refused by name before a simulator starts."""

import random
import re
from pathlib import Path

import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import cli, config
from onboard.flight.estimate.problem.identification import build_online

FOUND = "found [2] \xe9.urdf"


def body(kg: float, kg_m2: float) -> str:
    return (
        f'<inertial><mass value="{kg}"/><inertia ixx="{kg_m2}" iyy="{kg_m2}" izz="{kg_m2}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", xyz: str = "0.2 0 0") -> str:
    limit = '<limit lower="-1.5" upper="1.5" effort="2" velocity="3"/>' if kind == "revolute" else ""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 0 1"/>{limit}</joint>\n'
    )


def flyer(wheel: str = body(0.5, 4e-4), arm: str = body(0.4, 1e-3), hand: str = body(0.1, 1e-4), more: str = "") -> str:
    """A disc on air bearings with a reaction wheel and an arm of two links; links in lines 2 to 5."""
    return (
        f'<robot name="disc">\n<link name="disc">{body(12, 0.2)}</link>\n<link name="reaction_wheel">{wheel}</link>\n'
        f'<link name="arm">{arm}</link>\n<link name="END_EFFECTOR">{hand}</link>\n'
        + joint("reaction_wheel", "disc", "reaction_wheel", "continuous", "0 0 0.1")
        + joint("shoulder", "disc", "arm")
        + joint("END_EFFECTOR", "arm", "END_EFFECTOR")
        + f"{more}</robot>"
    )


def began(directory: Path, text: str, *more: str) -> int:
    (directory / FOUND).write_text(text, encoding="utf-8")
    where = ["init", str(directory / "v"), "--name", "v", "--base", "free"]
    return cli.main([*where, "--urdf", str(directory / FOUND), *more])


@pytest.mark.parametrize(
    ("text", "line", "said", "joints"),
    [
        (flyer(hand=""), 5, "link 'END_EFFECTOR', which joint 'END_EFFECTOR' moves", "reaction_wheel,shoulder"),
        pytest.param(
            flyer(wheel=""), 3, "link 'reaction_wheel', which joint 'reaction_wheel' moves", "shoulder,END_EFFECTOR",
            marks=pytest.mark.campaign,  # as the link above
        ),
        (flyer(hand="", wheel=""), 3, "'reaction_wheel' moves, has no mass", "shoulder"),
        (flyer(arm=body(0.08, 0.097) + '<visual><geometry><box size="0.13 0.02 0.02"/></geometry></visual>'), 4,
         "all its mass would be 1.1 m from its centre", ""),
        (flyer().replace("0 0 0.1", "0 0 300"), 6, "300 mm are 0.3", ""),
        (flyer(more=f'<link name="arm">{body(1, 1e-3)}</link>'), 9, "link 'arm' stands in line 4 too", ""),
    ],
)  # fmt: skip
def test_what_cannot_fly_is_refused_with_the_joints_that_can(
    text: str, line: int, said: str, joints: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert began(tmp_path, text) == cli.BAD_INPUT
    message = capsys.readouterr().err
    assert message.startswith(f"heft: {tmp_path / FOUND}:{line}: ")
    assert said in message
    assert not (tmp_path / "v").exists()
    offered = re.findall(r"--joints (\S+)", message)
    assert sorted(offered[0].split(",") if offered else []) == sorted(joints.split(",") if joints else [])
    if offered:
        assert began(tmp_path, text, "--joints", offered[0]) == cli.OK
        with open_in_process(scenario_of(tmp_path / "v" / "vehicle.toml"), 1)[0] as world:
            world.advance(50_000_000)


NUMBERS = ("0", "-1", "1e200", "1e-200", "nan", "0_1", "", "1,5", "300", "9" * 400, "\u0661", "1e-9", "180")
NAMES = ("a b", "\xe9 [x]", 'a"b', "a/b", "world", "universe", "\U0001f916", "x" * 300, "disc", "gyro arm", "%s", "#")


def altered(seed: int, texts: dict[str, str]) -> dict[str, str]:
    """One value of the vehicle file or of the URDF is another."""
    draw = random.Random(seed)
    name = draw.choice(sorted(texts))
    text = texts[name]
    found = list(re.finditer(r'"([^"\n]*)"|= (-?[\d.]+(?:e-?\d+)?)', text))
    one = draw.choice(found)
    group = 1 if one[1] is not None else 2
    parts = one[group].split() or [""]
    parts[draw.randrange(len(parts))] = draw.choice((*NUMBERS, *NAMES)).replace('"', "&quot;")
    return texts | {name: text[: one.start(group)] + " ".join(parts) + text[one.end(group) :]}


@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 120), marks=pytest.mark.campaign)], ids=len)
def test_any_altered_value_flies_or_is_refused_with_its_file(tmp_path: Path, seeds: range) -> None:
    assert began(tmp_path, flyer()) == cli.OK
    drawn = {name: (tmp_path / "v" / name).read_text(encoding="utf-8") for name in ("vehicle.toml", "vehicle.urdf")}
    flown, refused = 0, []
    for seed in seeds:
        for name, text in altered(seed, drawn).items():
            (tmp_path / "v" / name).write_text(text, encoding="utf-8")
        try:
            vehicle = config.load(tmp_path / "v" / "vehicle.toml")
        except config.ConfigError as error:
            refused.append(str(error))
        else:
            flown += flies(vehicle)
    assert all(one.startswith(str(tmp_path / "v" / "vehicle.")) and len(one) < 4000 for one in refused)
    assert len(refused) >= len(seeds) // 3
    assert flown >= len(seeds) // 12


def flies(vehicle: config.Vehicle) -> bool:
    """Whether it does; where it does not it is refused, and nothing else is raised."""
    try:
        build_online(vehicle)
        with open_in_process(scenario_of(vehicle.path), 1)[0] as world:
            world.advance(20_000_000)
    except ValueError:
        return False
    return True
