"""Writes identified inertial parameters into a URDF."""

from collections.abc import Mapping
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.inertia import RigidBody

_TENSOR = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}


class _Span(NamedTuple):
    start: int  # bytes
    end: int


class _Link(NamedTuple):
    tag: _Span  # of its start
    inertials: list[_Span]


def with_bodies(urdf: str, bodies: Mapping[str, RigidBody]) -> str:
    """The URDF with the inertials of some links replaced and all other text unchanged.

    Args:
        urdf: text of a URDF file.
        bodies: by link: mass, centre of mass and inertia about it, in the link's frame. Numbers are written to the last
            bit.

    Raises:
        UnknownFrameError: a link that the URDF does not have.
    """
    data = urdf.encode("utf-8")
    links = _links(data)
    if missing := set(bodies) - set(links):
        raise UnknownFrameError(f"the URDF has no link {', '.join(sorted(missing))}; it has {', '.join(links)}")
    edits: list[tuple[_Span, str]] = []
    for name, body in bodies.items():
        tag, inertials = links[name]
        if inertials:
            edits.append((inertials[0], _inertial(body)))
            edits += [(other, "") for other in inertials[1:]]
        elif data[tag.end - 2 : tag.end] == b"/>":
            edits.append((_Span(tag.end - 2, tag.end), f">\n    {_inertial(body)}\n  </link>"))
        else:
            edits.append((_Span(tag.end, tag.end), f"\n    {_inertial(body)}"))
    for span, text in sorted(edits, reverse=True):
        data = data[: span.start] + text.encode("utf-8") + data[span.end :]
    return data.decode("utf-8")


def _links(data: bytes) -> dict[str, _Link]:
    """Byte ranges of the links' start tags and inertials."""
    found: dict[str, _Link] = {}
    path: list[tuple[str, int]] = []
    parser = expat.ParserCreate()

    def tag_end() -> int:
        at, quote = parser.CurrentByteIndex, 0
        while data[at] != ord(">") or quote:
            if data[at] in b"\"'" and quote in (0, data[at]):
                quote = data[at] - quote
            at += 1
        return at + 1

    def start(name: str, attributes: dict[str, str]) -> None:
        if name == "link" and len(path) == 1:
            found[attributes["name"]] = _Link(_Span(parser.CurrentByteIndex, tag_end()), [])
        path.append((name, parser.CurrentByteIndex))

    def end(name: str) -> None:
        _, began = path.pop()
        if name == "inertial" and len(path) == 2 and path[1][0] == "link":
            list(found.values())[-1].inertials.append(_Span(began, tag_end()))

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return found


def _inertial(body: RigidBody) -> str:
    xyz = " ".join(repr(float(value)) for value in np.asarray(body.centre_of_mass_m))
    tensor = " ".join(f'{key}="{float(body.inertia_kg_m2[at])!r}"' for key, at in _TENSOR.items())
    return (
        f'<inertial>\n      <origin xyz="{xyz}" rpy="0 0 0"/>\n      <mass value="{float(body.mass_kg)!r}"/>\n'
        f"      <inertia {tensor}/>\n    </inertial>"
    )
