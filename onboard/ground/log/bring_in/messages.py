"""Reads recordings of messages: ROS bags, MCAP and PX4's ULog. A column is ``TOPIC:field.of.it``.

Every message of a topic is a row. ``TOPIC:log_time`` is when it was recorded, ``TOPIC:header.stamp`` what its header
says, both in ns. Arrays of positions, rates and efforts beside an array ``name`` are named by it, whatever their order.
"""

import json
import struct
from collections.abc import Collection, Iterator
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.text_rows import LARGEST_BYTES, Recording, Values

TIMES = ("header.stamp", "timestamp_sample", "timestamp", "log_time")  # of a topic, the best first
_LONGEST_ARRAY = 64  # numbers of a message; images and clouds are passed over
_BY_NAME = ("position", "velocity", "effort")  # arrays of a JointState
_BROKEN = (  # what the readers raise for altered files
    *(TypeError, ValueError, KeyError, IndexError, EOFError, AttributeError, OverflowError, MemoryError, RuntimeError),
)
_BYTES_A_NUMBER = 40  # of Python's, in a list


def read_messages(path: Path, kind: str, topics: Collection[str] | None, most: int | None = None) -> Recording:
    """Columns of the messages of a file, and whether some of it could not be read.

    Args:
        path: a ``.bag``, a directory or ``.db3`` of ROS 2, an ``.mcap`` or an ``.ulg``.
        kind: ``bag``, ``mcap`` or ``ulog``.
        topics: that are wanted; None: all.
        most: messages of a topic.

    Raises:
        SourceError: it cannot be read, or the package that reads it is not installed.
        OSError: the file cannot be opened.
    """
    if kind == "ulog":
        return _ulog(path, topics, most)
    tables: dict[str, MessageColumns] = {}
    total = 0
    for topic, log_time_ns, message in (_bag if kind == "bag" else _mcap)(path, topics):
        table = tables.setdefault(topic, MessageColumns())
        if most is None or table.count < most:
            total += table.add(message, (("log_time", log_time_ns),))
        if total * _BYTES_A_NUMBER > LARGEST_BYTES:
            raise SourceError(f"{path} has more numbers than {LARGEST_BYTES / 1e9:.1f} GB hold: divide it")
    found = ((topic, name, one) for topic, table in tables.items() for name, one in table.arrays().items())
    return Recording({f"{topic}:{name}": one for topic, name, one in found})


class MessageColumns:
    """Messages of a topic, or objects of JSON, as columns; what one lacks is NaN."""

    def __init__(self) -> None:
        self.count = 0
        self._columns: dict[str, list[float]] = {}

    def add(self, message: Any, before: tuple[tuple[str, float], ...] = ()) -> int:
        """Append a row, with what stands before its own numbers; returns how many it has."""
        found = 0
        for name, value in (*before, *_leaves(message, "")):
            column = self._columns.setdefault(name, [])
            column += [np.nan] * (self.count - len(column))
            if len(column) == self.count:  # the first of a name
                column.append(value)
                found += 1
        self.count += 1
        return found

    def arrays(self) -> dict[str, Values]:
        """The columns."""
        filled = {name: one + [np.nan] * (self.count - len(one)) for name, one in self._columns.items()}
        return {name: _array(one) for name, one in filled.items()}


def _array(numbers: list[float]) -> Values:
    with suppress(OverflowError, ValueError):
        if all(type(one) is int for one in numbers):
            return np.array(numbers, np.int64)
    return np.array(numbers, np.float64)


