"""A URDF at hand, as a new vehicle takes it over: its joints, its root, and what it lacks is added to its copy.

URDFs of other people's robots have frames with a mass of nothing, joints that follow another one, grippers whose jaws
nobody measures, and a root that is the laboratory's floor.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.errors import BaseWeightError, ModelError
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.urdf import with_bodies
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec

_MOVING = ("revolute", "continuous", "prismatic")
PLACEHOLDER = RigidBody(10.0, np.zeros(3), 0.2 * np.eye(3))  # of a base that weighs nothing


class Drawn(NamedTuple):
    """A URDF.

    Attributes:
        text: of it, as it is to be copied.
        root: link that all others hang on.
        joints: those that are measured, from the base outwards.
        links: those with a mass.
        last: link of the last of the joints; the root without one.
        frames: all links.
        efforts: largest torque of each joint [N m, N]; none where the URDF says none, or zero.
        notes: what was changed in the copy, or has to be.
    """

    text: str
    root: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    last: str
    frames: tuple[str, ...]
    efforts: dict[str, float]
    notes: tuple[str, ...]


class _Moving(NamedTuple):
    name: str
    child: str
    follows: str  # the joint that it mimics; "" for one of its own


def read(path: Path, base: str, joints: Sequence[str] = ()) -> Drawn:
    """A drawing, made into one of a vehicle.

    Args:
        path: a URDF file.
        base: kind of the base; one that moves by its mass is given one where the drawing has none.
        joints: those that are measured; by default all that move of themselves. The others are fixed at zero.

    Raises:
        ConfigError: no URDF, not one tree of links, or a joint that it has not.
    """
    try:
        text = path.read_text(encoding="utf-8")
        robot = ET.fromstring(text)
    except UnicodeDecodeError as error:
        raise config.ConfigError(f"{path} is not UTF-8: {error}; save it as that") from error
    except (OSError, ET.ParseError) as error:
        raise config.ConfigError(f"{path} is no URDF: {error}; give the path of a URDF file") from error
    if any("/xacro}" in element.tag for element in robot.iter()):
        raise config.ConfigError(f"{path} is written for xacro; write it out first: xacro {path} > robot.urdf")
    if robot.tag != "robot":
        raise config.ConfigError(f"{path} is no URDF: its root is <{robot.tag}>, not <robot>; convert it")
    frames = tuple(str(link.get("name")) for link in robot.findall("link"))
    root, moving = _tree(path, robot, frames)
    if unknown := [name for name in joints if name not in moving]:
        raise config.ConfigError(f"{path} has no moving joint {unknown[0]!r}; it has {', '.join(moving) or 'none'}")
    notes = []
    measured = [one for one in moving.values() if one.name in joints or not (joints or one.follows)]
    for one in moving.values():
        if one not in measured:
            text = _fixed(text, one.name)
            notes.append(f"joint {one.name} is fixed at zero" + (f": it follows {one.follows}" if one.follows else ""))
    try:
        if base in ("free", "planar") and not _weighs(text, root):
            text = with_bodies(text, {root: PLACEHOLDER})
            notes.append(
                f"link {root}, the base, weighed nothing: {PLACEHOLDER.mass_kg:g} kg are put in, yours to correct"
            )
        model = VehicleModel(text, VehicleSpec(BaseKind(base), root))
    except ModelError as error:
        raise config.ConfigError(f"{path}: {error}") from error
    notes += [
        f"joint {joint.name} has no range: write its <limit>" for joint in model.joints if joint.low == joint.high
    ]
    last = measured[-1].child if measured else root
    largest = {joint.name: float(model.model.effortLimit[joint.v_index]) for joint in model.joints}
    efforts = {name: effort for name, effort in largest.items() if 0.0 < effort < np.inf}
    return Drawn(text, root, tuple(one.name for one in measured), model.links, last, frames, efforts, tuple(notes))


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


def _tree(path: Path, robot: ET.Element, frames: Sequence[str]) -> tuple[str, dict[str, _Moving]]:
    """The root, and the joints that move, from the base outwards."""
    by_parent: dict[str, list[tuple[str, _Moving]]] = {}
    children = set()
    for joint in robot.findall("joint"):
        parent, child, mimic = joint.find("parent"), joint.find("child"), joint.find("mimic")
        if parent is None or child is None:
            raise config.ConfigError(f"{path}: joint {joint.get('name')!r} lacks <parent> or <child>; add it")
        follows = "" if mimic is None else str(mimic.get("joint"))
        told = _Moving(str(joint.get("name")), str(child.get("link")), follows)
        by_parent.setdefault(str(parent.get("link")), []).append((str(joint.get("type")), told))
        children.add(told.child)
    roots = [link for link in frames if link not in children]
    if len(roots) != 1:
        raise config.ConfigError(f"{path} hangs on {', '.join(roots) or 'nothing'}; a vehicle has one root")
    moving, waiting = {}, [roots[0]]
    while waiting:
        for kind, told in by_parent.get(waiting.pop(0), ()):
            waiting.append(told.child)
            if kind in _MOVING:
                moving[told.name] = told
    return roots[0], moving


def _fixed(text: str, joint: str) -> str:
    """The URDF with one of its joints made fixed; all other text unchanged."""
    without_comments = re.sub(r"<!--.*?-->", lambda found: " " * len(found[0]), text, flags=re.DOTALL)
    for tag in re.finditer(rf"<joint\b[^>]*\bname\s*=\s*(['\"]){re.escape(joint)}\1[^>]*>", without_comments):
        kind = re.search(r"\btype\s*=\s*['\"](\w+)['\"]", tag[0])  # a transmission's <joint> has none
        if kind is not None:
            begin, end = tag.start() + kind.start(1), tag.start() + kind.end(1)
            return f"{text[:begin]}fixed{text[end:]}"
    raise config.ConfigError(f"joint {joint!r} is not written as <joint name=... type=...>; make it fixed by hand")


def _weighs(text: str, root: str) -> bool:
    """Whether the base has a mass, with what is fixed to it."""
    try:
        VehicleModel(text, VehicleSpec(BaseKind.FREE, root))
    except BaseWeightError:
        return False
    return True
