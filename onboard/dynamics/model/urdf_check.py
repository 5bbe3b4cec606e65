"""Looks a URDF over before any model is made of it: what cannot fly is refused with its line, its name and a remedy.

``VehicleModel``, the vehicle file's checks and ``heft init`` ask here, and no other place judges a URDF's numbers.
Nothing of Pinocchio is loaded. Of pictures and collision shapes only the sizes are looked at.
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.urdf_reading import Drawing, DrawingError, UrdfProblem, read
from onboard.estimation.arrays import FloatArray

FARTHEST_M = 109.0  # the largest thing that flies: the truss of the International Space Station
MOST_KG = 1e6  # it weighs 4.2e5
MOST_ANGLE_RAD = 4.0 * math.pi  # two turns: a rotation of more is in degrees
LEAST_SHARE = 1e-6  # of the vehicle's mass: a lighter link is a frame, to which a converter gave some mass
LEAST = 1e-15  # kg, kg m2: of what a joint moves; MuJoCo's mjMINVAL
FLAT_KG_M2 = 1e-14  # of rounding, by which a flat body's largest moment is more than the sum of the others: MuJoCo's
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_LONGEST_AXIS = 1e6  # of which the square is still a number with all its digits; one over it is the shortest
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_REMEDIES = {
    "m": "lengths are in metres: 300 mm are 0.3",
    "rad": "angles are in radians: 90 degrees are 1.5708",
    "kg": "masses are in kg",
    "kg m2": "inertias are in kg m2, about the centre of mass",
}


class LinkInertial(NamedTuple):
    """What a link weighs.

    Attributes:
        mass_kg: of it.
        inertia_kg_m2: (3, 3) about its centre of mass, in the axes of its ``<inertial>``.
        centre_m: (3,) centre of mass in the link's frame.
        roll_pitch_yaw_rad: (3,) of the axes of its ``<inertial>`` in the link's.
    """

    mass_kg: float
    inertia_kg_m2: FloatArray
    centre_m: FloatArray
    roll_pitch_yaw_rad: FloatArray


def require_flyable(
    urdf: str, base: BaseKind, payload_link: str | None = None, label: str = "the URDF", *, simulated: bool = False
) -> Drawing:
    """The elements of a URDF that can fly.

    An arm on a fixed or prescribed base is identified by rows, which need neither masses nor ranges: drawings of
    recorded arms have links and joints without. Whatever is integrated needs bodies, and something for each joint to
    move.

    Args:
        urdf: its text.
        base: kind of the base; one that follows the arm moves by its mass.
        payload_link: what is held, whose mass is not the base's.
        label: what messages call it.
        simulated: its motion may be integrated, whatever the base; MuJoCo reads the URDF too.

    Raises:
        DrawingError: it cannot; all that is wrong, with lines.
    """
    drawing = read(urdf, label)
    floats = base.follows
    problems = [*_sizes(drawing)] or [*_axes(drawing)]
    if floats or simulated:
        problems = problems or [*_bodies(drawing), *_ranges(drawing)] or [*_carried(drawing)]
    if simulated:
        problems = problems or [*_placed_twice(drawing)]
    if not problems and floats and not base_weighs(drawing, payload_link):
        line = drawing.lines[drawing.links[drawing.root]]
        what = f"the base, link {drawing.root!r} with what is fixed to it, weighs nothing"
        problems = [
            UrdfProblem(line, f"{what}; a link that is {base} moves by its mass and inertia: give it <inertial>")
        ]
    if problems:
        raise DrawingError(problems, label)
    return drawing


def base_weighs(drawing: Drawing, payload_link: str | None = None) -> bool:
    """Whether the root, with what is fixed to it, has a mass besides the payload."""
    masses = {name: own.mass_kg for name, link in drawing.links.items() if (own := inertial_of(link)) is not None}
    group = [masses.get(link, 0.0) for link in drawing.group(drawing.root) if link != payload_link]
    return max(group, default=0.0) > LEAST_SHARE * sum(masses.values())


def inertial_of(link: ET.Element) -> LinkInertial | None:
    """What a link weighs; None without ``<inertial>``. Its numbers are numbers."""
    element = link.find("inertial")
    if element is None:
        return None
    mass, tensor, origin = element.find("mass"), element.find("inertia"), element.find("origin")
    assert mass is not None
    assert tensor is not None
    xx, yy, zz, xy, xz, yz = (float(tensor.get(key, "nan")) for key in _MOMENTS)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return LinkInertial(float(mass.get("value", "nan")), inertia, vector(origin, "xyz"), vector(origin, "rpy"))


def vector(element: ET.Element | None, key: str, default: str = "0 0 0") -> FloatArray:
    """An attribute of three numbers, (3,)."""
    text = default if element is None else element.get(key, default)
    return np.array([float(part) for part in text.split()], np.float64)


def _sizes(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Every number that is read: it is one, finite, and of a size that something can have."""
    for name, link in drawing.links.items():
        for inertial in link.findall("inertial")[:1]:
            who = f"link {name!r}"
            yield from _place(drawing, inertial, f"{who}: centre of mass")
            yield from _numbers(drawing, inertial.find("mass"), ("value",), f"{who}: mass", MOST_KG, "kg")
            largest = MOST_KG * FARTHEST_M**2
            yield from _numbers(drawing, inertial.find("inertia"), _MOMENTS, f"{who}: inertia", largest, "kg m2")
    for joint in drawing.joints.values():
        who = f"joint {joint.name!r}"
        yield from _place(drawing, joint.element, f"{who}: origin")
        axis, limit = joint.element.find("axis"), joint.element.find("limit")
        if joint.moves and axis is not None:
            yield from _vector(drawing, axis, "xyz", f"{who}: axis", _LONGEST_AXIS, "")
        if joint.moves and limit is not None:
            given = [key for key in ("lower", "upper", "effort", "velocity") if limit.get(key) is not None]
            yield from _numbers(drawing, limit, given, f"{who}: limit", math.inf, "")


