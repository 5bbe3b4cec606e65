"""A URDF at hand, as a new vehicle takes it over: its joints, its root, and what it lacks is added to its copy.

URDFs of other people's robots have frames with a mass of nothing, joints that follow another one, grippers whose jaws
nobody measures, and a root that is the laboratory's floor.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence, Set
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from onboard import config
from onboard.config.text import MOST_BYTES_URDF
from onboard.dynamics.model import urdf_check, urdf_reading
from onboard.dynamics.model.bases import BASES, BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.urdf import with_bodies
from onboard.dynamics.model.urdf_reading import DrawingError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec

_IMUS, _PUCKS = {"imu"}, {"puck", "pucks", "bearing", "bearings", "airbearing", "pad", "pads"}
PLACEHOLDER = RigidBody(10.0, np.zeros(3), 0.2 * np.eye(3))  # of a base that weighs nothing


class DrawnUrdf(NamedTuple):
    """A URDF.

    Attributes:
        text: of it, as it is to be copied.
        root: link that all others hang on.
        joints: those that are measured, from the base outwards.
        sliding: those of the joints that move along their axis.
        links: those with a mass.
        last: link of the last of the joints; the root without one.
        frames: all links.
        efforts: largest torque of each joint [N m, N]; none where the URDF says none, or zero.
        tips: links without a mass at the end of it, at which a tool could be.
        imus: links fixed to the root that are called like an IMU.
        pucks: links fixed to the root that are called like an air bearing's pucks.
        radius_m: of a disc with the root's mass and moment of inertia about z; zero of a base that does not move.
        notes: what was changed in the copy, or has to be.
    """

    text: str
    root: str
    joints: tuple[str, ...]
    sliding: frozenset[str]
    links: tuple[str, ...]
    last: str
    frames: tuple[str, ...]
    efforts: dict[str, float]
    tips: tuple[str, ...]
    imus: tuple[str, ...]
    pucks: tuple[str, ...]
    radius_m: float
    notes: tuple[str, ...]


def read(path: Path, base: str, joints: Sequence[str] = (), *, recorded: bool = False) -> DrawnUrdf:
    """A drawing, made into one of a vehicle.

    Args:
        path: a URDF file.
        base: kind of the base; one that moves by its mass is given one where the drawing has none.
        joints: those that are measured; by default all that move of themselves. The others are fixed at zero.
        recorded: by somebody else; such a vehicle is not simulated.

    Raises:
        ConfigError: no URDF, not one tree of links, or a joint that it has not.
    """
    try:
        return _read(config.read(path, "a URDF file", MOST_BYTES_URDF), str(path), base, joints, recorded=recorded)
    except DrawingError as error:
        raise config.ConfigError(str(error)) from error


def _read(text: str, label: str, base: str, joints: Sequence[str], *, recorded: bool) -> DrawnUrdf:
    whole = urdf_reading.read(text, label)
    moving = _outwards(whole, whole.root)
    if unknown := [name for name in joints if name not in moving]:
        raise config.ConfigError(f"{label} has no moving joint {unknown[0]!r}; it has {', '.join(moving) or 'none'}")
    notes = []
    follows = {
        name: str(mimic.get("joint")) for name, one in moving.items() if (mimic := one.find("mimic")) is not None
    }
    measured = [name for name in moving if name in joints or not (joints or name in follows)]
    for name in moving:
        if name not in measured:
            if follows.get(name) in measured and any(
                one in measured for one in _outwards(whole, whole.joints[name].child)
            ):
                raise config.ConfigError(
                    f"{label}: joint {name!r} follows {follows[name]!r} and carries joints that are measured, so its "
                    "angle has to be known, too: take its <mimic> out (column of a recording: a multiple of the other)"
                )
            text = _fixed(text, name)
            notes.append(
                f"joint {name} is fixed at zero" + (f": it follows {follows[name]}" if name in follows else "")
            )
    try:
        drawing = urdf_check.require_flyable(text, BaseKind.FIXED, label=label, simulated=not recorded)
    except DrawingError as error:
        raise config.ConfigError(f"{error}{_without(error, measured)}") from error
    root = drawing.root
    if BASES[base].follows and not urdf_check.base_weighs(drawing):
        text = with_bodies(text, {root: PLACEHOLDER})
        notes.append(f"link {root}, the base, weighed nothing: {PLACEHOLDER.mass_kg:g} kg are put in, yours to correct")
    if recorded and base == "free" and (wheels := _wheels(whole, measured)):
        notes.append(
            f"wheels, joints that turn without an end on the base: {', '.join(wheels)}; of a wheel a speed is "
            "recorded, no angle, and this file is that of an arm: for a body with wheels begin with --from tudelft "
            "(docs/free_body.md)"
        )
    model = VehicleModel(text, VehicleSpec(BASES[base], root))
    last = _hand(whole, measured) if measured else root
    tips = [link for link in whole.group(last) if not whole.below(link) and link not in model.links]
    largest = {joint.name: float(model.model.effortLimit[joint.v_index]) for joint in model.joints}
    efforts = {name: effort for name, effort in largest.items() if 0.0 < effort < np.inf}
    imus, pucks = _called(drawing, root, _IMUS), _called(drawing, root, _PUCKS)
    radius_m = float(np.sqrt(2.0 * model.chi[9] / model.chi[0])) if BASES[base].follows else 0.0
    frames, free = tuple(whole.links), (tuple(imus), tuple(pucks), radius_m, tuple(notes))
    sliding = frozenset(joint.name for joint in model.joints if not joint.revolute)
    return DrawnUrdf(text, root, tuple(measured), sliding, model.links, last, frames, efforts, tuple(tips), *free)


def _called(drawing: urdf_reading.Drawing, root: str, words: Set[str]) -> list[str]:
    """Links fixed to the root with one of these words in their names."""
    return [link for link in drawing.group(root) if words & set(re.split(r"[^a-z]+", link.lower()))]


def with_frame(drawn: DrawnUrdf, name: str, parent: str, place: str = "0 0 0") -> str:
    """Its text with a massless link at a place in another."""
    joint = f"{name}_mount"
    while joint in drawn.text:
        joint += "_"
    mount = f"""  <link name="{name}"/>
  <joint name="{joint}" type="fixed">               <!-- added by heft init: put its place in -->
    <parent link={quoteattr(parent)}/>
    <child link="{name}"/>
    <origin xyz="{place}" rpy="0 0 0"/>
  </joint>
