"""Decodes the records of a chunk to rows, one run of messages at a time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from drivers.records import GAP, Rows
from onboard.recording.format import mcap_format
from onboard.recording.format.chunk import BODY_AT
from onboard.recording.format.errors import LogFormatError, SchemaError
from onboard.recording.format.schema import (
    CDR_HEADER,
    dtype_from_ros2msg,
    is_altered,
    message_bytes,
    units_from_ros2msg,
)

_HEAD = mcap_format.RECORD_HEAD
_KEY_BYTES = _HEAD.size + 2  # opcode, length, channel number: equal for all messages of a run


_FEW = 16
_MOST_ROW_BYTES = 1 << 20  # the longest, of an estimate, has some 20 kB
FARTHEST_NS = 365 * 86_400 * 10**9  # between two chunks with rows of a channel
_GAP_FIELDS = [(name, "S24" if name == "cause" else GAP[name]) for name in GAP.names or () if name != "counted"]
_GAP_BEFORE = np.dtype(_GAP_FIELDS, align=True)  # of earlier versions; its rows have the bytes of GAP, counted 0


class KnownChannel(NamedTuple):
    """A channel as its definitions describe it."""

    number: int
    name: str
    dtype: np.dtype[np.void]
    units: dict[str, str]


class MessageRun(NamedTuple):
    """Consecutive messages of one channel: a view of their records (n, record size) in the chunk."""

    channel: KnownChannel
    records: NDArray[np.uint8]


def rows_of(runs: list[MessageRun]) -> Rows:
    """The rows (n,) of ``runs``, which are all of one channel."""
    bodies = np.zeros((sum(len(run.records) for run in runs), runs[0].channel.dtype.itemsize), np.uint8)
    at = 0
    for _, records in runs:
        bodies[at : at + len(records), : records.shape[1] - BODY_AT] = records[:, BODY_AT:]
        at += len(records)
    rows: Rows = bodies.view(runs[0].channel.dtype).reshape(len(bodies))
    return rows


class RowTimes:
    """Follows the times of a log's rows, channel by channel."""

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}

    def check(self, runs: list[MessageRun]) -> None:
        """Takes note of a chunk's rows.

        Raises:
            LogFormatError: a row is years from those before it, as none of a flight is.
        """
        wrong = ""
        for channel, records in runs:
            assert channel.dtype.fields is not None
            at = BODY_AT + channel.dtype.fields["host_ns"][1]
            times = np.frombuffer(records[:, at : at + 8].tobytes(), "<i8").tolist()
            low, high, last = min(times), max(times), times[-1]
            before = self._newest_ns.get(channel.name, low)
            if max(high, before) - min(low, before) > FARTHEST_NS:
                wrong = wrong or f"channel {channel.name!r}: the time of a row is years from the row before it"
            self._newest_ns[channel.name] = last
        if wrong:
            raise LogFormatError(wrong)


def _run_length(records: bytes, at: int, size: int) -> int:
    """Number of messages of ``size`` bytes with the same key from ``at`` on (exponential search)."""
    key, end, done = records[at : at + _KEY_BYTES], len(records) - size, 1
    here = at + size
    while here <= end and done < _FEW and records.startswith(key, here):
        done, here = done + 1, here + size
    if done < _FEW:
        return done
    count, ahead, first = (len(records) - at) // size, 4 * _FEW, np.frombuffer(key, np.uint8)
    keys = np.frombuffer(records, np.uint8, count * size, at).reshape(count, size)[:, :_KEY_BYTES]
    while done < count:
        same = (keys[done : done + ahead] == first).all(axis=1)
        if not same.all():
            return done + int(np.argmin(same))
        done, ahead = done + len(same), ahead * 4
    return done