def _leaves(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """Numbers of a message with their names."""
    if isinstance(value, (bool, int, np.integer, np.bool_)):
        yield name, int(value)
    elif isinstance(value, (float, np.floating)):
        yield name, float(value)
    elif isinstance(value, (np.ndarray, list, tuple)):
        if len(value) <= _LONGEST_ARRAY:
            for k, one in enumerate(value):
                yield from _leaves(one, f"{name}[{k}]")
    else:
        fields = value if isinstance(value, dict) else _fields(value)
        stamp = _stamp_ns(fields)
        if stamp is not None:
            yield name, stamp
            return
        names = fields.get("name")
        for key, one in fields.items():
            own = f"{name}.{key}" if name else key
            if key in _BY_NAME and isinstance(names, list) and len(names) == len(one):
                yield from ((f"{own}.{joint}", float(number)) for joint, number in zip(names, one, strict=True))
            else:
                yield from _leaves(one, own)


def _fields(value: Any) -> dict[str, Any]:
    names = getattr(value, "__dataclass_fields__", ())
    return {name: getattr(value, name) for name in names if not name.startswith("__")}


def _stamp_ns(fields: dict[str, Any]) -> int | None:
    """Of a time: seconds and nanoseconds."""
    for second, rest in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs")):
        if set(fields) == {second, rest}:
            return int(fields[second]) * 10**9 + int(fields[rest])
    return None


def _bag(path: Path, topics: Collection[str] | None) -> Iterator[tuple[str, int, Any]]:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415  (an extra)
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise SourceError(f"{path}: ROS bags are read by rosbags ({error}): pip install 'heft-flight[bags]'") from error
    whole = path.parent if path.suffix == ".db3" else path
    try:
        with AnyReader([whole], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [one for one in reader.connections if topics is None or one.topic in topics]
            for connection, log_time_ns, raw in reader.messages(wanted) if wanted else ():
                yield connection.topic, log_time_ns, reader.deserialize(raw, connection.msgtype)
    except (AnyReaderError, FileNotFoundError, *_BROKEN, struct.error) as error:
        raise SourceError(f"{path} is no bag that can be read ({error}); check it with `rosbag info`") from error


def _mcap(path: Path, topics: Collection[str] | None) -> Iterator[tuple[str, int, Any]]:
    from mcap.exceptions import McapError  # noqa: PLC0415  (a start does not read)
    from mcap.reader import make_reader  # noqa: PLC0415
    from zstandard import ZstdError  # noqa: PLC0415

    decode = _Decoder(path)
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            encodings = {channel.message_encoding for channel in summary.channels.values()} if summary else set()
            if encodings and encodings.isdisjoint(("json", "cdr", "ros1")):
                raise SourceError(
                    f"{path}: its messages are {', '.join(sorted(encodings))}, and those of ROS and JSON are read: "
                    "write them as JSON, or as a table (CSV, NPZ)"
                )
            for schema, channel, message in reader.iter_messages(topics):
                yield channel.topic, message.log_time, decode(schema, channel, message.data)
    except (McapError, *_BROKEN, struct.error, ZstdError) as error:
        if isinstance(error, SourceError):
            raise
        raise SourceError(
            f"{path} is no MCAP file that can be read ({error}); `mcap recover` saves what is whole"
        ) from error


class _Decoder:
    """Messages of ROS 1, ROS 2 and JSON; others have no numbers that can be read here."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._store: Any = None

    def __call__(self, schema: Any, channel: Any, data: bytes) -> Any:
        if channel.message_encoding == "json":
            return json.loads(data)
        if schema is None or channel.message_encoding not in ("cdr", "ros1") or "idl" in schema.encoding:
            return {}
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  (an extra)
        except ModuleNotFoundError as error:
            remedy = "pip install 'heft-flight[bags]'"
            raise SourceError(f"{self._path}: messages of ROS are read by rosbags ({error}): {remedy}") from error
        self._store = store = self._store or get_typestore(Stores.EMPTY)
        if schema.name not in store.fielddefs:
            types = get_types_from_msg(schema.data.decode(), schema.name)
            store.register({name: one for name, one in types.items() if name not in store.fielddefs})
        name = schema.name if schema.name in store.fielddefs else schema.name.replace("/", "/msg/")
        read = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
        return read(data, name)


def _ulog(path: Path, topics: Collection[str] | None, most: int | None) -> Recording:
    try:
        from pyulog import ULog  # noqa: PLC0415  (an extra)
    except ModuleNotFoundError as error:
        raise SourceError(f"{path}: ULog is read by pyulog ({error}): pip install 'heft-flight[ulog]'") from error
    wanted = None if topics is None else sorted({topic.partition(".")[0] for topic in topics})
    try:
        with path.open("rb") as file, redirect_stdout(StringIO()):  # it prints what it cannot read
            log = ULog(file, message_name_filter_list=wanted, disable_str_exceptions=True)
    except (*_BROKEN, struct.error, OSError) as error:
        raise SourceError(f"{path} is no ULog file that can be read ({error})") from error
    found = {}
    for one in log.data_list:
        topic = one.name if not one.multi_id else f"{one.name}.{one.multi_id}"
        for name, values in one.data.items():
            if values.dtype.kind in "iufb":
                found[f"{topic}:{name}"] = _signed(values[:most])
    return Recording(found, "it is damaged; what could not be read is left out" if log.file_corruption else "")


def _signed(values: Values) -> Values:
    return values.astype(np.int64) if values.dtype.kind in "uib" else values
