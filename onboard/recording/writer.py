"""MCAP writer: batches of rows in, chunks of at most 16 KiB out, definitions at the head of every chunk.

A disk error loses no data: every byte stays in memory until a later ``fsync`` succeeds, and is written again if that
fails (a failed ``fsync`` leaves Linux pages clean and unwritten). The caller bounds the backlog by writing no more
while it grows.

Batches are small (a bus read is a few rows) and packing has a cost per batch, so up to a few chunks of rows are staged
(until the next ``sync``) and packed per channel. The order within a channel is kept.

The same calls give the same bytes: no clock is read, padding is zeroed.
"""

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np

from drivers.records import GAP, Rows
from onboard.recording.format import mcap_format
from onboard.recording.format.chunk import ChunkBuilder, PackedChannel
from onboard.recording.format.errors import ChannelError, RecordingError
from onboard.recording.format.schema import message_name, ros2msg
from onboard.recording.format.summary import SummarySection
from onboard.recording.format.wall_clock import FLIGHT_METADATA, utc_offset_ns
from onboard.recording.sink import FileSink, FileTaken

CHUNK_BYTES = 16384
HEADER = mcap_format.MAGIC + mcap_format.Header(mcap_format.PROFILE, mcap_format.LIBRARY).pack()
SYNC_INTERVAL_NS = 150_000_000  # with steps of up to 50 ms nothing un-synced is ever older than 200 ms
_NAME_BYTES = GAP["channel"].itemsize
_MAX_UNSYNCED_BYTES = 4 << 20  # limit in memory; beyond it an fsync is made early
_STAGED_CHUNKS = 4  # rows staged for packing, in chunks


