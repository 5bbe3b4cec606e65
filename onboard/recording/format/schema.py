"""Converts dtypes to ``ros2msg`` text and back: the self-description of a log.

A row of an ``align=True`` little-endian dtype has the CDR layout (OMG DDS-XTypes 1.3, section 7.4.1, plain CDR version
1) of the same fields: natural alignment counted from the end of the 4-byte encapsulation header. So the message is the
header and the row's bytes up to the end of its last field: readers refuse messages with more than three bytes over.

What ``ros2msg`` cannot express is in the comment after a field, and the dtype is rebuilt from the text alone::

    uint64 sequence
    int16[3] accel_raw
    uint8[32] channel # S32
    float64[6] covariance # shape=2x3 [kg^2]
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from math import prod

import numpy as np

from drivers import marks, records
from onboard import channels
from onboard.recording.format.errors import SchemaError

CDR_HEADER = b"\x00\x01\x00\x00"  # plain CDR version 1, little-endian, no options

_ROS_OF_KIND = {
    "|b1": "bool",
    "|i1": "int8",
    "|u1": "uint8",
    "<i2": "int16",
    "<u2": "uint16",
    "<i4": "int32",
    "<u4": "uint32",
    "<i8": "int64",
    "<u8": "uint64",
    "<f4": "float32",
    "<f8": "float64",
}
_KIND_OF_ROS = {ros: kind for kind, ros in _ROS_OF_KIND.items()}
_NAME = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")  # rosidl: VALID_FIELD_NAME_PATTERN
_UNIT = re.compile(r"[^\[\],#\n\r]+")
_FIELD = re.compile(
    r"(?P<type>[a-z0-9]+)(?:\[(?P<count>\d+)\])? (?P<name>[a-z][a-z0-9_]*)"
    r"(?: #(?: (?P<text>S\d+))?(?: shape=(?P<shape>\d+(?:x\d+)*))?(?: \[(?P<unit>[^\[\],#]+)\])?)?"
)


@lru_cache(maxsize=256)
def message_bytes(dtype: np.dtype[np.void]) -> int:
    """Bytes of a row in a message: all up to the end of its last field."""
    assert dtype.fields is not None
    return max(offset + field.itemsize for field, offset, *_ in dtype.fields.values())


def ros2msg(dtype: np.dtype[np.void], units: Mapping[str, str] | None = None) -> str:
    """The message definition of ``dtype``; ``units`` (field name to unit) go into the comments.

    Raises:
        SchemaError: a field that ROS 2 cannot name or hold, a byte order or layout that is not ours, or a unit of a
            field that does not exist.
    """
    units = {} if units is None else units
    if dtype.names is None or dtype.fields is None:
        raise SchemaError(f"a channel holds structured rows, not {dtype}; use a dtype such as those of drivers.records")
    if unknown := sorted(set(units) - set(dtype.names)):
        raise SchemaError(f"units given for {unknown}, which the dtype does not have; its fields are {dtype.names}")
    text = "".join(_line(name, dtype.fields[name][0], units.get(name)) for name in dtype.names)
    if dtype_from_ros2msg(text) != dtype:
        raise SchemaError(f"the fields {dtype.names} are not laid out as CDR lays them out; build it with align=True")
    return text


def _line(name: str, field: np.dtype[np.generic], unit: str | None) -> str:
    if not _NAME.fullmatch(name):
        raise SchemaError(f"field {name!r} is no ROS 2 field name; use lower-case letters, digits, single underscores")
    if unit is not None and not _UNIT.fullmatch(unit):
        raise SchemaError(f"unit {unit!r} of field {name!r}: leave out brackets, commas, # and line ends")
    base, shape, comment = field.base, field.shape, []
    count = prod(shape)
    if base.kind == "S" and base.itemsize:
        ros, ros_count = "uint8", count * base.itemsize
        comment.append(base.str[1:])
        plain = shape == ()
    elif base.str in _ROS_OF_KIND:
        ros, ros_count = _ROS_OF_KIND[base.str], count
        plain = len(shape) <= 1
    else:
        raise SchemaError(
            f"field {name!r} is of type {base.str!r}; use little-endian integers and floats of 4 or 8 bytes, bool, S"
        )
    if not count:
        raise SchemaError(f"field {name!r} has shape {shape}, which holds nothing; leave the field out")
    if not plain:
        comment.append("shape=" + "x".join(map(str, shape)))
    if unit is not None:
        comment.append(f"[{unit}]")
    array = f"[{ros_count}]" if shape or base.kind == "S" else ""
    return f"{ros}{array} {name}" + (f" # {' '.join(comment)}" if comment else "") + "\n"


def _parse(text: str) -> list[re.Match[str]]:
    matches = [_FIELD.fullmatch(line) for line in text.splitlines()]
    if not matches:
        raise SchemaError("the schema text is empty; the log was not written by heft")
    if None in matches:
        line = text.splitlines()[matches.index(None)]
        raise SchemaError(f"schema line {line!r} is none that heft writes; read this log with a ROS 2 tool")
    return [match for match in matches if match is not None]


def dtype_from_ros2msg(text: str) -> np.dtype[np.void]:
    """The dtype whose rows a message of definition ``text`` holds.

    Raises:
        SchemaError: the text is not one of ``ros2msg``.
    """
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for match in _parse(text):
        kind = _KIND_OF_ROS.get(match["type"])
        count = None if match["count"] is None else int(match["count"])
        if kind is None:
            raise SchemaError(
                f"schema type {match['type']!r} is none that heft writes; read this log with a ROS 2 tool"
            )
        shape = tuple(int(n) for n in match["shape"].split("x")) if match["shape"] else None
        size = 1
        if match["text"]:
            kind, size = match["text"], int(match["text"][1:])
            shape = () if shape is None else shape
        elif shape is None:
            shape = () if count is None else (count,)
        if not size or not prod(shape) or size * prod(shape) != (1 if count is None else count):
            raise SchemaError(f"schema field {match['name']!r}: {count} elements do not make the shape {shape}")
        fields.append((match["name"], kind, shape))
    try:
        return np.dtype([(name, kind, shape) if shape else (name, kind) for name, kind, shape in fields], align=True)
    except ValueError as error:
        raise SchemaError(f"the schema text makes no dtype ({error}); the log was not written by heft") from error


def units_from_ros2msg(text: str) -> dict[str, str]:
    """Field name to unit, for those fields whose comment names one.

    Raises:
        SchemaError: the text is not one of ``ros2msg``.
    """
    return {match["name"]: match["unit"] for match in _parse(text) if match["unit"]}


_SIZED = (channels.tick_dtype(1), channels.estimate_dtype(1, 1), channels.row_dtype(1, 1))  # vehicles have others


@lru_cache(maxsize=1)
def _records() -> dict[tuple[str, ...], np.dtype[np.void]]:
    """Records of ``drivers`` and ``onboard.channels`` by the names of their fields, which no two have in common."""
    every = [*_SIZED, *(value for module in (records, marks, channels) for value in vars(module).values())]
    return {value.names: value for value in every if isinstance(value, np.dtype) and value.names}


def is_altered(dtype: np.dtype[np.void]) -> bool:
    """Whether it has the fields of one of our records, and of other kinds or shapes."""
    ours = _records().get(dtype.names or (), dtype)
    if ours not in _SIZED:
        return dtype != ours
    return any(dtype[name].base != ours[name].base or dtype[name].ndim != ours[name].ndim for name in ours.names or ())


def message_name(channel: str, dtype: np.dtype[np.void]) -> str:
    """ROS 2 name of the message: that of the record in ``drivers.records`` or ``onboard.channels``, else the channel's.

    ``imu_base`` with dtype ``records.IMU`` is a ``heft/msg/Imu``.
    """
    named = [item for module in (records, marks, channels) for item in vars(module).items()]
    known = (name for name, value in named if isinstance(value, np.dtype) and value == dtype)
    words = re.split(r"[^0-9A-Za-z]+", next(known, channel))
    name = "".join(word.capitalize() for word in words)
    return "heft/msg/" + (name if name[:1].isalpha() else f"Channel{name}")
