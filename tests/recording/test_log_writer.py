"""The writer, checked by readers that know nothing of it: the stock ``mcap`` package and ``mcap-ros2-support``."""

import errno
import io
import os
import stat
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory

from drivers import records
from onboard import channels
from onboard.recording.errors import ChannelError, RecordingError, SchemaError
from onboard.recording.reader import LogReader
from onboard.recording.schema import message_bytes
from onboard.recording.sink import FileSink
from onboard.recording.writer import LogWriter
from tests.recording.logs import (
    LABEL,
    LARGE,
    READING,
    FailingSink,
    MemorySink,
    label_rows,
    random_rows,
    reading_rows,
    write_small,
)

EVERY_RECORD = {
    "imu_base": records.IMU,
    "joint_1": records.SCALAR,
    "load_cell": records.SCALAR,
    "can_sync": records.CAN_SYNC,
    "pulse": records.PULSE,
    "gap": records.GAP,
    "event": records.EVENT,
    "clock": channels.CLOCK,
    "quantity": channels.QUANTITY,
    "label": LABEL,
}


def written(build, **arguments):
    """The bytes of a log that ``build(writer)`` fills."""
    sink = MemorySink()
    with LogWriter(sink, **arguments) as writer:
        build(writer)
    return bytes(sink.data)


def chunks(data):
    return [
        r for r in StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records if isinstance(r, Chunk)
    ]


def stock_rows(data):
    """Decoded messages by topic, by the stock reader with all checks on."""
    found = {}
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
        found.setdefault(channel.topic, []).append((message, decoded))
    return found


def field_bytes(row, name):
    """The field's own bytes, NULs at its end too."""
    field, offset = row.dtype.fields[name][:2]
    return row.tobytes()[offset : offset + field.itemsize]


def assert_same(rows, decoded):
    assert len(rows) == len(decoded)
    for row, (message, ours) in zip(rows, decoded, strict=True):
        assert message.log_time == message.publish_time == int(row["host_ns"])
        assert message.sequence == int(row["sequence"]) % 2**32
        for name in row.dtype.names:
            field, seen = row.dtype[name], getattr(ours, name)
            if field.base.kind == "S":
                assert bytes(seen) == field_bytes(row, name), name
            elif field.shape:
                assert list(seen) == row[name].reshape(-1).tolist(), name
            else:
                assert seen == row[name].item(), name


def test_stock_readers_decode_every_channel_to_the_same_numbers(rng):
    rows = {name: random_rows(rng, dtype, 120) for name, dtype in EVERY_RECORD.items()}

    def build(writer):
        for name, dtype in EVERY_RECORD.items():
            writer.register(name, dtype)
        for first in range(0, 120, 7):
            for name in rows:
                writer.write(name, rows[name][first : first + 7])

    data = written(build)
    decoded = stock_rows(data)
    assert list(decoded) == list(EVERY_RECORD)
    for name, expected in rows.items():
        assert_same(expected, decoded[name])
    unseekable = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    assert sum(1 for _ in unseekable.iter_messages()) == 120 * len(rows)


kinds = st.sampled_from(["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8", "S1", "S5"])
shapes = st.sampled_from([(), (1,), (3,), (2, 3)])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(kinds, shapes), max_size=7), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_any_dtype_decodes_to_the_same_numbers(fields, count, seed):
    more = [(f"f{n}", kind, shape) if shape else (f"f{n}", kind) for n, (kind, shape) in enumerate(fields)]
    dtype = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), *more], align=True)
    rows = random_rows(np.random.default_rng(seed), dtype, count)

    def build(writer):
        writer.register("anything", dtype)
        writer.write("anything", rows)

    data = written(build, chunk_bytes=1000)
    assert_same(rows, stock_rows(data)["anything"])
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        path.write_bytes(data)
        back = LogReader(path).read("anything")
    assert back.dtype == dtype
    for name in dtype.names:
        assert np.array_equal(back[name], rows[name]), name


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


def test_same_rows_give_the_same_bytes_whatever_lies_in_the_padding():
    def build_with(padding):
        raw = np.full((50, READING.itemsize), padding, np.uint8)
        rows = raw.reshape(-1).view(READING)
        clean = reading_rows(0, 50)
        for name in READING.names:
            rows[name] = clean[name]
        assert rows.tobytes().count(padding) > 50

        def build(writer):
            writer.register("reading", READING)
            writer.write("reading", rows)

        return written(build)

    assert build_with(0xAA) == build_with(0x55)


