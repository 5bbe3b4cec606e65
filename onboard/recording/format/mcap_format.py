"""Packs and parses MCAP records (mcap.dev/spec); no file, no state.

A record is an opcode byte, a u64 length and that many bytes of body, all little-endian. The packers return whole
records, by the ``mcap`` package's record classes except for the three of every chunk, which would take 130 us per chunk
of 150 messages there against 70 us here, where NumPy packs a message index at once. The parsers take a body and are our
own, because those of the package check neither lengths nor the CRC of an attachment. They raise nothing but
``LogFormatError``.
"""

import re
import struct
import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from onboard.recording.format.errors import ChecksumError, LogFormatError

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
LIBRARY = "heft"
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log time, publish time
FOOTER_BYTES = RECORD_HEAD.size + 20 + len(MAGIC)
DATA_END_BYTES = RECORD_HEAD.size + 4

_CHUNK_HEAD = struct.Struct("<QQQI")  # start, end, uncompressed size, uncompressed CRC
CHUNK_HEAD_BYTES = _CHUNK_HEAD.size + 12  # with the empty name of the compression, and the length of the records
_NO_COMPRESSION = bytes(4)  # an empty name
_UNKNOWN_TIME = 0
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_FOOTER_HEAD = RECORD_HEAD.pack(Opcode.FOOTER, 20)


def pack(record: records.McapRecord) -> bytes:
    """``record`` as bytes."""
    builder = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]  # the package annotates only in part
    return packed


def _record(opcode: int, *parts: bytes) -> bytes:
    return b"".join((RECORD_HEAD.pack(opcode, sum(map(len, parts))), *parts))


class _Body:
    """A cursor over a record's body that never runs past its end."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data, self._at, self._what = data, 0, what

    def take(self, size: int) -> bytes:
        end = self._at + size
        if end > len(self._data):
            raise LogFormatError(f"{self._what} record ends before its content does")
        part, self._at = self._data[self._at : end], end
        return part

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def string(self) -> str:
        try:
            text = self.take(self.number(4)).decode()
        except UnicodeDecodeError as error:
            raise LogFormatError(f"{self._what} record holds text that is not UTF-8") from error
        if _CONTROL.search(text):
            raise LogFormatError(f"{self._what} record holds control characters")  # a terminal would obey them
        return text

    def map(self) -> dict[str, str]:
        end = self.number(4) + self._at
        items: dict[str, str] = {}
        while self._at < end:
            key = self.string()
            items[key] = self.string()
        if self._at != end:
            raise LogFormatError(f"{self._what} record holds a map that overruns its length")
        return items

    def done(self) -> None:
        if self._at != len(self._data):
            raise LogFormatError(f"{self._what} record is longer than its content")


class Schema(NamedTuple):
    """Schema record: a message definition."""

    number: int
    name: str
    text: str

    def pack(self) -> bytes:
        """The whole record."""
        return pack(records.Schema(self.number, self.text.encode(), "ros2msg", self.name))

    @classmethod
    def parse(cls, data: bytes) -> "Schema":
        """From a body; another encoding than ``ros2msg`` raises LogFormatError."""
        body = _Body(data, "schema")
        number, name, encoding, text = body.number(2), body.string(), body.string(), body.string()
        body.done()
        if encoding != "ros2msg":
            raise LogFormatError(f"schema {name!r} is encoded as {encoding!r}, not as ros2msg")
        return cls(number, name, text)


class Channel(NamedTuple):
    """Channel record: a topic and the schema of its messages."""

    number: int
    schema: int
    topic: str

    def pack(self) -> bytes:
        """The whole record."""
        return pack(records.Channel(self.number, self.topic, "cdr", {}, self.schema))

    @classmethod
    def parse(cls, data: bytes) -> "Channel":
        """From a body; another encoding than ``cdr`` raises LogFormatError."""
        body = _Body(data, "channel")
        number, schema, topic, encoding, _ = body.number(2), body.number(2), body.string(), body.string(), body.map()
        body.done()
        if encoding != "cdr":
            raise LogFormatError(f"channel {topic!r} is encoded as {encoding!r}, not as cdr")
        return cls(number, schema, topic)


class Header(NamedTuple):
    """Header record: the first of a log."""

    profile: str
    library: str

    def pack(self) -> bytes:
        """The whole record."""
        return pack(records.Header(self.profile, self.library))

    @classmethod
    def parse(cls, data: bytes) -> "Header":
        """From a body."""
        body = _Body(data, "header")
        header = cls(body.string(), body.string())
        body.done()
        return header


class Attachment(NamedTuple):
    """Attachment record: a file that travels with the log."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int

    def pack(self) -> bytes:
        """The whole record, with its CRC."""
        return pack(records.Attachment(_UNKNOWN_TIME, self.log_time_ns, self.name, self.media_type, self.data))

    @classmethod
    def parse(cls, data: bytes) -> "Attachment":
        """From a body; a wrong CRC raises ChecksumError."""
        body = _Body(data, "attachment")
        log_time_ns, _, name, media_type = body.number(8), body.number(8), body.string(), body.string()
        content, crc = body.take(body.number(8)), body.number(4)
        body.done()
        if zlib.crc32(data[:-4]) != crc:
            raise ChecksumError("attachment CRC does not match its content")
        return cls(name, media_type, content, log_time_ns)

    def pack_index(self, offset: int, length: int) -> bytes:
        """The index record of this attachment, whose record is at ``offset`` and ``length`` long."""
        size, times = len(self.data), (self.log_time_ns, _UNKNOWN_TIME)
        return pack(records.AttachmentIndex(offset, length, *times, size, self.name, self.media_type))


