"""Reads a URDF's names and tree, with the line of each element; what is not one tree of links is refused by name.

The standard library's XML parser alone. Numbers are judged in :mod:`onboard.dynamics.model.urdf_check`.
"""

import difflib
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple
from xml.parsers import expat

from onboard.dynamics.model.errors import UrdfError

MOVING = ("revolute", "continuous", "prismatic")
MOST_JOINTS = 127  # that move: the nodes of a CAN bus (CiA 301); memory goes with their square, 0.25 GB at 127
MOST_LINKS = 2000  # the largest of 270 URDFs of other people's robots has 190
MOST_TOLD = 8  # problems: who has the first eight knows what is wrong
_WORDS = {  # expat's, in ours
    "no element found": "it ends before its last tag is closed, or is empty",
    "unbound prefix": "a tag's prefix is declared nowhere: write it out with xacro, or take the tag out",
    "XML or text declaration not at start of entity": "something stands before <?xml: take it out",
    "mismatched tag": "a tag is closed that is not open: look at the tags before it",
    "not well-formed (invalid token)": "a character stands where none may: a quote, < or & is missing or too many",
}


class UrdfProblem(NamedTuple):
    """Why a URDF cannot fly.

    Attributes:
        line: in its text.
        text: what is wrong, of which element, and the remedy.
        joint: one that would be no problem if it were fixed; "" where that helps nothing.
    """

    line: int
    text: str
    joint: str = ""


class UrdfJoint(NamedTuple):
    """A ``<joint>``: its element, name, type and links."""

    element: ET.Element
    name: str
    kind: str
    parent: str
    child: str

    @property
    def moves(self) -> bool:
        """Whether it is not fixed."""
        return self.kind in MOVING


class Drawing(NamedTuple):
    """The elements of a URDF in which no name and no tag is wrong.

    Attributes:
        links: by name, in the order of the file.
        joints: by name.
        root: link that all others hang on.
        carried: joints by the link that carries them.
        lines: where each element begins.
    """

    links: dict[str, ET.Element]
    joints: dict[str, UrdfJoint]
    root: str
    carried: dict[str, list[UrdfJoint]]
    lines: dict[ET.Element, int]

    def below(self, link: str) -> list[UrdfJoint]:
        """Joints that a link carries."""
        return self.carried.get(link, [])

    def group(self, link: str) -> list[str]:
        """A link and all that is fixed to it, outwards."""
        found = [link]
        for each in found:
            found += [joint.child for joint in self.below(each) if not joint.moves]
        return found


class DrawingError(UrdfError):
    """Why a URDF cannot be used.

    Attributes:
        problems: by line.
        label: what its file is called.
    """

    def __init__(self, problems: Iterable[UrdfProblem], label: str) -> None:
        self.problems, self.label = tuple(sorted(problems)), label
        told = [f"{label}:{one.line}: {one.text}" for one in self.problems[:MOST_TOLD]]
        more = len(self.problems) - len(told)
        super().__init__("\n".join([*told, *([f"{label}: and {more} more like these"] if more else [])]))


def read(urdf: str, label: str) -> Drawing:
    """The elements of a URDF, of which names and tree are right.

    Raises:
        DrawingError: they are not.
    """
    try:
        robot, lines = _parsed(urdf)
    except expat.ExpatError as error:
        why = str(expat.ErrorString(error.code))
        raise DrawingError([UrdfProblem(error.lineno, f"no XML: {_WORDS.get(why, why)}")], label) from error
    if problems := _foreign(robot, lines):
        raise DrawingError(problems, label)
    links, joints = robot.findall("link"), robot.findall("joint")
    problems = [*_names(links, lines), *_names(joints, lines)] or [*_tags(links, joints, lines)]
    if problems:
        raise DrawingError(problems, label)
    by_name = {str(link.get("name")): link for link in links}
    made = [_joint(element) for element in joints]
    carried = defaultdict(list)
    for joint in made:
        carried[joint.parent].append(joint)
    children = {joint.child for joint in made}
    roots = [name for name in by_name if name not in children]
    root = roots[0] if roots else ""
    drawing = Drawing(by_name, {joint.name: joint for joint in made}, root, dict(carried), lines)
    if problems := [*_references(drawing)] or [*_tree(drawing, roots)]:
        raise DrawingError(problems, label)
    return drawing


def plain(drawing: Drawing) -> str:
    """The URDF without all that is neither inertia nor joint: nothing in a picture keeps a model from being made."""
    robot = ET.Element("robot", name="vehicle")
    for name, link in drawing.links.items():
        made = ET.SubElement(robot, "link", name=name)
        made.extend(link.findall("inertial")[:1])
    for joint in drawing.joints.values():
        made = ET.SubElement(robot, "joint", name=joint.name, type=joint.kind)
        wanted = ("origin", "parent", "child", *(("axis", "limit") if joint.moves else ()))
        made.extend(part for tag in wanted if (part := joint.element.find(tag)) is not None)
    return ET.tostring(robot, encoding="unicode")


def _parsed(urdf: str) -> tuple[ET.Element, dict[ET.Element, int]]:
    """The root, and the line of each element."""
    builder, parser = ET.TreeBuilder(), expat.ParserCreate(namespace_separator="}")
    lines: dict[ET.Element, int] = {}

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler, parser.EndElementHandler = start, builder.end
    parser.Parse(urdf.encode("utf-8", "replace"), True)
    return builder.close(), lines


def _joint(element: ET.Element) -> UrdfJoint:
    parent, child = element.find("parent"), element.find("child")
    ends = ("" if end is None else str(end.get("link")) for end in (parent, child))
    return UrdfJoint(element, str(element.get("name")), str(element.get("type")), *ends)


