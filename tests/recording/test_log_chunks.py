"""Chunks, message indexes and summary of the writer, checked by the stock ``mcap`` package.

When the writer writes and syncs, disks that refuse, files that exist.
"""

import errno
import io
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers import records
from onboard.recording.format.schema import message_bytes
from onboard.recording.sink import FileSink, FileTaken
from onboard.recording.writer import LogWriter
from tests.recording.logs import LABEL, LARGE, READING, FailingSink, MemorySink, label_rows, reading_rows, write_small
from tests.recording.stock_readers import chunks, stock_rows, written


def test_syncs_come_when_due_and_not_without_news():
    sink = MemorySink()
    writer = LogWriter(sink, sync_interval_ns=150)
    writer.register("reading", READING)
    assert writer.sync(0)
    assert not writer.sync(200)  # nothing new
    writer.write("reading", reading_rows(0, 1))
    assert writer.sync(210)
    before = len(sink.data)
    writer.write("reading", reading_rows(1, 1))
    assert not writer.sync(359)
    assert len(sink.data) == before  # the chunk in the making waits for the sync
    assert writer.sync(360)
    assert len(sink.data) > before
    assert sink.syncs == 3
    assert b"\x0f\x04" not in sink.data[-20:]  # not ended yet
    writer.close()
    writer.close()
    assert sink.closed


def test_a_caller_that_never_syncs_does_not_fill_the_memory():
    sink = MemorySink()
    with LogWriter(sink) as writer:
        writer.register("reading", READING)
        rows = reading_rows(0, 20_000)
        for _ in range(12):
            writer.write("reading", rows)
        assert sink.syncs >= 2
        assert len(sink.data) > 12_000_000


def test_while_the_disk_refuses_everything_is_kept_and_only_sync_tries():
    sink = FailingSink()
    writer = LogWriter(sink, chunk_bytes=1000, sync_interval_ns=100)
    writer.register("reading", READING)
    assert writer.sync(0)
    sink.refuse_writes = errno.EIO
    with pytest.raises(OSError, match="refused"):
        writer.write("reading", reading_rows(0, 80))
    assert writer.failing
    assert writer.backlog_bytes > 0
    writer.write("reading", reading_rows(80, 20))
    writer.attach("a", "text/plain", b"kept")
    writer.add_metadata("m", {"kept": "too"})
    assert not writer.sync(50)  # not due
    with pytest.raises(OSError, match="refused"):
        writer.sync(100)
    with pytest.raises(OSError, match="refused"):
        writer.close()
    assert not writer.ended
    sink.refuse_writes = 0
    assert writer.failing
    assert writer.sync(200)
    assert not writer.failing
    assert writer.backlog_bytes == 0
    writer.close()
    assert [decoded.sequence for _, decoded in stock_rows(bytes(sink.data))["reading"]] == list(range(100))
    assert next(SeekingReader(io.BytesIO(sink.data)).iter_attachments()).data == b"kept"


def test_a_flight_log_is_never_overwritten_by_default(tmp_path):
    path = tmp_path / "flight.mcap"
    LogWriter.create(path).close()
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        LogWriter.create(path)
    assert path.read_bytes() == before
    LogWriter.create(path, overwrite=True).close()
    assert path.read_bytes() == before


def test_file_sink_syncs_file_and_directory(tmp_path, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (synced.append(stat.S_ISDIR(os.fstat(fd).st_mode)), real(fd)))
    sink = FileSink(tmp_path / "a")
    assert synced == [True]
    sink.write_at(0, b"abc")
    sink.write_at(3, b"def")
    sink.write_at(1, b"X")
    sink.sync()
    sink.close()
    assert synced == [True, False]
    assert (tmp_path / "a").read_bytes() == b"aXcdef"
    lazy = FileSink(tmp_path / "b", durable=False)
    lazy.sync()
    lazy.close()
    assert synced == [True, False]


def test_file_sink_goes_on_after_a_short_write(tmp_path, monkeypatch):
    real = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: real(fd, data[:3], offset))
    sink = FileSink(tmp_path / "a", durable=False)
    sink.write_at(0, b"0123456789")
    sink.close()
    assert (tmp_path / "a").read_bytes() == b"0123456789"
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: 0)
    full = FileSink(tmp_path / "b", durable=False)
    with pytest.raises(OSError, match="no bytes"):
        full.write_at(0, b"x")
    full.close()


def test_a_file_removed_while_it_is_looked_for_was_not_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, lstat = tmp_path / "a.mcap", Path.lstat
    sink = FileSink(path)
    sink.write_at(0, b"rows")

    def removed_first(self: Path) -> os.stat_result:
        self.unlink(missing_ok=True)
        return lstat(self)

    monkeypatch.setattr(Path, "lstat", removed_first)
    assert sink.taken() == FileTaken("removed", 0)
    sink.close()


