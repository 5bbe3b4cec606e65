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
    """

    text: str
    root: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    last: str
    frames: tuple[str, ...]


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
    return Drawn(text, roots[0], tuple(joints), tuple(f for f in frames if f in heavy), last, frames)


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
