"""Serialises the estimator's object tree as data (JSON and arrays), without executable content.

A state is a head (:data:`_HEAD`), the tree as JSON, and the bytes of all arrays, each from a multiple of 8 on. The head
has the tree's length and CRC, and the sum of the arrays' 64-bit words: a CRC over megabytes, as ZIP files have it,
takes as long as all else that is done to write them.

Only values are written: numbers, text, arrays, containers, and the attributes of instances of our own numerical
classes. Parts that a new object of the same kind has anyway and that never change (vehicle file, models, types,
functions, arrays that cannot be written to) are referred to by their place in that new object. Nothing is imported, and
no constructor, ``__setstate__`` or ``__reduce__`` is called, when a state is read.
"""

import dataclasses
import json
import math
import struct
import sys
import zlib
from collections import deque
from collections.abc import Collection, Iterator
from enum import Enum
from itertools import chain
from typing import IO, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from onboard.dynamics.model.vehicle import VehicleModel
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor

FORMAT = 4
_ROOMS = ("estimation", "identification", "timebase", "regressor", "dynamics", "devices", "flight")
_PACKAGES = tuple(f"onboard.{room}." for room in _ROOMS)
_MODELS = (VehicleModel, ImuPredictor)  # of ours, the same all flight
_HEAD = struct.Struct("<8sIIQQ")  # magic, format, CRC-32 of the tree, bytes of the tree, sum of the arrays' words
_MAGIC, _WORD, _WORDS = b"heftstat", 8, 1 << 64
_PLAIN = (bool, int, float, str, type(None))
_KINDS = frozenset(_PLAIN)
_SEQUENCES: dict[str, type] = {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}


class StateError(ValueError):
    """A state that cannot be written as values, or data that is none of ours."""


class UnwrittenParts:
    """Parts of a new object that are not written, and their places.

    Args:
        new: an object as its constructor made it.
    """

    def __init__(self, new: object) -> None:
        self.at: dict[str, object] = {}
        self._place: dict[int, str] = {}
        self._seen: dict[int, object] = {}
        self._walk(new, "")

    def of(self, thing: object) -> str | None:
        """The place of ``thing``; None for what is not one of the new object's."""
        return self._place.get(id(thing))

    def _walk(self, thing: object, place: str) -> None:
        if isinstance(thing, _PLAIN) or id(thing) in self._seen:
            return
        self._seen[id(thing)] = thing
        if not _is_data(thing) or (isinstance(thing, np.ndarray) and not thing.flags.writeable):
            self.at[place], self._place[id(thing)] = thing, place
        for name, part in _parts(thing):
            self._walk(part, f"{place}/{name}")


def _parts(thing: object) -> Iterator[tuple[str, object]]:
    if isinstance(thing, dict):
        for number, (key, value) in enumerate(thing.items()):
            yield f"{number}k", key
            yield f"{number}v", value
    elif isinstance(thing, list | tuple | deque):
        yield from ((str(number), part) for number, part in enumerate(thing))
    elif not isinstance(thing, Enum | type) and (_is_ours(type(thing)) or isinstance(thing, pydantic.BaseModel)):
        yield from _attributes(thing).items()


def _attributes(thing: object) -> dict[str, object]:
    """Of an instance with a ``__dict__``, or of a data class with slots."""
    if dataclasses.is_dataclass(thing):
        return {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}
    return vars(thing)


def _is_ours(kind: type) -> bool:
    return kind.__module__.startswith(_PACKAGES)


def _is_data(thing: object) -> bool:
    """Whether ``thing`` is written by its values."""
    kind = type(thing)
    if isinstance(thing, Enum) or (isinstance(thing, tuple) and hasattr(thing, "_fields")):
        return True
    values = (np.ndarray, np.generic, bytes, list, tuple, dict, set, frozenset, deque, slice)
    return kind in values or isinstance(thing, np.generic) or (_is_ours(kind) and kind not in _MODELS)