class Decoder:
    """Decodes chunks and collects the channels of a log.

    Args:
        channels: channels of earlier segments, which must agree.

    Attributes:
        channels: by name, in the order they were met.
        definitions: packed schema and channel records, by kind and number.
    """

    def __init__(self, channels: Mapping[str, KnownChannel] | None = None) -> None:
        self.channels: dict[str, KnownChannel] = dict(channels or {})
        self.definitions: dict[tuple[str, int], bytes] = {}
        self._by_number: dict[int, KnownChannel] = {}
        self._schemas: dict[int, str] = {}
        self._seen: set[bytes] = set()

    def runs(self, records: bytes) -> list[MessageRun]:
        """The messages of a chunk in order; adds new definitions.

        Raises:
            LogFormatError: the records contradict each other or the definitions.
        """
        runs: list[MessageRun] = []
        at = 0
        while at < len(records):
            if len(records) - at < _HEAD.size:
                raise LogFormatError("chunk ends inside a record")
            opcode, length = _HEAD.unpack_from(records, at)
            end = at + _HEAD.size + length
            if end > len(records):
                raise LogFormatError("chunk ends inside a record")
            if opcode == Opcode.MESSAGE:
                runs.append(self._run(records, at, int(end - at)))
                at += runs[-1].records.size
            else:
                self._learn(opcode, records[at + _HEAD.size : end])
                at = end
        return runs

    def _run(self, records: bytes, at: int, size: int) -> MessageRun:
        number = int.from_bytes(records[at + _HEAD.size : at + _KEY_BYTES], "little")
        channel = self._by_number.get(number)
        if channel is None:
            raise LogFormatError(f"message of channel {number}, which the chunk does not define")
        if size - BODY_AT not in (message_bytes(channel.dtype), channel.dtype.itemsize):  # older logs fill rows up
            raise LogFormatError(f"channel {channel.name!r}: message and definition differ in size")
        if records[at + BODY_AT - len(CDR_HEADER) : at + BODY_AT] != CDR_HEADER:
            raise LogFormatError(f"channel {channel.name!r}: message is not little-endian CDR")
        count = _run_length(records, at, size)
        return MessageRun(channel, np.frombuffer(records, np.uint8, count * size, at).reshape(count, size))

    def _learn(self, opcode: int, body: bytes) -> None:
        key = bytes([opcode]) + body
        if key in self._seen:
            return
        if opcode == Opcode.SCHEMA:
            schema = mcap_format.Schema.parse(body)
            self._schemas[schema.number] = schema.text
            self.definitions["schema", schema.number] = schema.pack()
        elif opcode == Opcode.CHANNEL:
            channel = mcap_format.Channel.parse(body)
            self._define(channel)
            self.definitions["channel", channel.number] = channel.pack()
        else:
            raise LogFormatError(f"a record of type {opcode} has no place in a chunk")
        self._seen.add(key)

    def _define(self, channel: mcap_format.Channel) -> None:
        text = self._schemas.get(channel.schema)
        if text is None:
            raise LogFormatError(f"channel {channel.topic!r} is defined before its schema")
        try:
            dtype = dtype_from_ros2msg(text)
            dtype = GAP if dtype == _GAP_BEFORE else dtype
            known = KnownChannel(channel.number, channel.topic, dtype, units_from_ros2msg(text))
        except SchemaError as error:
            raise LogFormatError(f"channel {channel.topic!r}: {error}") from error
        if dtype.itemsize > _MOST_ROW_BYTES:
            raise LogFormatError(
                f"channel {channel.topic!r} has rows of {dtype.itemsize} bytes, which heft never writes"
            )
        if is_altered(dtype):
            raise LogFormatError(f"channel {channel.topic!r} has fields of another kind than heft writes")
        fields: Mapping[str, Any] = known.dtype.fields or {}
        if [fields[name][0].str if name in fields else "" for name in ("sequence", "host_ns")] != ["<u8", "<i8"]:
            raise LogFormatError(f"channel {channel.topic!r} lacks the fields sequence and host_ns of every record")
        if self.channels.setdefault(channel.topic, known).dtype != known.dtype:
            raise LogFormatError(f"channel {channel.topic!r} is defined twice, with different fields")
        self._by_number[channel.number] = known