def _place(drawing: Drawing, parent: ET.Element, who: str) -> Iterator[UrdfProblem]:
    origin = parent.find("origin")
    if origin is not None:
        yield from _vector(drawing, origin, "xyz", who, FARTHEST_M, "m")
        yield from _vector(drawing, origin, "rpy", who, MOST_ANGLE_RAD, "rad")


def _vector(
    drawing: Drawing, element: ET.Element, key: str, who: str, largest: float, unit: str
) -> Iterator[UrdfProblem]:
    """An attribute that is three numbers, where it is given."""
    text = element.get(key)
    parts = [] if text is None else text.split()
    if text is not None and len(parts) != 3:
        yield UrdfProblem(drawing.lines[element], f"{who}: {key}={text!r} is not three numbers; write them with spaces")
        return
    for part in parts:
        yield from _number(drawing.lines[element], part, f"{who}: {key}", largest, unit)


def _numbers(
    drawing: Drawing, element: ET.Element | None, keys: Iterable[str], who: str, largest: float, unit: str
) -> Iterator[UrdfProblem]:
    """Attributes that are a number each, and there."""
    if element is None:
        return
    for key in keys:
        text = element.get(key)
        if text is None:
            yield UrdfProblem(drawing.lines[element], f"{who} has no {key}; add it, in SI units")
        else:
            yield from _number(drawing.lines[element], text.strip(), f"{who}: {key}", largest, unit)


def _number(line: int, text: str, who: str, largest: float, unit: str) -> Iterator[UrdfProblem]:
    if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
        comma = " with a decimal point" if "," in text else ""
        yield UrdfProblem(line, f"{who}={text!r} is no number; write it in digits{comma}")
    elif abs(float(text)) > largest:
        remedy = _REMEDIES.get(unit, "write it as a number near 1")
        yield UrdfProblem(line, f"{who}: {text} {unit} is more than anything that flies has ({largest:.4g}); {remedy}")