class LogWriter:
    """Writes one log.

    ``OSError`` from any method means a disk error only: the data are kept and written by the next call that succeeds.

    Args:
        sink: an empty file.
        chunk_bytes: bytes of records in a chunk.
        sync_interval_ns: least time between two fsyncs, on the clock given to ``sync``.
    """

    def __init__(
        self, sink: FileSink, *, chunk_bytes: int = CHUNK_BYTES, sync_interval_ns: int = SYNC_INTERVAL_NS
    ) -> None:
        self._sink, self._sync_interval_ns = sink, sync_interval_ns
        self._utc_offset_ns = 0
        self._chunk = ChunkBuilder(chunk_bytes)
        self._staged: dict[str, list[bytes]] = {}
        self._staged_bytes, self._stage_bytes = 0, _STAGED_CHUNKS * chunk_bytes
        self._channels: dict[str, PackedChannel] = {}
        self._schemas: dict[tuple[str, str], mcap_format.Schema] = {}
        self._blocks: list[bytes] = []  # since the last fsync
        self._written = 0  # blocks of these written to the sink
        self._synced_offset = self._offset = self._end = 0
        self._data_crc = 0
        self._last_sync_ns: int | None = None
        self._failing = False
        self._summary = SummarySection()
        self._ended = self._closed = False
        self._append(HEADER)

    @classmethod
    def create(
        cls,
        path: str | Path,
        *,
        durable: bool = True,
        overwrite: bool = False,
        sync_interval_ns: int = SYNC_INTERVAL_NS,
    ) -> Self:
        """A writer of a new file at ``path``; see ``FileSink`` for the other arguments and the errors."""
        return cls(FileSink(path, durable=durable, overwrite=overwrite), sync_interval_ns=sync_interval_ns)

    @property
    def channels(self) -> dict[str, np.dtype[np.void]]:
        """The registered channels and their dtypes."""
        return {name: channel.dtype for name, channel in self._channels.items()}

    @property
    def bytes_written(self) -> int:
        """Bytes written to the sink."""
        return self._offset

    @property
    def backlog_bytes(self) -> int:
        """Bytes of complete chunks not yet written: above 0 only while the disk fails."""
        return self._end - self._offset

    @property
    def ended(self) -> bool:
        """Whether the log is closed: the summary is made and nothing more can be written."""
        return self._ended

    @property
    def failing(self) -> bool:
        """Whether a write failed and no ``sync`` or ``flush`` has succeeded since.

        Meanwhile ``write`` keeps rows without trying the disk; ``sync`` retries whenever it is due.
        """
        return self._failing

    def register(
        self,
        channel: str,
        dtype: np.dtype[np.void],
        *,
        schema: str | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        """Register ``channel``, at any time before its first rows. A repeated call has no effect.

        Args:
            channel: topic.
            dtype: its rows'. Must have ``sequence`` (u8) and ``host_ns`` (i8).
            schema: ROS 2 message name (``pkg/msg/Name``); by default that of the record in ``drivers.records``.
            units: field name to unit, written beside the fields of the message definition.

        Raises:
            SchemaError: ROS 2 messages cannot express this dtype.
            ChannelError: the channel is registered with another dtype, or its name is too long.
        """
        known = self._channels.get(channel)
        if known is not None:
            if known.dtype != dtype:
                raise ChannelError(f"channel {channel!r} is registered with fields {known.dtype.names}; use a new name")
            return
        if not 0 < len(channel.encode()) <= _NAME_BYTES:
            raise ChannelError(
                f"channel {channel!r}: give it a name of 1 to {_NAME_BYTES} bytes, as gap records hold it"
            )
        text = ros2msg(dtype, units)
        fields = dtype.fields
        assert fields is not None
        if [fields[name][0].str if name in fields else "" for name in ("sequence", "host_ns")] != ["<u8", "<i8"]:
            raise ChannelError(f"channel {channel!r} needs the fields sequence (u8) and host_ns (i8) of every record")
        packed_schema = self._schema(schema or message_name(channel, dtype), text)
        number = len(self._channels) + 1
        definition = mcap_format.Channel(number, packed_schema.number, channel)
        packed = PackedChannel(packed_schema, definition, dtype, self._utc_offset_ns)
        self._channels[channel] = packed
        self._summary.define(packed.definitions)
        if not self._chunk.define(packed):
            self._seal()
            self._chunk.define(packed)

    def _schema(self, name: str, text: str) -> mcap_format.Schema:
        number = len(self._schemas) + 1
        if (name, text) not in self._schemas and name in {other for other, _ in self._schemas}:
            name = f"{name}{number}"  # two definitions may not share a name
        return self._schemas.setdefault((name, text), mcap_format.Schema(number, name, text))

    def write(self, channel: str, rows: Rows) -> None:
        """Accept ``rows`` (n,) of ``channel``; chunks that are full go to the sink.

        Raises:
            ChannelError: no such channel, or rows of another dtype.
            OSError: the write failed; the rows are kept.
        """
        self._refuse_after_end()
        known = self._channels.get(channel)
        if known is None:
            raise ChannelError(f"channel {channel!r} is not registered; register it with its dtype first")
        known.require(rows)
        if not len(rows):
            return
        self._staged.setdefault(channel, []).append(rows.tobytes())
        self._staged_bytes += len(rows) * known.record_bytes
        if self._staged_bytes >= self._stage_bytes:
            self._pack_staged()
            self._drain_unless_failing()

    def _pack_staged(self) -> None:
        """Staged rows to the records of chunks, a channel at a time; chunks that are full are sealed."""
        for name, parts in self._staged.items():
            channel = self._channels[name]
            packed = channel.pack(np.frombuffer(b"".join(parts), channel.dtype))
            self._summary.counts[channel.number] += len(packed.records)
            while len(packed.records):
                taken = self._chunk.add(channel, packed)
                if not taken:
                    self._seal()
                packed = type(packed)(packed.records[taken:], packed.log_times[taken:])
        self._staged, self._staged_bytes = {}, 0

    def sync(self, now_ns: int) -> bool:
        """If due, write the current chunk and all pending data, and ``fsync``.

        Returns:
            Whether everything accepted so far was synced by this call.

        Raises:
            OSError: the write failed; everything not synced is kept and written again.
        """
        due = self._last_sync_ns is None or now_ns - self._last_sync_ns >= self._sync_interval_ns
        if not due or not (self._blocks or self._staged or self._chunk.has_messages or self._failing):
            return False
        self._last_sync_ns = now_ns  # before the attempt: a failing disk is not retried in every step
        self.flush()
        return True

    def flush(self) -> None:
        """Write the current chunk and all pending data, and ``fsync``, regardless of the interval.

        Raises:
            OSError: the write failed; everything not synced is kept and written again.
        """
        self._seal_messages()
        self._drain()
        self._fsync()
        self._failing = False

    def attach(self, name: str, media_type: str, data: bytes, log_time_ns: int = 0) -> None:
        """Attach a file to the log, after the data written so far.

        Raises:
            OSError: the write failed; it is kept.
        """
        self._refuse_after_end()
        attachment = mcap_format.Attachment(name, media_type, data, log_time_ns)
        packed = attachment.pack()
        self._seal_messages()
        self._summary.add_attachment(attachment, self._end, len(packed))
        self._append(packed)
        self._drain_unless_failing()

    def add_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add a named map of strings to the log, after the data written so far.

        The flight's tells what UTC is: log times of channels that are registered after it are UTC.

        Raises:
            OSError: the write failed; it is kept.
        """
        self._refuse_after_end()
        if name == FLIGHT_METADATA:
            self._utc_offset_ns = utc_offset_ns({name: items}) or 0
        metadata = mcap_format.Metadata(name, dict(items))
        packed = metadata.pack()
        self._seal_messages()
        self._summary.add_metadata(metadata, self._end, len(packed))
        self._append(packed)
        self._drain_unless_failing()

    def close(self) -> None:
        """Write the remaining data and the summary, sync, close the file. A repeated call has no effect.

        Raises:
            OSError: the write failed; everything is kept, and the writer may be closed again or abandoned.
        """
        if self._closed:
            return
        if not self._ended:
            self.flush()
            if not self._chunk.is_empty:
                self._seal()
            self._append(self._summary.pack_end(self._end, self._data_crc))
            self._ended = True
        self._drain()
        self._fsync()
        self.abandon()

    def taken(self) -> FileTaken | None:
        """See ``FileSink``."""
        return None if self._closed else self._sink.taken()

    def abandon(self) -> None:
        """Close the file without a summary. A repeated call has no effect."""
        if not self._closed:
            self._ended = self._closed = True
            self._sink.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _refuse_after_end(self) -> None:
        if self._ended:
            raise RecordingError("the log is closed; open another")

    def _seal_messages(self) -> None:
        """Put all accepted rows into sealed chunks."""
        self._pack_staged()
        if self._chunk.has_messages:
            self._seal()

    def _seal(self) -> None:
        chunk, indexes = self._chunk.seal()
        packed = chunk.pack()
        at, positions = self._end + len(packed), {}
        for number, index in indexes.items():
            positions[number] = at
            at += len(index)
        length = at - self._end - len(packed)
        self._summary.add_chunk(chunk, self._end, len(packed), positions, length)
        self._append(b"".join((packed, *indexes.values())))

    def _append(self, block: bytes) -> None:
        self._blocks.append(block)
        self._end += len(block)
        self._data_crc = zlib.crc32(block, self._data_crc)

    def _drain_unless_failing(self) -> None:
        if not self._failing:
            self._drain()

    def _drain(self) -> None:
        while self._written < len(self._blocks):
            block = self._blocks[self._written]
            try:
                self._sink.write_at(self._offset, block)
            except OSError:
                self._failing = True
                raise
            self._offset += len(block)
            self._written += 1
            if self._offset - self._synced_offset > _MAX_UNSYNCED_BYTES:
                self._fsync()

    def _fsync(self) -> None:
        try:
            self._sink.sync()
        except OSError:
            self._offset, self._written = self._synced_offset, 0
            self._failing = True
            raise
        del self._blocks[: self._written]
        self._synced_offset, self._written = self._offset, 0
