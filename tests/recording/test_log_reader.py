"""The reader on whole logs: everything comes back, selections select, foreign files are refused, memory stays put."""

import tracemalloc

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from drivers import records
from onboard.recording.format.errors import ChannelError, LogFormatError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.recording.logs import LABEL, READING, SMALL, reading_rows, same_fields, small_labels, write_small


@pytest.fixture
def small(tmp_path):
    return write_small(tmp_path / "small.mcap")


def test_everything_comes_back(small):
    log = LogReader(small)
    assert log.channels == {"reading": READING, "label": LABEL}
    assert same_fields(log.read("reading"), reading_rows(0, SMALL))
    assert same_fields(log.read("label"), small_labels())
    assert log.metadata == {"host": {"machine": "test"}, "end": {"reason": "done"}}
    assert {name: attachment.media_type for name, attachment in log.attachments.items()} == {
        "vehicle.toml": "application/toml",
        "late.bin": "application/octet-stream",
    }
    assert log.attachments["late.bin"].data == bytes(range(64))
    assert (log.damage, log.truncated, log.complete, log.exit_code) == ((), False, True, 0)


def test_batches_come_in_file_order_and_are_the_reader_s_own(small):
    log = LogReader(small)
    seen = {"reading": -1, "label": -1}
    newest = 0
    count = 0
    for batch in log.batches():
        count += 1
        first, last = int(batch.rows["sequence"][0]), int(batch.rows["sequence"][-1])
        assert first >= seen[batch.channel]
        seen[batch.channel] = last
        assert first >= newest - 40  # channels keep together, to the four chunks that the writer stages
        newest = max(newest, last)
        batch.rows["host_ns"] = 0  # a caller may do with them as it likes
    assert count > 8
    assert log.read("reading")["host_ns"][-1] == 39_000


def test_selection_by_channel_and_time(small):
    log = LogReader(small)
    batches = list(log.batches(["reading"], 20_000, 33_000))
    assert {batch.channel for batch in batches} == {"reading"}
    assert np.concatenate([batch.rows["sequence"] for batch in batches]).tolist() == list(range(20, 33))
    assert list(log.batches([])) == []
    assert sum(len(batch.rows) for batch in log.batches(start_ns=39_000)) == 1
    assert sum(len(batch.rows) for batch in log.batches(end_ns=1)) == 1


def test_reading_a_channel_first_is_the_pass_that_tells_of_the_whole_log(small, monkeypatch):
    passes, real = [], LogReader._chunks
    monkeypatch.setattr(LogReader, "_chunks", lambda self: passes.append(self) or real(self))
    log = LogReader(small)
    assert same_fields(log.read("label"), small_labels())
    assert log.channels.keys() == {"reading", "label"}
    assert log.complete
    assert len(passes) == 1


def test_a_log_that_is_kept_is_read_from_the_disk_once(small):
    log, whole = LogReader(small, kept=True), list(LogReader(small).batches())
    next(log.batches())  # a pass that is not whole keeps nothing
    assert log.complete
    small.unlink()
    for _ in range(2):
        again = list(log.batches())
        assert [batch.channel for batch in again] == [batch.channel for batch in whole]
        assert all(same_fields(one.rows, other.rows) for one, other in zip(again, whole, strict=True))
        again[0].rows["host_ns"] = 0  # the caller's own
    assert len(log.read("reading")) == SMALL
    assert 0 < log.position <= log.size


def test_a_log_that_is_too_long_to_be_kept_is_read_again(small, monkeypatch):
    monkeypatch.setattr("onboard.recording.reader.KEPT_BYTES", small.stat().st_size - 1)
    log = LogReader(small, kept=True)
    assert log.complete
    small.unlink()
    with pytest.raises(FileNotFoundError):
        log.read("reading")


@pytest.mark.parametrize("ask", [lambda log: log.batches(["nobody"]), lambda log: log.read("nobody")])
def test_a_channel_that_is_not_there_is_named(small, ask):
    with pytest.raises(ChannelError, match=r"nobody.*reading"):
        ask(LogReader(small))