def test_batches_of_any_size_make_the_same_rows():
    def build_with(sizes):
        def build(writer):
            writer.register("reading", READING)
            first = 0
            for size in sizes:
                writer.write("reading", reading_rows(first, size))
                first += size

        return written(build)

    assert build_with([1] * 600) == build_with([600]) == build_with([0, 599, 1])


def test_rows_of_a_strided_view_are_written_as_they_are():
    every_other = reading_rows(0, 40)[::2]

    def build(writer):
        writer.register("reading", READING)
        writer.write("reading", every_other)

    assert [decoded.value for _, decoded in stock_rows(written(build))["reading"]] == every_other["value"].tolist()


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


def test_two_channels_share_a_schema_and_other_records_of_a_name_do_not():
    def build(writer):
        writer.register("a", records.SCALAR)
        writer.register("b", records.SCALAR)
        writer.register("c", READING, schema="heft/msg/Scalar")

    summary = SeekingReader(io.BytesIO(written(build))).get_summary()
    assert [c.schema_id for c in summary.channels.values()] == [1, 1, 2]
    assert len({schema.name for schema in summary.schemas.values()}) == 2


def test_large_numbers_keep_their_low_32_bits_in_the_message_and_all_in_the_row():
    rows = reading_rows(2**32 + 5, 1)

    def build(writer):
        writer.register("reading", READING)
        writer.write("reading", rows)

    [(message, decoded)] = stock_rows(written(build))["reading"]
    assert (message.sequence, decoded.sequence) == (5, 2**32 + 5)


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


@pytest.mark.parametrize(
    ("act", "error"),
    [
        (lambda w: w.write("nobody", reading_rows(0, 1)), ChannelError),
        (lambda w: w.write("reading", label_rows(0, 1)), ChannelError),
        (lambda w: w.write("reading", reading_rows(0, 4).reshape(2, 2)), ChannelError),
        (lambda w: w.register("reading", LABEL), ChannelError),
        (lambda w: w.register("other", np.dtype([("value", "<f8")])), ChannelError),
        (lambda w: w.register("a" * 33, READING), ChannelError),
        (lambda w: w.register("", READING), ChannelError),
        (lambda w: w.register("other", np.dtype([("sequence", "<u4"), ("host_ns", "<i8")], align=True)), ChannelError),
        (lambda w: w.register("other", np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("x", "<f2")])), SchemaError),
    ],
)
def test_misuse_is_named_and_leaves_the_log_good(act, error):
    def build(writer):
        writer.register("reading", READING)
        with pytest.raises(error):
            act(writer)
        writer.register("reading", READING)
        writer.write("reading", reading_rows(0, 3))

    assert len(stock_rows(written(build))["reading"]) == 3


@pytest.mark.parametrize("late", ["write", "attach", "add_metadata"])
def test_a_closed_log_takes_nothing(late):
    sink = MemorySink()
    writer = LogWriter(sink)
    writer.register("reading", READING)
    writer.close()
    size = len(sink.data)
    arguments = {"write": ("reading", reading_rows(0, 1)), "attach": ("a", "b", b"c"), "add_metadata": ("a", {})}
    with pytest.raises(RecordingError, match="closed"):
        getattr(writer, late)(*arguments[late])
    assert len(sink.data) == size


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


def test_log_time_is_utc_where_the_wall_clock_was_set():
    wall_ns = 1_795_190_705_000_000_000

    def times(facts):
        def build(writer):
            writer.add_metadata("flight", facts)
            writer.register("reading", READING)
            writer.write("reading", reading_rows(0, 20))

        messages = SeekingReader(io.BytesIO(written(build))).iter_messages()
        return np.array([(message.log_time, message.publish_time) for _, _, message in messages])

    host_ns = reading_rows(0, 20)["host_ns"]
    told = {"wall_clock_ns": str(wall_ns), "monotonic_ns": "1000"}
    assert np.array_equal(times(told), np.stack([host_ns + wall_ns - 1000] * 2, axis=1))
    for unset in ({}, {**told, "wall_clock_ns": "1234567"}):  # simulated; a computer that began at 1970
        assert np.array_equal(times(unset), np.stack([host_ns] * 2, axis=1))