def test_every_chunk_names_its_channels_and_stays_within_the_limit():
    def build(writer):
        writer.register("reading", READING)
        writer.register("label", LABEL)
        for first in range(0, 2000, 50):
            writer.write("reading", reading_rows(first, 50))
            writer.write("label", label_rows(first, 3))

    found = chunks(written(build))
    assert len(found) > 5
    for chunk in found:
        assert chunk.uncompressed_size == len(chunk.data) <= 16384
        content = breakup_chunk(chunk, validate_crc=True)
        kinds = [type(record) for record in content]
        assert kinds == sorted(kinds, key=[Schema, Channel, Message].index) or kinds[:4] == [Schema, Channel] * 2
        schemas = {record.id: record for record in content if isinstance(record, Schema)}
        topics = {record.id: record for record in content if isinstance(record, Channel)}
        messages = [record for record in content if isinstance(record, Message)]
        assert messages
        first_message = kinds.index(Message)
        assert all(kind is Message for kind in kinds[first_message:])
        for message in messages:
            assert topics[message.channel_id].schema_id in schemas
        times = [message.log_time for message in messages]
        assert (chunk.message_start_time, chunk.message_end_time) == (min(times), max(times))


def test_chunks_are_filled():
    def build(writer):
        writer.register("reading", READING)
        for first in range(0, 5000, 3):
            writer.write("reading", reading_rows(first, 3))

    found = chunks(written(build))
    message = 31 + 4 + message_bytes(READING)
    assert len(found) > 10
    assert all(16384 - message < len(chunk.data) <= 16384 for chunk in found[:-1])


def test_message_index_points_at_every_message():
    def build(writer):
        writer.register("reading", READING)
        writer.register("label", LABEL)
        for first in range(0, 60, 6):
            writer.write("reading", reading_rows(first, 6))
            writer.write("label", label_rows(first, 2))

    data = written(build, chunk_bytes=1500)
    chunk, pointed, messages = None, 0, 0
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Chunk):
            chunk = record
            messages += sum(isinstance(r, Message) for r in breakup_chunk(record))
        elif isinstance(record, MessageIndex):
            for log_time, offset in record.records:
                assert chunk.data[offset] == 5  # opcode of a message
                assert int.from_bytes(chunk.data[offset + 9 : offset + 11], "little") == record.channel_id
                assert int.from_bytes(chunk.data[offset + 15 : offset + 23], "little") == log_time
                pointed += 1
    assert pointed == messages == 60 + 20


def test_summary_tells_what_is_there(tmp_path):
    data = write_small(tmp_path / "a.mcap").read_bytes()
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    statistics = summary.statistics
    assert statistics.message_count == 40 + 15
    assert statistics.channel_message_counts == {1: 40, 2: 15}
    assert (statistics.schema_count, statistics.channel_count) == (2, 2)
    assert (statistics.attachment_count, statistics.metadata_count) == (2, 2)
    assert statistics.chunk_count == len(summary.chunk_indexes) == len(chunks(data)) > 6
    assert (statistics.message_start_time, statistics.message_end_time) == (0, 39_000)
    assert {channel.topic for channel in summary.channels.values()} == {"reading", "label"}
    assert [attachment.name for attachment in reader.iter_attachments()] == ["vehicle.toml", "late.bin"]
    assert next(reader.iter_attachments()).data == b'name = "x"\n'
    assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
        ("host", {"machine": "test"}),
        ("end", {"reason": "done"}),
    ]
    for index in summary.chunk_indexes:
        assert index.message_index_offsets
        assert data[index.chunk_start_offset] == 6
        for channel, offset in index.message_index_offsets.items():
            assert data[offset] == 7
            assert int.from_bytes(data[offset + 9 : offset + 11], "little") == channel
    assert any(isinstance(r, DataEnd) and r.data_section_crc for r in StreamReader(io.BytesIO(data)).records)


def test_stock_reader_selects_by_topic_and_time(tmp_path):
    data = write_small(tmp_path / "a.mcap").read_bytes()
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True)
    chosen = list(reader.iter_messages(topics=["reading"], starting_at=20_000, ending_before=30_000))
    assert [message.sequence for _, _, message in chosen] == list(range(20, 30))


def test_a_row_larger_than_a_chunk_gets_its_own():
    big = LARGE
    assert big.itemsize > 16384

    def build(writer):
        writer.register("estimate", big)
        writer.register("reading", READING)
        writer.write("reading", reading_rows(0, 3))
        rows = np.zeros(4, big)
        rows["sequence"] = np.arange(4)
        writer.write("estimate", rows)

    data = written(build)
    assert len(chunks(data)) == 5
    assert [decoded.sequence for _, decoded in stock_rows(data)["estimate"]] == [0, 1, 2, 3]


def test_a_channel_may_come_late_and_a_silent_one_is_still_named():
    def build(writer):
        writer.register("reading", READING)
        writer.write("reading", reading_rows(0, 900))
        writer.register("label", LABEL)
        writer.register("silent", records.IMU)
        writer.write("label", label_rows(0, 4))

    data = written(build)
    summary = SeekingReader(io.BytesIO(data)).get_summary()
    assert {c.topic for c in summary.channels.values()} == {"reading", "label", "silent"}
    named = [{r.topic for r in breakup_chunk(chunk) if isinstance(r, Channel)} for chunk in chunks(data)]
    assert len(named) > 2
    assert "label" in named[-1]
    assert any("silent" in topics for topics in named)
