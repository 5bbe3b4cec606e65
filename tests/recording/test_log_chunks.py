"""Chunks, message indexes and summary of the writer, checked by the stock ``mcap`` package."""

import io

import numpy as np
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers import records
from onboard.recording.format.schema import message_bytes
from tests.recording.logs import LABEL, LARGE, READING, label_rows, reading_rows, write_small
from tests.recording.stock_readers import chunks, stock_rows, written


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