class Metadata(NamedTuple):
    """Metadata record: a named map of strings."""

    name: str
    items: dict[str, str]

    def pack(self) -> bytes:
        """The whole record."""
        return pack(records.Metadata(self.name, self.items))

    @classmethod
    def parse(cls, data: bytes) -> "Metadata":
        """From a body."""
        body = _Body(data, "metadata")
        metadata = cls(body.string(), body.map())
        body.done()
        return metadata

    def pack_index(self, offset: int, length: int) -> bytes:
        """The index record of this metadata, whose record is at ``offset`` and ``length`` long."""
        return pack(records.MetadataIndex(offset, length, self.name))


class Chunk(NamedTuple):
    """Chunk record, uncompressed: definitions and messages, and the span of the messages' log times."""

    start_ns: int
    end_ns: int
    records: bytes

    def pack(self) -> bytes:
        """The whole record, with its CRC."""
        size = len(self.records)
        head = _CHUNK_HEAD.pack(self.start_ns, self.end_ns, size, zlib.crc32(self.records))
        return _record(Opcode.CHUNK, head, _NO_COMPRESSION, struct.pack("<Q", size), self.records)

    @staticmethod
    def plausible(head: bytes, length: int) -> bool:
        """Whether ``head``, the first bytes of a body of ``length``, can be a chunk's; avoids reading other data."""
        if len(head) < CHUNK_HEAD_BYTES:
            return False
        _, _, size, _, compression, stored = struct.unpack_from("<QQQIIQ", head)
        return size == stored == length - CHUNK_HEAD_BYTES and not compression

    @classmethod
    def parse(cls, data: bytes) -> "Chunk":
        """From a body; compression or inconsistent lengths raise LogFormatError, a wrong CRC ChecksumError."""
        body = _Body(data, "chunk")
        start_ns, end_ns, size, crc = _CHUNK_HEAD.unpack(body.take(_CHUNK_HEAD.size))
        if body.number(4):
            raise LogFormatError("chunk is compressed, which heft never does")
        if body.number(8) != size:
            raise LogFormatError("chunk lengths contradict each other")
        records = body.take(size)
        body.done()
        if zlib.crc32(records) != crc:
            raise ChecksumError("chunk CRC does not match its content")
        return cls(start_ns, end_ns, records)


def pack_message_index(channel: int, log_times: NDArray[np.uint64], offsets: NDArray[np.uint64]) -> bytes:
    """Message index record: where in the chunk's records each message (n,) of ``channel`` starts."""
    entries = np.empty(len(offsets), _INDEX_ENTRY)
    entries["log_time"], entries["offset"] = log_times, offsets
    data = entries.tobytes()
    return _record(Opcode.MESSAGE_INDEX, struct.pack("<HI", channel, len(data)), data)


class MessageIndex(NamedTuple):
    """Message index record; only the channel is kept, because sequential reading needs no index."""

    channel: int

    @classmethod
    def parse(cls, data: bytes) -> "MessageIndex":
        """From a body; lengths that contradict each other raise LogFormatError."""
        if len(data) < 6 or (len(data) - 6) % 16 or int.from_bytes(data[2:6], "little") != len(data) - 6:
            raise LogFormatError("message index contradicts its length")
        return cls(int.from_bytes(data[:2], "little"))


def pack_chunk_index(chunk: Chunk, offset: int, length: int, indexes: Mapping[int, int], indexes_length: int) -> bytes:
    """Chunk index record: ``indexes`` maps channel number to the offset of its message index record."""
    positions = b"".join(struct.pack("<HQ", *item) for item in indexes.items())
    head = struct.pack("<QQQQI", chunk.start_ns, chunk.end_ns, offset, length, len(positions))
    size = len(chunk.records)
    tail = struct.pack("<Q", indexes_length) + _NO_COMPRESSION + struct.pack("<QQ", size, size)
    return _record(Opcode.CHUNK_INDEX, head, positions, tail)


def pack_end(data_end_offset: int, data_crc: int, groups: Mapping[int, bytes]) -> bytes:
    """All records from the data end record to the last magic.

    Args:
        data_end_offset: where in the file the data end record will stand.
        data_crc: CRC-32 of all bytes before it.
        groups: summary section: opcode to the packed records of that opcode, in the order they are to stand.
    """
    data_end = pack(records.DataEnd(data_crc))
    summary_start = data_end_offset + len(data_end)
    summary, offsets = b"", b""
    for opcode, packed in groups.items():
        if packed:
            offsets += pack(records.SummaryOffset(opcode, summary_start + len(summary), len(packed)))
            summary += packed
    places = (summary_start, summary_start + len(summary))
    crc = zlib.crc32(summary + offsets + pack(records.Footer(*places, 0))[:-4])
    return data_end + summary + offsets + pack(records.Footer(*places, crc)) + MAGIC


class Footer(NamedTuple):
    """Footer record, which ends a log together with the magic."""

    summary_start: int
    summary_crc: int

    @classmethod
    def at_end_of(cls, tail: bytes) -> "Footer | None":
        """The footer that ``tail`` ends with; None when there is none, as in a log that was not closed."""
        end = tail[-FOOTER_BYTES:]
        if len(end) < FOOTER_BYTES or not end.startswith(_FOOTER_HEAD) or not end.endswith(MAGIC):
            return None
        start, _, crc = struct.unpack_from("<QQI", end, RECORD_HEAD.size)
        return cls(start, crc)
