"""The vehicle's joints as the page draws them: the tree of its URDF, which the browser moves by the measured angles.

Pinocchio, which the estimator has, is not loaded here: it takes 40 MB. Its order of the joints, which is that of the
columns of ``row.joint_rad``, is: depth first, the joints of a link by name.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

MOST_BYTES, MOST_JOINTS = 4 << 20, 400
_MOVING = {"revolute": "turns", "continuous": "turns", "prismatic": "slides"}


def tree_of(files: Mapping[str, bytes], payload: str = "") -> dict[str, Any] | None:
    """Joints from the root on, each after that which carries it; None where no file is a URDF that can be drawn.

    ``joints``: ``name``, ``parent`` and ``child`` (links), ``xyz`` (m) and ``rpy`` (rad) in the parent's frame,
    ``axis`` (unit vector) in the child's, ``moves`` (``turns``, ``slides``, or empty), ``q`` (its column in
    ``row.joint_rad``, or None). ``root``: the first link. ``payload``: link whose body is asked for, or empty.

    Args:
        files: that a log carries, by name; one ends with ``.urdf``.
        payload: link.
    """
    text = urdf_of(files)
    if not text:
        return None
    try:
        return _tree(ET.fromstring(text), payload)
    except (ET.ParseError, ValueError, KeyError):
        return None  # the flight has said what is wrong with it; the page draws nothing


def urdf_of(files: Mapping[str, bytes]) -> bytes:
    """The URDF among files by name; empty where there is none, or it is too large to be drawn."""
    text = next((data for name, data in files.items() if name.endswith(".urdf")), b"")
    return text if len(text) <= MOST_BYTES else b""


def _tree(robot: ET.Element, payload: str) -> dict[str, Any] | None:
    of_link: dict[str, list[dict[str, Any]]] = {}
    children = set()
    for joint in robot.findall("joint"):
        made = _joint(joint)
        of_link.setdefault(made["parent"], []).append(made)
        children.add(made["child"])
    roots = [link.attrib["name"] for link in robot.findall("link") if link.attrib["name"] not in children]
    if len(roots) != 1 or not 0 < len(children) <= MOST_JOINTS or sum(map(len, of_link.values())) != len(children):
        return None
    joints: list[dict[str, Any]] = []
    moving = 0
    waiting = _by_name(of_link, roots[0])
    while waiting:  # ends: every link is the child of one joint at most
        carried = waiting.pop()
        if carried["moves"]:
            carried["q"], moving = moving, moving + 1
        joints.append(carried)
        waiting += _by_name(of_link, carried["child"])
    return {"root": roots[0], "joints": joints, "payload": payload if payload in children else ""}


def _by_name(of_link: Mapping[str, list[dict[str, Any]]], link: str) -> list[dict[str, Any]]:
    """The last first, as a stack has them."""
    return sorted(of_link.get(link, []), key=lambda joint: str(joint["name"]), reverse=True)


def _joint(joint: ET.Element) -> dict[str, Any]:
    parent, child = (_attribute(joint.find(name), "link") for name in ("parent", "child"))
    axis = _three(joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
    length = math.hypot(*axis)
    if not length > 0.0:
        raise ValueError("an axis without a direction")
    return {
        "name": joint.attrib["name"],
        "parent": parent,
        "child": child,
        "xyz": _three(joint.find("origin"), "xyz"),
        "rpy": _three(joint.find("origin"), "rpy"),
        "axis": [part / length for part in axis],
        "moves": _MOVING.get(joint.attrib["type"], ""),
        "q": None,
    }


def _attribute(element: ET.Element | None, name: str) -> str:
    if element is None:
        raise KeyError(name)
    return element.attrib[name]


def _three(element: ET.Element | None, name: str, otherwise: tuple[float, ...] = (0.0, 0.0, 0.0)) -> list[float]:
    if element is None or name not in element.attrib:
        return list(otherwise)
    numbers = [float(word) for word in element.attrib[name].split()]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name} has three numbers")
    return numbers