def _foreign(robot: ET.Element, lines: dict[ET.Element, int]) -> list[UrdfProblem]:
    if robot.tag.endswith("}robot"):
        space = robot.tag.removesuffix("}robot")
        remedy = 'take xmlns="..." out of <robot>; xmlns:NAME="..." may stay'
        return [UrdfProblem(lines[robot], f"its tags are in the namespace {space!r}, URDF's are in none: {remedy}")]
    if robot.tag != "robot":
        return [UrdfProblem(lines[robot], f"no URDF: its first tag is <{robot.tag}>, not <robot>; convert it to URDF")]
    for element in robot.iter():
        if "xacro}" in element.tag:
            remedy = "write it out first: xacro FILE > robot.urdf"
            return [UrdfProblem(lines[element], f"written for xacro (<xacro:{element.tag.split('}')[1]}>); {remedy}")]
    if robot.find("link") is None:
        return [UrdfProblem(lines[robot], "it has no <link>; a vehicle has a base and the links of its arm")]
    return []


def _names(elements: list[ET.Element], lines: dict[ET.Element, int]) -> Iterator[UrdfProblem]:
    """Elements without a name, with one that cannot be read, or with that of another."""
    first: dict[str, int] = {}
    for element in elements:
        name, line = element.get("name"), lines[element]
        if not name or not name.isprintable() or name != name.strip():
            yield UrdfProblem(line, f"<{element.tag} name={name!r}>: give it a name of letters, digits, - and _")
        elif name in first:
            yield UrdfProblem(line, f"{element.tag} {name!r} stands in line {first[name]} too; rename either")
        else:
            first[name] = line


def _tags(links: list[ET.Element], joints: list[ET.Element], lines: dict[ET.Element, int]) -> Iterator[UrdfProblem]:
    """Elements that are missing, too many, or of a type that nobody knows."""
    for element in (*links, *joints, *(part for link in links for part in link.findall("inertial"))):
        for tag in ("inertial", "mass", "inertia", "parent", "child", "axis", "limit", "mimic"):
            if len(found := element.findall(tag)) > 1:
                yield UrdfProblem(lines[found[1]], f"<{element.tag}> has <{tag}> a second time; take either out")
    for link in links:
        for inertial in link.findall("inertial"):
            if missing := [tag for tag in ("mass", "inertia") if inertial.find(tag) is None]:
                what = f"link {link.get('name')!r}: <inertial> has no <{missing[0]}>"
                yield UrdfProblem(lines[inertial], f"{what}; <inertial> needs <mass> and <inertia>: add it")
    for joint in joints:
        kind, who = joint.get("type"), f"joint {joint.get('name')!r}"
        if kind not in ("fixed", *MOVING):
            free = ': base = "free" lets the root go, take joint and world out' if kind == "floating" else ""
            known = f"fixed, {', '.join(MOVING)} ones can fly"
            yield UrdfProblem(lines[joint], f"{who} is {kind!r}; {known}{free}", str(joint.get("name")))
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is None or not end.get("link"):
                yield UrdfProblem(lines[joint], f'{who} lacks <{tag} link="...">; add it')


def _references(drawing: Drawing) -> Iterator[UrdfProblem]:
    """Links that are not there, and links that hang on two joints."""
    hangs: dict[str, str] = {}
    for joint in drawing.joints.values():
        for name in (joint.parent, joint.child):
            if name not in drawing.links:
                near = difflib.get_close_matches(name, drawing.links, 1, 0.5)
                meant = f"did you mean {near[0]!r}?" if near else f"it has {shortened(drawing.links)}"
                what = f"joint {joint.name!r} names link {name!r}, which is not there"
                yield UrdfProblem(drawing.lines[joint.element], f"{what}; {meant}")
        if hangs.setdefault(joint.child, joint.name) != joint.name:
            what = f"link {joint.child!r} hangs on joint {joint.name!r} and on {hangs[joint.child]!r}"
            yield UrdfProblem(
                drawing.lines[joint.element], f"{what}; a link has a single joint before it: cut the loop"
            )


def _tree(drawing: Drawing, roots: list[str]) -> Iterator[UrdfProblem]:
    """A forest, a ring, or more than can be handled."""
    first, moving = next(iter(drawing.links.values())), sum(one.moves for one in drawing.joints.values())
    if len(roots) != 1:
        what = f"it hangs on {shortened(roots) or 'nothing, for its joints go in a ring'}"
        element = drawing.links[roots[1]] if roots else first
        yield UrdfProblem(
            drawing.lines[element], f"{what}; a vehicle has a single root: join the others to it by fixed joints"
        )
        return
    if len(drawing.links) > MOST_LINKS or moving > MOST_JOINTS:
        what = f"it has {len(drawing.links)} links and {moving} joints that move"
        remedy = f"{MOST_LINKS} and {MOST_JOINTS} are the most: make joints fixed that are not measured"
        yield UrdfProblem(drawing.lines[first], f"{what}; {remedy}")
        return
    reached = [drawing.root]
    for name in reached:
        reached += [joint.child for joint in drawing.below(name)]
    inside = set(reached)
    if lost := [name for name in drawing.links if name not in inside]:
        what = f"link {lost[0]!r} is in a ring of joints"
        yield UrdfProblem(drawing.lines[drawing.links[lost[0]]], f"{what} that hangs on nothing; cut it")


def shortened(names: Iterable[str]) -> str:
    """Names in a row, the first twelve."""
    listed = list(names)
    return ", ".join(listed[:12]) + (f" and {len(listed) - 12} more" if len(listed) > 12 else "")
