"""Packages of RTDE, protocol version 2, big-endian: uint16 size of the whole, uint8 type, payload. No port, no clock.

Universal Robots, "RTDE Guide": types are ASCII letters, see ``VERSION`` to ``DATA``. A stream of them has no mark to
find the next one by: after a header that cannot be, the connection has to be opened anew.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import FrameError
from drivers.serial_line.frames import ReceivedBuffer

VERSION, URCONTROL, TEXT, OUTPUTS, START, DATA = b"VvMOSU"
INPUTS, PAUSE = b"IP"  # inputs are never sent by us
HEADER = struct.Struct(">HB")
PROTOCOL = 2
LARGEST = 4096  # the guide's limit of a package's size is 65535; all outputs together have 2 kB
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
TYPES = {  # of outputs
    "BOOL": ">u1",
    "UINT8": ">u1",
    "UINT32": ">u4",
    "UINT64": ">u8",
    "INT32": ">i4",
    "DOUBLE": ">f8",
    "VECTOR3D": "(3,)>f8",
    "VECTOR6D": "(6,)>f8",
    "VECTOR6INT32": "(6,)>i4",
    "VECTOR6UINT32": "(6,)>u4",
}
_KNOWN = frozenset((VERSION, URCONTROL, TEXT, OUTPUTS, START, DATA, INPUTS, PAUSE))


class RtdeChannel(NamedTuple):
    """A channel of SCALAR rows.

    Attributes:
        channel: Its name.
        variable: Output of the controller, of type VECTOR6D.
        place: Which of its six values.
        scale: ``unit`` per count of the rows; negative where the channel runs against the variable.
        unit: SI.
    """

    channel: str
    variable: str
    place: int
    scale: float
    unit: str


class Package(NamedTuple):
    """A whole package: its type and what follows the header."""

    kind: int
    payload: bytes


class Text(NamedTuple):
    """A message of the controller; ``level``: 0 exception, 1 error, 2 warning, 3 information."""

    message: str
    source: str
    level: int


class Recipe(NamedTuple):
    """What a data package holds: variables in their order, by name, and the type that the controller says."""

    identifier: int
    types: dict[str, str]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of a data package's payload; ``recipe`` is the first field."""
        return np.dtype([("recipe", "u1"), *((name, TYPES[told]) for name, told in self.types.items())])

    def unusable(self, wanted: dict[str, str]) -> dict[str, str]:
        """Variables that are not of the wanted type, and what the controller says instead."""
        return {name: told for name, told in self.types.items() if told != wanted[name]}


def package(kind: int, payload: bytes = b"") -> bytes:
    """A package to send."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def version_request() -> bytes:
    """Ask for protocol version 2."""
    return package(VERSION, struct.pack(">H", PROTOCOL))


def outputs_request(rate_hz: float, names: Iterable[str]) -> bytes:
    """Ask for these outputs, so many times a second."""
    return package(OUTPUTS, struct.pack(">d", rate_hz) + ",".join(names).encode("ascii"))


def decode_accepted(payload: bytes) -> bool:
    """The answer to ``VERSION`` or ``START``.

    Raises:
        FrameError: It has another length.
    """
    if len(payload) != 1:
        raise FrameError(f"an answer of {len(payload)} bytes is not accepted and not refused")
    return bool(payload[0])


def decode_urcontrol(payload: bytes) -> str:
    """The controller's software: major, minor, bugfix, build.

    Raises:
        FrameError: It has another length.
    """
    if len(payload) != 16:
        raise FrameError(f"{len(payload)} bytes are no URControl version")
    return ".".join(str(number) for number in struct.unpack(">4I", payload))


def decode_recipe(payload: bytes, names: Sequence[str]) -> Recipe:
    """The answer to a request for outputs ``names``.

    Raises:
        FrameError: It is no such answer, or a type is unknown.
    """
    told = payload[1:].decode("ascii", "replace").split(",")
    if not payload or len(told) != len(names):
        raise FrameError(f"{len(told)} types for {len(names)} outputs")
    for name, kind in zip(names, told, strict=True):
        if kind not in TYPES and kind not in (NOT_FOUND, IN_USE):
            raise FrameError(f"{name} has the unknown type {kind[:20]!r}")
    return Recipe(payload[0], dict(zip(names, told, strict=True)))


def decode_text(payload: bytes) -> Text:
    """A message: length and text, length and source, level.

    Raises:
        FrameError: The lengths do not fit.
    """
    at, parts = 0, []
    for _ in range(2):
        end = at + 1 + payload[at] if at < len(payload) else len(payload) + 1
        parts.append(payload[at + 1 : end].decode("utf-8", "replace"))
        at = end
    if at != len(payload) - 1:
        raise FrameError(f"a message of {len(payload)} bytes with other lengths in it")
    return Text(parts[0], parts[1], payload[at])


class PackageStream(ReceivedBuffer):
    """Splits a byte stream into packages: ``receive`` bytes, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.
    """

    def take(self) -> Package | None:
        """The next package; None when more bytes are needed.

        Raises:
            FrameError: No header of a package; all bytes were discarded.
        """
        if len(self.waiting) < HEADER.size:
            return None
        size, kind = HEADER.unpack_from(self.waiting)
        if kind not in _KNOWN or not HEADER.size <= size <= LARGEST:
            self.clear()
            raise FrameError(f"no RTDE package: type {kind}, {size} bytes: is it the port 30004 of a controller?")
        if len(self.waiting) < size:
            return None
        payload, self.waiting = self.waiting[HEADER.size : size], self.waiting[size:]
        return Package(kind, payload)
