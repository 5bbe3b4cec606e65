"""A URDF as MuJoCo and the joints' program need it: inertias and joints; meshes and other people's tags are left out.

Read with the standard library's XML parser, and compiled by MuJoCo's own URDF reader. Nothing of the flight app reads
it here.
"""

import xml.etree.ElementTree as ET
from typing import NamedTuple

import numpy as np

from hil_sim.scenario.tables import ScenarioError

_KEPT = {"link": {"inertial"}, "joint": {"origin", "parent", "child", "axis", "limit"}}
_MOVING = ("revolute", "continuous", "prismatic")
_UNBOUNDED = 1e6
_OF_A_ROD = 1e-6  # of its largest moment: MuJoCo takes no zero for one, and URDFs draw rods without thickness
PREFIX = "l."  # of every link in MuJoCo, which takes a link called "world" for its own


class DrawnJoint(NamedTuple):
    """A moving joint of the drawing; rad, or m where it slides."""

    name: str
    slides: bool
    low: float
    high: float
    speed: float  # largest; infinite where the URDF gives none
    effort: float  # N m, or N; infinite where the URDF gives none
    child: str

    @property
    def bounded(self) -> bool:
        """Whether it has an end."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


class PlantDrawing(NamedTuple):
    """A URDF.

    Attributes:
        root: link that all others hang on.
        links: all of them, in the order of the file.
        joints: those that move, by name.
        plain: the URDF without what MuJoCo is not to read, links with ``PREFIX``.
    """

    root: str
    links: tuple[str, ...]
    joints: dict[str, DrawnJoint]
    plain: str

    def link_at(self, frame: str) -> str:
        """The link whose frame a link's or joint's name means: that of a joint is its child's.

        Raises:
            ScenarioError: no such name.
        """
        if frame in self.links:
            return frame
        for joint in ET.fromstring(self.plain).iterfind("joint"):
            if joint.get("name") == frame:
                return joint.find("child").get("link", "").removeprefix(PREFIX)  # type: ignore[union-attr]
        raise ScenarioError(f"the URDF has no link or joint {frame!r}; its links are {', '.join(self.links)}")


def read(text: str, label: str) -> PlantDrawing:
    """A drawing from the text of a URDF; messages call it ``label``.

    Raises:
        ScenarioError: not a URDF that can be moved.
    """
    try:
        robot = ET.fromstring(text)
    except ET.ParseError as error:
        raise ScenarioError(f"{label} is no XML: {error}; correct it") from error
    if robot.tag != "robot":
        raise ScenarioError(f"{label} is no URDF: its root is <{robot.tag}>, not <robot>")
    joints: dict[str, DrawnJoint] = {}
    for element in list(robot):
        if element.tag not in _KEPT:
            robot.remove(element)
            continue
        if element.tag == "joint":
            _add_joint(element, joints, label)
        for part in [part for part in element if part.tag not in _KEPT[element.tag]]:
            element.remove(part)
    links = tuple(str(link.get("name")) for link in robot.iterfind("link"))
    for tensor in robot.iterfind("link/inertial/inertia"):
        _thicken(tensor)
    for each in robot.iterfind("link"):
        each.set("name", PREFIX + str(each.get("name")))
    children = set()
    for each in (*robot.iterfind("joint/parent"), *robot.iterfind("joint/child")):
        link = str(each.get("link"))
        if link not in links:
            raise ScenarioError(f"{label} has no link {link!r}, which a joint names; it has {', '.join(links)}")
        if each.tag == "child":
            children.add(link)
        each.set("link", PREFIX + link)
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise ScenarioError(f"{label} hangs on {', '.join(roots) or 'nothing'}; a vehicle has a single root")
    return PlantDrawing(roots[0], links, joints, ET.tostring(robot, encoding="unicode"))


def elements(drawing: PlantDrawing, tag: str) -> list[ET.Element]:
    """The elements of one tag, as MuJoCo reads them."""
    return ET.fromstring(drawing.plain).findall(tag)


def _add_joint(element: ET.Element, joints: dict[str, DrawnJoint], label: str) -> None:
    name, kind = str(element.get("name")), element.get("type")
    if kind == "fixed":
        return
    if kind not in _MOVING:
        raise ScenarioError(f"{label}: joint {name!r} is {kind!r}; fixed, {', '.join(_MOVING)} ones can be moved")
    if element.find("mimic") is not None:
        raise ScenarioError(f"{label}: joint {name!r} mimics another, which is not simulated; make it fixed")
    child, limit = element.find("child"), element.find("limit")
    if child is None or element.find("parent") is None:
        raise ScenarioError(f"{label}: joint {name!r} lacks <parent> or <child>; add it")
    low, high = -np.inf, np.inf
    if limit is not None and kind != "continuous":
        low, high = (_number(limit.get(key, "nan"), label, name) for key in ("lower", "upper"))
        if not low < high:
            raise ScenarioError(f"{label}: joint {name!r} goes from {low:g} to {high:g}; write its limits")
    elif kind != "continuous":
        raise ScenarioError(f"{label}: joint {name!r} has no <limit>; add it")
    speed, effort = (
        _number(limit.get(key, "inf"), label, name) if limit is not None else np.inf for key in ("velocity", "effort")
    )
    if high - low > _UNBOUNDED:
        low, high = -np.inf, np.inf
    told = (speed or np.inf, effort or np.inf)
    joints[name] = DrawnJoint(name, kind == "prismatic", low, high, *told, str(child.get("link")))


def _thicken(tensor: ET.Element) -> None:
    """Give a body without a moment about one of its axes a small one."""
    try:
        moments = {key: float(tensor.get(key, "nan")) for key in ("ixx", "iyy", "izz")}
    except ValueError:
        return  # MuJoCo says which
    for key, moment in moments.items():
        if moment == 0.0 < max(moments.values()):
            tensor.set(key, repr(_OF_A_ROD * max(moments.values())))


def _number(text: str, label: str, joint: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ScenarioError(f"{label}: joint {joint!r}: {text!r} is no number; correct it") from error