"""
    at = [end.start() for end in re.finditer(r"</robot\s*>", _without_comments(drawn.text))][-1]
    return drawn.text[:at] + mount + drawn.text[at:]


def _outwards(drawing: urdf_reading.Drawing, link: str) -> dict[str, ET.Element]:
    """The joints that move beyond a link, outwards."""
    moving, waiting = {}, [link]
    while waiting:
        for joint in drawing.below(waiting.pop()):
            waiting.append(joint.child)
            if joint.moves:
                moving[joint.name] = joint.element
    return moving


def _wheels(drawing: urdf_reading.Drawing, measured: Sequence[str]) -> list[str]:
    """The measured joints, if all of them turn without an end on the root; else none."""
    base = {
        joint.name: joint.element.get("type") for link in drawing.group(drawing.root) for joint in drawing.below(link)
    }
    return list(measured) if all(base.get(name) == "continuous" for name in measured) else []


def _hand(drawing: urdf_reading.Drawing, measured: Sequence[str]) -> str:
    """The link that a payload is held by: that of the last measured joint, or what a gripper's jaws hang on."""
    joint = drawing.joints[measured[-1]]
    for link, carried in ((link, drawing.below(link)) for link in drawing.links):
        if joint in carried and sum(one.moves or one.element.find("mimic") is not None for one in carried) > 1:
            return link
    return joint.child


def _without(error: DrawingError, measured: Sequence[str]) -> str:
    """What to say for an arm without the joints that cannot be flown, where that mends all."""
    at_fault = {problem.joint for problem in error.problems}
    rest = [name for name in measured if name not in at_fault]
    if "" in at_fault or not rest:
        return ""
    return f"\nor fly without {'it' if len(at_fault) == 1 else 'them'}: --joints {','.join(rest)}"


def _fixed(text: str, joint: str) -> str:
    """The URDF with one of its joints made fixed; all other text unchanged."""
    for tag in re.finditer(rf"<joint\b[^>]*\bname\s*=\s*(['\"]){re.escape(joint)}\1[^>]*>", _without_comments(text)):
        kind = re.search(r"\btype\s*=\s*['\"](\w+)['\"]", tag[0])  # a transmission's <joint> has none
        if kind is not None:
            begin, end = tag.start() + kind.start(1), tag.start() + kind.end(1)
            return f"{text[:begin]}fixed{text[end:]}"
    raise config.ConfigError(f"joint {joint!r} is not written as <joint name=... type=...>; make it fixed by hand")


def _without_comments(text: str) -> str:
    """With blanks in their place."""
    return re.sub(r"<!--.*?-->", lambda found: " " * len(found[0]), text, flags=re.DOTALL)
