"""Packs rows into the records of a chunk, a batch at a time."""

from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.recording.format import mcap_format
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.schema import CDR_HEADER, message_bytes

BODY_AT = mcap_format.MESSAGE_HEAD.size + len(CDR_HEADER)  # of the row's bytes in a message record


class PackedRows(NamedTuple):
    """Message records (n, record size) of one channel, and their log times (n,)."""

    records: NDArray[np.uint8]
    log_times: NDArray[np.uint64]


class PackedChannel:
    """One channel of a log: its definitions as records, and how its rows become message records.

    Padding bytes are zeroed, so that two logs of one flight are identical. Log time is ``host_ns + utc_offset_ns``.
    """

    def __init__(
        self, schema: mcap_format.Schema, channel: mcap_format.Channel, dtype: np.dtype[np.void], utc_offset_ns: int = 0
    ) -> None:
        self._utc_offset_ns = np.int64(utc_offset_ns)
        self.schema, self.channel, self.dtype = schema, channel, dtype
        self.number = channel.number
        self.definitions = {("schema", schema.number): schema.pack(), ("channel", channel.number): channel.pack()}
        self._body = message_bytes(dtype)
        size = BODY_AT + self._body - mcap_format.RECORD_HEAD.size
        head = mcap_format.MESSAGE_HEAD.pack(Opcode.MESSAGE, size, channel.number, 0, 0, 0) + CDR_HEADER
        self._head = np.frombuffer(head, np.uint8)
        # mcap.dev/spec, message: the fields that differ from row to row
        self._varying = np.dtype(
            {
                "names": ["sequence", "log_time", "publish_time"],
                "formats": ["<u4", "<u8", "<u8"],
                "offsets": [11, 15, 23],
                "itemsize": BODY_AT + self._body,
            }
        )
        self._padding = _padding(dtype)

    @property
    def record_bytes(self) -> int:
        """Size of one message record."""
        return BODY_AT + self._body

    def require(self, rows: Rows) -> None:
        """Raises ChannelError unless ``rows`` are one-dimensional rows of the channel's dtype."""
        if (rows.dtype is not self.dtype and rows.dtype != self.dtype) or rows.ndim != 1:
            raise ChannelError(
                f"channel {self.channel.topic!r} takes 1-D rows of {self.dtype.names}, "
                f"not {rows.ndim}-dimensional ones of {rows.dtype.names}"
            )

    def pack(self, rows: Rows) -> PackedRows:
        """Message records of contiguous ``rows`` (n,) of the channel's dtype."""
        count = len(rows)
        log_times = (rows["host_ns"] + self._utc_offset_ns).astype(np.uint64)
        records = np.empty((count, BODY_AT + self._body), np.uint8)
        records[:, :BODY_AT] = self._head
        varying = records.view(self._varying)[:, 0]
        varying["sequence"] = rows["sequence"]
        varying["log_time"] = varying["publish_time"] = log_times
        records[:, BODY_AT:] = rows.view(np.uint8).reshape(count, self.dtype.itemsize)[:, : self._body]
        for first, last in self._padding:
            records[:, BODY_AT + first : BODY_AT + last] = 0
        return PackedRows(records, log_times)


def _padding(dtype: np.dtype[np.void]) -> list[tuple[int, int]]:
    """Ranges of padding bytes before a row's last field: first byte and byte after the last."""
    assert dtype.fields is not None
    used = sorted((offset, offset + field.itemsize) for field, offset, *_ in dtype.fields.values())
    starts = [0, *(end for _, end in used)]
    return [(start, end) for start, (end, _) in zip(starts, used, strict=False) if start < end]


class SealedChunk(NamedTuple):
    """A chunk, and the message index of each channel in it."""

    chunk: mcap_format.Chunk
    indexes: dict[int, bytes]


class ChunkBuilder:
    """Collects records until a chunk is full. Definitions are collected separately for the chunk's head.

    Args:
        limit: bytes of records in a chunk. A single row that is larger gets a chunk of its own.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._definitions: dict[tuple[str, int], bytes] = {}
        self._runs: list[tuple[int, PackedRows, int]] = []  # channel, records, offset after the definitions
        self._definition_bytes = self._message_bytes = 0

    @property
    def has_messages(self) -> bool:
        """Whether any message is in it."""
        return bool(self._runs)

    @property
    def is_empty(self) -> bool:
        """Whether neither messages nor definitions are in it."""
        return not self._definitions

    def define(self, channel: PackedChannel) -> bool:
        """Add the definitions of ``channel``; False if there is no room."""
        missing = self._missing(channel)
        size = sum(map(len, missing.values()))
        if self._definitions and self._room < size:
            return False
        self._take(missing, size)
        return True

    def add(self, channel: PackedChannel, rows: PackedRows) -> int:
        """Add as many of ``rows`` as there is room for, from the first on; returns the number.

        A chunk without messages takes at least one.
        """
        missing = self._missing(channel)
        missing_bytes = sum(map(len, missing.values()))
        total, size = rows.records.shape
        count: int = min(total, (self._room - missing_bytes) // size)
        if count <= 0:
            if self._runs:
                return 0
            count = 1
        self._take(missing, missing_bytes)
        taken = PackedRows(rows.records[:count], rows.log_times[:count])
        self._runs.append((channel.number, taken, self._message_bytes))
        self._message_bytes += count * size
        return count

    @property
    def _room(self) -> int:
        return self._limit - self._definition_bytes - self._message_bytes

    def _missing(self, channel: PackedChannel) -> dict[tuple[str, int], bytes]:
        if ("channel", channel.number) in self._definitions:
            return {}
        return {key: packed for key, packed in channel.definitions.items() if key not in self._definitions}

    def _take(self, definitions: dict[tuple[str, int], bytes], size: int) -> None:
        self._definitions |= definitions
        self._definition_bytes += size

    def seal(self) -> SealedChunk:
        """Return the chunk and empty the builder."""
        records = b"".join([*self._definitions.values(), *(run.records.data for _, run, _ in self._runs)])
        times = np.concatenate([run.log_times for _, run, _ in self._runs]) if self._runs else np.zeros(1, np.uint64)
        indexes = {number: self._index(number) for number in sorted({number for number, *_ in self._runs})}
        self._definitions, self._runs = {}, []
        self._definition_bytes = self._message_bytes = 0
        return SealedChunk(mcap_format.Chunk(int(times.min()), int(times.max()), records), indexes)

    def _index(self, number: int) -> bytes:
        runs = [(run, at) for channel, run, at in self._runs if channel == number]
        offsets = [
            np.arange(len(run.records), dtype=np.uint64) * np.uint64(run.records.shape[1])
            + np.uint64(at + self._definition_bytes)
            for run, at in runs
        ]
        return mcap_format.pack_message_index(
            number, np.concatenate([run.log_times for run, _ in runs]), np.concatenate(offsets)
        )
