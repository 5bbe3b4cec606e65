"""A URDF at hand, as a new vehicle takes it over: its joints, its root, and frames for what it lacks."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from onboard import config

_MOVING = ("revolute", "continuous", "prismatic")


class Drawn(NamedTuple):
    """A URDF.

    Attributes:
        text: of it.
        root: link that all others hang on.
        joints: those that move, from the base outwards.
        links: those with a mass, the root among them.
        last: link of the last joint that moves; the root without one.
        frames: all links.
        efforts: largest torque of each joint that moves [N m, N]; none where the URDF says none, or zero.
    """

    text: str
    root: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    last: str
    frames: tuple[str, ...]
    efforts: dict[str, float]


def read(path: Path) -> Drawn:
    """A drawing.

    Raises:
        ConfigError: no URDF, or not one tree of links.
    """
    try:
        text = path.read_text(encoding="utf-8")
        robot = ET.fromstring(text)
    except (OSError, UnicodeDecodeError, ET.ParseError) as error:
        raise config.ConfigError(f"{path} is no URDF: {error}; give the path of a URDF file") from error
    frames = tuple(str(link.get("name")) for link in robot.findall("link"))
    by_parent: dict[str, list[tuple[str, str, str]]] = {}
    children = set()
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            raise config.ConfigError(f"{path}: joint {joint.get('name')!r} lacks <parent> or <child>; add it")
        told = str(joint.get("name")), str(joint.get("type")), str(child.get("link"))
        by_parent.setdefault(str(parent.get("link")), []).append(told)
        children.add(told[2])
    roots = [link for link in frames if link not in children]
    if len(roots) != 1:
        raise config.ConfigError(f"{path} hangs on {', '.join(roots) or 'nothing'}; a vehicle has one root")
    joints, last, waiting = [], roots[0], [roots[0]]
    while waiting:
        for name, kind, link in by_parent.get(waiting.pop(0), ()):
            waiting.append(link)
            if kind in _MOVING:
                joints.append(name)
                last = link
    heavy = {str(link.get("name")) for link in robot.findall("link") if link.find("inertial") is not None}
    limits = {str(joint.get("name")): joint.find("limit") for joint in robot.findall("joint")}
    efforts = {name: _effort(path, limit) for name, limit in limits.items() if name in joints and limit is not None}
    links = tuple(f for f in frames if f in heavy)
    return Drawn(text, roots[0], tuple(joints), links, last, frames, {k: v for k, v in efforts.items() if v > 0.0})


def _effort(path: Path, limit: ET.Element) -> float:
    try:
        return float(limit.get("effort", "0"))
    except ValueError as error:
        raise config.ConfigError(f"{path}: a joint's effort is no number: {error}; correct it") from error


def with_frame(drawn: Drawn, name: str, parent: str) -> str:
    """Its text with a massless link at another's origin."""
    mount = f"""  <link name="{name}"/>
  <joint name="{name}_mount" type="fixed">               <!-- added by heft init: put its place in -->
    <parent link="{parent}"/>
    <child link="{name}"/>
    <origin xyz="0 0 0" rpy="0 0 0"/>
  </joint>
"""
    at = drawn.text.rindex("</robot>")
    return drawn.text[:at] + mount + drawn.text[at:]
