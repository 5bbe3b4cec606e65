"""Triangles of the URDF's visuals, as few as a browser draws with ease on a plain canvas.

Boxes, cylinders and spheres are made of their sizes. Files are read where the URDF lies and nowhere else, STL (binary
or text) and OBJ, no larger than :data:`MOST_BYTES`; of a URDF out of a log, which lies nowhere, none is. What cannot be
read is left out and counted; a link of which nothing is left is drawn as its collision geometry. Corners that lie in
one cell of a grid are joined, the grid as coarse as it takes (vertex clustering: Rossignac and Borrel, 1993).
"""

import contextlib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.model.urdf_check import rotation

MOST_BYTES = 16 << 20  # of a file
MOST_TRIANGLES, MOST_MESHES = 3000, 60  # of a vehicle
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_CORNER = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_SIDES = 16  # of a round body
_FINEST, _COARSEST = 64, 2  # cells along the longest side
Triangles = NDArray[np.float64]  # (n, 3, 3): corners, m


class DrawnMeshes(NamedTuple):
    """What is drawn of a vehicle."""

    corners: dict[str, list[float]]  # of triangles by link, nine numbers each, in the link's frame, m
    left_out: int  # visuals that cannot be read, or are too many


def meshes_of(urdf: bytes, directory: Path | None) -> DrawnMeshes:
    """Triangles of a vehicle's links.

    Args:
        urdf: of the vehicle.
        directory: where it lies; None: no file is read.
    """
    try:
        links = ET.fromstring(urdf).findall("link")
    except ET.ParseError:
        return DrawnMeshes({}, 0)
    whole: dict[str, Triangles] = {}
    left_out, room = 0, MOST_MESHES
    for link in links:
        visuals = link.findall("visual")
        parts = _parts(visuals[:room], directory)
        left_out += len(visuals) - len(parts)
        room -= min(room, len(visuals))
        if len(visuals) > len(parts) == 0:
            parts = _parts(link.findall("collision")[:room], directory)
            room -= len(parts)
        if parts:
            whole[link.attrib.get("name", "")] = np.concatenate(parts)
    total = sum(map(len, whole.values()))
    kept = {name: _fewer(mesh, max(12, MOST_TRIANGLES * len(mesh) // total)) for name, mesh in whole.items()}
    return DrawnMeshes({name: _short(mesh) for name, mesh in kept.items()}, left_out)


def _parts(shapes: Sequence[ET.Element], directory: Path | None) -> list[Triangles]:
    """Of those that can be read."""
    found: list[Triangles] = []
    for shape in shapes:
        with contextlib.suppress(OSError, ValueError, KeyError):  # not there, or not to be read
            found += _placed(shape, directory)
    return found


def _placed(visual: ET.Element, directory: Path | None) -> Iterator[Triangles]:
    shape = visual.find("geometry/*")
    if shape is None:
        return
    origin = visual.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = ([float(word) for word in given.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    triangles = _shaped(shape, directory) @ rotation(np.array(rpy)).T + xyz
    if not np.isfinite(triangles).all():
        raise ValueError("its corners are no numbers")
    yield triangles


def _shaped(shape: ET.Element, directory: Path | None) -> Triangles:
    """Of a ``<mesh>``, ``<box>``, ``<cylinder>`` (along z) or ``<sphere>``, in its own frame.

    Raises:
        ValueError: it is none of these, or in a file that cannot be had.
    """

    def numbers(name: str, otherwise: str = "") -> NDArray[np.float64]:
        return np.array(shape.attrib.get(name, otherwise).split(), np.float64)

    prism = np.array([[0.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 1.0]])
    if shape.tag == "mesh" and directory is not None:
        return read(_path(shape.attrib["filename"], directory)) * numbers("scale", "1 1 1")
    if shape.tag == "box":
        return _turned(prism * [2.0**0.5, 1.0], 4) * numbers("size") / 2.0
    if shape.tag == "cylinder":
        return _turned(prism * np.array([shape.attrib["radius"], shape.attrib["length"]], float) / [1.0, 2.0], _SIDES)
    if shape.tag == "sphere":
        angle = np.linspace(0.0, np.pi, _SIDES // 2 + 1)
        return _turned(np.stack([np.sin(angle), -np.cos(angle)], axis=1) * float(shape.attrib["radius"]), _SIDES)
    raise ValueError(f"{shape.tag} is no shape of a URDF, or in a file")


def _turned(profile: NDArray[np.float64], sides: int) -> Triangles:
    """Surface of ``profile`` (n, 2: distance from z, z) turned about z in so many steps, seen from outside."""
    angle = 2.0 * np.pi * (np.arange(sides + 1) + 0.5) / sides
    distance, height = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), sides + 1))
    at = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=2)  # (n, sides + 1, 3)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    return np.concatenate([np.stack(one, axis=2).reshape(-1, 3, 3) for one in ((a, b, c), (a, c, d))])


def _path(name: str, directory: Path) -> Path:
    """Beside the URDF; of ``package://NAME/...`` what follows the package, tried from there.

    Raises:
        ValueError: it lies elsewhere.
    """
    package, _, rest = name.removeprefix("package://").partition("/")
    tried = [directory / rest, directory / package / rest] if name.startswith("package://") else []
    tried = tried or [directory / name.removeprefix("file://")]
    path = next((place for place in tried if place.is_file()), tried[0]).resolve()
    if not path.is_relative_to(directory.resolve()):
        raise ValueError(f"{name} does not lie beside the URDF")
    return path


def read(path: Path) -> Triangles:
    """Triangles of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large, or neither STL nor OBJ.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path.name} has more than {MOST_BYTES >> 20} MiB")
    data, kind = path.read_bytes(), path.suffix.lower()
    if kind == ".obj":
        return _obj(data)
    if kind != ".stl":
        raise ValueError(f"{path.name} is neither STL nor OBJ")
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + count * _STL.itemsize and count:
        return np.frombuffer(data, _STL, count, 84)["corners"].astype(np.float64)
    corners = np.array(_CORNER.findall(data), np.float64)
    if not len(corners) or len(corners) % 3:
        raise ValueError(f"{path.name} is no STL")
    return corners.reshape(-1, 3, 3)


def _obj(data: bytes) -> Triangles:
    """Faces with more corners are fans of triangles; indices count from 1, or back from the last corner so far."""
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in data.split(b"\n"):
        word, *rest = line.split() or [b""]
        if word == b"v":
            points.append([float(word) for word in rest[:3]])
        elif word == b"f":
            at = [int(corner.partition(b"/")[0]) for corner in rest]
            at = [corner - 1 if corner > 0 else len(points) + corner for corner in at]
            if not all(0 <= corner < len(points) for corner in at):
                raise ValueError("a face has a corner that is not there")
            faces += [(at[0], at[k], at[k + 1]) for k in range(1, len(at) - 1)]
    if not faces:
        raise ValueError("it has no face")
    triangles: Triangles = np.array(points)[np.array(faces)]
    return triangles


def _fewer(triangles: Triangles, most: int) -> Triangles:
    """No more than ``most``, with corners that are means of those that they stand for."""
    points = triangles.reshape(-1, 3)
    low = points.min(axis=0)
    side, cells = float((points.max(axis=0) - low).max()) or 1.0, _FINEST
    while len(triangles) > most and cells >= _COARSEST:
        cell = np.floor((points - low) / side * cells).astype(np.int64)
        _, of, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
        means = np.stack([np.bincount(of.ravel(), points[:, k]) for k in range(3)], axis=1) / count[:, None]
        corners = np.sort(of.reshape(-1, 3), axis=1)
        whole = (np.diff(corners, axis=1) > 0).all(axis=1)
        _, first = np.unique(corners[whole], axis=0, return_index=True)
        triangles = means[of.reshape(-1, 3)[whole][first]]
        cells = cells * 3 // 4
    return triangles[:most]


def _short(triangles: Triangles) -> list[float]:
    """Rounded to a ten-thousandth of their reach: a third of the bytes."""
    reach = float(np.abs(triangles).max(initial=1e-9))
    return [float(number) for number in np.round(triangles.ravel(), 4 - int(np.floor(np.log10(reach))))]