def test_units_and_silent_channels_come_back(tmp_path):
    path = tmp_path / "a.mcap"
    with LogWriter.create(path) as writer:
        writer.register("pulse", records.PULSE, units={"edge_ns": "ns"})
    log = LogReader(path)
    assert log.units == {"pulse": {"edge_ns": "ns"}}
    assert log.channels == {"pulse": records.PULSE}
    assert len(log.read("pulse")) == 0
    assert log.complete


def test_an_empty_log_is_whole(tmp_path):
    path = tmp_path / "a.mcap"
    LogWriter.create(path).close()
    assert LogReader(path).complete
    assert list(LogReader(path).batches()) == []


def test_one_loop_to_the_end_is_a_survey_too(small):
    log = LogReader(small)
    positions = [log.position for _ in log.batches()]
    assert positions == sorted(positions)
    assert log.position == log.size
    small.unlink()
    assert log.complete
    assert list(log.channels) == ["reading", "label"]


@pytest.mark.parametrize("content", [b"not a log", b"\x89MCAP1\r\n" + bytes(100), b"time,value\n" * 5000, bytes(5000)])
def test_a_file_that_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match="no heft log"):
        LogReader(path)


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        LogReader(tmp_path / "none.mcap")


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_a_log_of_another_writer_is_refused_by_its_name(tmp_path, compression):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start(library="elsewhere 1.0")
        schema = writer.register_schema("a", "jsonschema", b"{}")
        channel = writer.register_channel("topic", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogFormatError, match=r"elsewhere 1\.0"):
        LogReader(path)


def test_definitions_that_contradict_each_other_cost_the_chunk_only(tmp_path):
    """The stock writer lets one topic have two schemas; ours never does."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="heft")
        good = writer.register_schema("heft/msg/A", "ros2msg", b"uint64 sequence\nint64 host_ns\n")
        other = writer.register_schema("heft/msg/B", "ros2msg", b"uint64 sequence\nint64 host_ns\nuint64 more\n")
        topic = writer.register_channel("topic", "cdr", good)
        writer.add_message(topic, 1, b"\0\1\0\0" + bytes(16), 1)
        again = writer.register_channel("topic", "cdr", other)
        writer.add_message(again, 2, b"\0\1\0\0" + bytes(24), 2)
        writer.add_message(topic, 3, b"\0\0\0\0" + bytes(16), 3)  # big-endian CDR
        writer.add_message(topic, 4, b"\0\1\0\0" + bytes(15), 4)  # too short
        writer.add_message(topic, 5, b"\0\1\0\0" + bytes(16), 5)
        writer.finish()
    log = LogReader(path)
    assert len(log.read("topic")) == 2
    reasons = " ".join(damage.reason for damage in log.damage)
    assert "defined twice" in reasons
    assert "not little-endian CDR" in reasons
    assert "differ in size" in reasons
    assert log.exit_code == 3


def test_memory_does_not_grow_with_the_log(tmp_path):
    path = tmp_path / "long.mcap"
    rows = reading_rows(0, 50_000)
    with LogWriter.create(path, durable=False) as writer:
        writer.register("reading", READING)
        for _ in range(8):
            writer.write("reading", rows)
    log = LogReader(path)
    assert log.size > 20_000_000
    tracemalloc.start()
    try:
        assert sum(len(batch.rows) for batch in log.batches()) == 400_000
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2_000_000


def test_a_log_whose_rows_are_filled_up_reads_as_one_whose_are_not(small, tmp_path, monkeypatch):
    """Logs written before messages ended with their last field."""
    monkeypatch.setattr("onboard.recording.format.chunk.message_bytes", lambda dtype: dtype.itemsize)
    older = write_small(tmp_path / "older.mcap")
    assert older.stat().st_size > small.stat().st_size
    log = LogReader(older)
    assert same_fields(log.read("reading"), reading_rows(0, SMALL))
    assert same_fields(log.read("label"), small_labels())
    assert log.complete