class _Writer:
    def __init__(self, places: UnwrittenParts) -> None:
        self._places, self._number = places, dict[int, int]()
        self._kept: list[object] = []  # so that no number is given twice
        self.arrays: list[memoryview | bytes] = []  # their bytes, to be written before anything changes them
        self._end = 0

    def node(self, thing: object) -> Any:
        if isinstance(thing, _PLAIN) and type(thing) in _PLAIN:
            return thing
        if type(thing) is tuple and all(type(item) in _PLAIN for item in thing):
            return ["plain", thing]  # thousands of short ones: no number each
        if (place := self._places.of(thing)) is not None:
            return ["at", place]
        if id(thing) in self._number:
            return ["same", self._number[id(thing)]]
        self._number[id(thing)] = len(self._kept)
        self._kept.append(thing)
        return self._new(thing)

    def _items(self, things: Collection[object]) -> list[Any]:
        if {type(item) for item in things} == {tuple} and _KINDS.issuperset(map(type, chain.from_iterable(things))):  # type: ignore[arg-type]
            return [["plain", item] for item in things]
        return [self.node(item) for item in things]

    def _array(self, array: NDArray[Any]) -> list[Any]:
        """Dtype, order, shape and place in the data."""
        if array.dtype.hasobject:
            raise StateError(f"an array of {array.dtype} cannot be written as values")
        order: Literal["F", "C"] = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
        flat, start = np.ravel(array, order=order), self._end
        if flat.nbytes:
            self.arrays += [flat.view(np.uint8).data, bytes(-flat.nbytes % _WORD)]
            self._end += -(-flat.nbytes // _WORD) * _WORD
        return [np.lib.format.dtype_to_descr(array.dtype), order, list(array.shape), start]

    def _new(self, thing: object) -> Any:
        kind = type(thing)
        node: list[Any]
        match thing:
            case Enum():
                node = ["enum", _name(kind), self.node(thing.value)]
            case np.ndarray() | np.generic():
                node = ["scalar" if isinstance(thing, np.generic) else "array", *self._array(np.asanyarray(thing))]
            case bytes():
                node = ["bytes", thing.hex()]
            case slice():
                node = ["slice", [self.node(end) for end in (thing.start, thing.stop, thing.step)]]
            case deque():
                node = ["deque", thing.maxlen, self._items(thing)]
            case dict():
                node = ["dict", [[self.node(key), self.node(value)] for key, value in thing.items()]]
            case list() | tuple() | set() | frozenset() if kind.__name__ in _SEQUENCES:
                node = [kind.__name__, self._items(thing)]
            case tuple():
                node = ["record", _name(kind), [self.node(item) for item in thing]]
            case _ if _is_data(thing):
                node = ["object", _name(kind), {name: self.node(part) for name, part in _attributes(thing).items()}]
            case _:
                raise StateError(f"{kind.__module__}.{kind.__qualname__} cannot be written as values")
        return node


class _Reader:
    def __init__(self, places: UnwrittenParts, data: memoryview) -> None:
        self._places, self._data = places, data
        self._made: list[Any] = []

    def value(self, node: Any) -> Any:
        if isinstance(node, _PLAIN):
            return node
        tag, *rest = node
        if tag == "at":
            return self._places.at[rest[0]]
        if tag == "plain":
            return tuple(rest[0])
        if tag == "same":
            return self._made[rest[0]]
        number = len(self._made)
        self._made.append(None)
        if tag in ("dict", "list", "object"):
            return self._filled(number, tag, rest)
        self._made[number] = self._whole(tag, rest)
        return self._made[number]

    def _filled(self, number: int, tag: str, rest: list[Any]) -> Any:
        """Known before its content is, which may point back to it."""
        if tag == "object":
            made: Any = object.__new__(_class(rest[0]))
            self._made[number] = made
            for name, node in rest[1].items():
                object.__setattr__(made, name, self.value(node))
        elif tag == "dict":
            pairs: dict[Any, Any] = {}
            self._made[number] = pairs
            for key_node, node in rest[0]:
                key = self.value(key_node)
                pairs[key] = self.value(node)
        else:
            items: list[Any] = []
            self._made[number] = items
            items.extend(self.value(node) for node in rest[0])
        return self._made[number]

    def _array(self, description: Any, order: Literal["F", "C"], shape: list[int], start: int) -> NDArray[Any]:
        dtype = np.lib.format.descr_to_dtype(_as_tuples(description))
        if dtype.hasobject or min(shape, default=0) < 0 or start < 0:
            raise StateError("an array that is no values")
        data = bytearray(self._data[start : start + math.prod(shape) * dtype.itemsize])
        return np.ndarray(shape, dtype, data, order=order)

    def _whole(self, tag: str, rest: list[Any]) -> Any:
        made: Any
        match tag:
            case "array" | "scalar":
                array = self._array(*rest)
                made = array if tag == "array" else array[()]
            case "bytes":
                made = bytes.fromhex(rest[0])
            case "enum":
                made = _class(rest[0])(self.value(rest[1]))
            case "record":
                made = tuple.__new__(_class(rest[0]), [self.value(node) for node in rest[1]])
            case "slice":
                made = slice(*(self.value(node) for node in rest[0]))
            case "deque":
                made = deque((self.value(node) for node in rest[1]), rest[0])
            case _:
                made = _SEQUENCES[tag](self.value(node) for node in rest[0])
        return made


def _as_tuples(description: Any) -> Any:
    """A dtype's description as NumPy takes it: JSON has lists only."""
    if isinstance(description, str):
        return description
    return [(*field[:1], _as_tuples(field[1]), *(tuple(shape) for shape in field[2:])) for field in description]


def _name(kind: type) -> str:
    if not _is_ours(kind):
        raise StateError(f"{kind.__module__}.{kind.__qualname__} is not a class of the estimator's")
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> type:
    """A numerical class of ours that this process has loaded."""
    module, _, path = name.partition(":")
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    if not isinstance(found, type) or not _is_ours(found) or found.__module__ != module:
        raise StateError(f"{name} is not a class of the estimator's")
    return found


def write(file: IO[bytes], thing: object, places: UnwrittenParts) -> None:
    """Write ``thing``: head, tree, arrays.

    Args:
        file: to write to.
        thing: an object of ours, or containers of them.
        places: of what a new one has anyway.

    Raises:
        StateError: a part of it is neither data nor in ``places``; nothing is written.
    """
    writer = _Writer(places)
    tree = json.dumps(writer.node(thing), check_circular=False).encode()
    tree += b" " * (-len(tree) % _WORD)  # so that the words of the arrays are aligned
    words = sum(map(_sum, writer.arrays)) % _WORDS
    file.write(_HEAD.pack(_MAGIC, FORMAT, zlib.crc32(tree), len(tree), words))
    file.write(tree)
    file.writelines(writer.arrays)  # one after the other: together they are tens of megabytes


def from_bytes(data: bytes, places: UnwrittenParts) -> Any:
    """What :func:`write` made ``data`` of.

    Raises:
        StateError: it is damaged, of another version, or none of ours.
    """
    try:
        magic, version, crc, length, words = _HEAD.unpack_from(data)
        if magic == _MAGIC and version != FORMAT:
            raise StateError(f"a state of format {version}, not {FORMAT}")
        tree = data[_HEAD.size : _HEAD.size + length]
        arrays = memoryview(data)[_HEAD.size + length :]
        if magic != _MAGIC or len(tree) != length or zlib.crc32(tree) != crc or _sum(arrays) != words:
            raise StateError("this is no state of an estimator, or it is damaged")
        return _Reader(places, arrays).value(json.loads(tree))
    except StateError:
        raise
    except Exception as error:
        raise StateError(f"this is no state of an estimator ({type(error).__name__}: {error})") from error


def _sum(data: bytes | memoryview) -> int:
    """Checksum: sum of the 64-bit words modulo 2^64, the last filled up with zeros; a single other word changes it."""
    whole = len(data) // _WORD * _WORD
    return (int(np.frombuffer(data[:whole], "<u8").sum()) + int.from_bytes(data[whole:], "little")) % _WORDS
