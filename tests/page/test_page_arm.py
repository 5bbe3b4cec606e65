"""The page's arm: its joints are in the model's order, and a URDF that cannot be drawn draws nothing."""

from pathlib import Path
from typing import Any

import pytest

from onboard.config.loader import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.page.arm import MOST_JOINTS, tree_of

URDFS = sorted(packaged("rocksat").parents[1].glob("*/*.urdf"))


def columns(tree: dict[str, Any]) -> list[str]:
    moving = [joint for joint in tree["joints"] if joint["q"] is not None]
    assert [joint["q"] for joint in moving] == list(range(len(moving)))
    return [joint["name"] for joint in moving]


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.parent.name)
def test_columns_are_those_of_the_model(path: Path) -> None:
    text = path.read_bytes()
    tree = tree_of({"vehicle.toml": b"", path.name: text})
    assert tree is not None
    model = VehicleModel(text.decode(), VehicleSpec(BaseKind.FIXED, tree["root"]))
    assert columns(tree) == [joint.name for joint in model.joints]


def test_a_link_with_several_joints_and_names_in_no_order() -> None:
    """Depth first, a link's joints by name, upper case first, as Pinocchio has them."""
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    names = [("z", "base", "l1"), ("a10", "base", "l2"), ("a2", "l2", "l3"), ("B", "base", "l4"), ("a", "l4", "l5")]
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("l5", "l1", "base", "l2", "l3", "l4"))
    joints = "".join(
        f'<joint name="{name}" type="{"prismatic" if name == "a2" else "revolute"}"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for name, parent, child in names
    )
    text = f'<robot name="r">{links}{joints}</robot>'
    tree = tree_of({"r.urdf": text.encode()}, "l3")
    assert tree is not None
    assert tree["joints"][0]["axis"] == [0.0, 0.0, 1.0]
    assert tree["payload"] == "l3"
    model = VehicleModel(text, VehicleSpec(BaseKind.FREE, "base"))
    assert columns(tree) == [joint.name for joint in model.joints]
    assert columns(tree) == ["B", "a", "a10", "a2", "z"]


def robot(joints: str) -> bytes:
    return f'<robot name="r"><link name="a"/><link name="b"/>{joints}</robot>'.encode()


JOINT = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{}</joint>'
BOMB = b'<!DOCTYPE r [<!ENTITY a "' + b"x" * 1000 + b'">' + b"".join(
    b'<!ENTITY %c "%s">' % (98 + n, b"&%c;" % (97 + n) * 100) for n in range(6)
) + b']><robot name="&g;"/>'  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe",
        b"<robot",
        b"<robot/>",
        robot(""),
        robot('<joint name="j"/>'),
        robot('<joint name="j" type="fixed"><parent link="a"/><child/></joint>'),
        robot(JOINT.format('<origin xyz="1 2"/>')),
        robot(JOINT.format('<origin xyz="1 nan 2"/>')),
        robot(JOINT.format('<axis xyz="0 0 0"/>')),
        robot(JOINT.format("") * 2),
        robot(JOINT.format("") + JOINT.format("").replace('"a"', '"x"').replace('"b"', '"a"').replace('"x"', '"b"')),
        b"<robot>" + b"<a>" * 100_000,
        BOMB,
        b" " * (5 << 20),
        robot("".join(JOINT.format("").replace('"b"', f'"b{n}"') for n in range(MOST_JOINTS + 1))),
    ],
    ids=range(16),
)
def test_what_cannot_be_drawn_is_not(text: bytes) -> None:
    assert tree_of({"r.urdf": text}) is None
    assert tree_of({"vehicle.toml": text}) is None


def test_a_payload_that_the_urdf_does_not_have() -> None:
    tree = tree_of({"r.urdf": robot(JOINT.format(""))}, "tool")
    assert tree is not None
    assert (tree["payload"], tree["root"]) == ("", "a")