def _bodies(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Links whose mass and inertia no body has."""
    for name, link in drawing.links.items():
        own = inertial_of(link)
        if own is None:
            continue
        why = impossible(own.mass_kg, own.inertia_kg_m2) or _too_wide(drawing, name, own)
        if why:
            yield UrdfProblem(drawing.lines[link.findall("inertial")[0]], f"link {name!r} {why}")


def impossible(mass_kg: float, inertia_kg_m2: FloatArray) -> str:
    """Why no body has this mass and this inertia about its centre of mass, with the remedy; "" where one can.

    Args:
        mass_kg: of it.
        inertia_kg_m2: (3, 3), symmetric.
    """
    if mass_kg < 0.0:
        return f"weighs {mass_kg:g} kg; a mass is zero or more"
    if mass_kg == 0.0:
        return "has an inertia and no mass; give it its mass, or neither" if inertia_kg_m2.any() else ""
    a, b, c = (float(moment) for moment in np.linalg.eigvalsh(inertia_kg_m2))
    told = f"has the principal moments of inertia {a:.4g}, {b:.4g} and {c:.4g} kg m2"
    if a < 0.0 or (a < LEAST and _skew(inertia_kg_m2)):
        return f"{told}; each has to be more than zero: correct them, or their products ixy, ixz, iyz"
    if c > a + b + FLAT_KG_M2:
        remedy = "give its inertia about the centre of mass"
        rounded = f"or, if they are rounded, lower the largest by more than {c - a - b:.2g}"
        return f"{told}; none can be more than the sum of the others: {remedy}, {rounded}"
    if c > mass_kg * FARTHEST_M**2:
        return f"{told} with {mass_kg:g} kg: that is {math.sqrt(c / mass_kg):.4g} m from its centre; correct either"
    return ""


def _skew(inertia_kg_m2: FloatArray) -> bool:
    return bool((inertia_kg_m2 - np.diag(np.diag(inertia_kg_m2))).any()) or 0.0 < np.abs(inertia_kg_m2).max() < LEAST


def _too_wide(drawing: Drawing, name: str, own: LinkInertial) -> str:
    """Why its mass would lie beyond its shape; "" where it need not, or where it has none but meshes.

    All its mass in two opposite corners of the box around it has half the box's diagonal as its radius of gyration.
    Twice that is let pass: shapes are drawn simpler, and smaller, than things are.
    """
    link = drawing.links[name]
    shapes = [corners for tag in ("visual", "collision") for part in link.findall(tag) for corners in _corners(part)]
    if not shapes or own.mass_kg == 0.0:
        return ""
    joints = [vector(joint.element.find("origin"), "xyz") for joint in drawing.below(name)]
    points = np.array([np.zeros(3), own.centre_m, *joints, *shapes])
    diagonal_m = float(np.linalg.norm(np.ptp(points, axis=0)))
    largest = float(np.linalg.eigvalsh(own.inertia_kg_m2)[-1])
    if largest <= own.mass_kg * diagonal_m**2:
        return ""
    away_m = math.sqrt(largest / own.mass_kg)
    return (
        f"weighs {own.mass_kg:g} kg and has {largest:.4g} kg m2: all its mass would be {away_m:.3g} m from its centre, "
        f"and its shape is {diagonal_m:.3g} m from end to end; correct its inertia, or its <visual> and <collision>"
    )


def _corners(part: ET.Element) -> list[FloatArray]:
    """The eight corners of the box around a plain shape, in the link's frame; none of a mesh, or of no numbers."""
    geometry = part.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        return []
    try:
        match shape.tag:
            case "box":
                half = 0.5 * vector(shape, "size", "")
            case "cylinder" | "capsule":
                radius = float(shape.get("radius", ""))
                half = np.array([radius, radius, 0.5 * float(shape.get("length", "")) + radius])
            case "sphere":
                half = np.full(3, float(shape.get("radius", "")))
            case _:
                return []
        place, R = vector(part.find("origin"), "xyz"), rotation(vector(part.find("origin"), "rpy"))
        found = [place + R @ (half * (2 * np.array(corner) - 1)) for corner in np.ndindex(2, 2, 2)]
    except ValueError:
        return []
    return found if np.isfinite(found).all() else []


def rotation(roll_pitch_yaw_rad: FloatArray) -> FloatArray:
    """(3, 3): Rz(yaw) Ry(pitch) Rx(roll), as URDF has it."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw_rad), np.sin(roll_pitch_yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _axes(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Axes that have no direction."""
    for joint in drawing.joints.values():
        length = float(np.linalg.norm(vector(joint.element.find("axis"), "xyz", "1 0 0"))) if joint.moves else 1.0
        if length < 1.0 / _LONGEST_AXIS:
            what = f"joint {joint.name!r} has an axis of no length; give its direction, e.g. 0 0 1"
            yield UrdfProblem(drawing.lines[joint.element], what, joint.name)


def _ranges(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Joints without a range, and joints that follow another."""
    for joint in drawing.joints.values():
        if not joint.moves:
            continue
        who, line = f"joint {joint.name!r}", drawing.lines[joint.element]
        limit, mimic = joint.element.find("limit"), joint.element.find("mimic")
        if mimic is not None:
            what = f"{who} follows {mimic.get('joint')!r}, which is not simulated"
            yield UrdfProblem(line, f"{what}; make it fixed, or take <mimic> out where it is measured", joint.name)
        if joint.kind == "continuous":
            continue
        if limit is None:
            yield UrdfProblem(line, f"{who} has no <limit>; add it with lower and upper, or make it fixed", joint.name)
            continue
        low, high = (float(limit.get(key, "0")) for key in ("lower", "upper"))
        if not low < high:
            what = f"{who} goes from {low:g} to {high:g}"
            yield UrdfProblem(line, f"{what}; write lower below upper in its <limit>, or make it fixed", joint.name)


def _carried(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Joints that move nothing: a torque on them would have no finite acceleration."""
    for joint in drawing.joints.values():
        if joint.moves and not any(_resists(drawing.links[link]) for link in drawing.group(joint.child)):
            what = f"link {joint.child!r}, which joint {joint.name!r} moves, has no mass or no inertia"
            yield UrdfProblem(
                drawing.lines[drawing.links[joint.child]],
                f"{what}, nor has what is fixed to it; give it <inertial>, or make the joint fixed",
                joint.name,
            )


def _placed_twice(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Second origins: readers of URDF take the first, and MuJoCo refuses the file."""
    for link in drawing.links.values():
        yield from _second_origin(drawing, link.findall("inertial"))
    yield from _second_origin(drawing, (joint.element for joint in drawing.joints.values()))


def _second_origin(drawing: Drawing, elements: Iterable[ET.Element]) -> Iterator[UrdfProblem]:
    for element in elements:
        for again in element.findall("origin")[1:2]:
            what = f"<{element.tag}> has <origin> a second time; take either out"
            yield UrdfProblem(drawing.lines[again], what)


def _resists(link: ET.Element) -> bool:
    own = inertial_of(link)
    return own is not None and own.mass_kg > LEAST and float(np.linalg.eigvalsh(own.inertia_kg_m2)[-1]) > LEAST
