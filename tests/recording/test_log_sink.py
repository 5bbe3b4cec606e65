"""When the writer writes and syncs, disks that refuse, files that exist."""

import errno
import io
import os
import stat
from pathlib import Path

import pytest
from mcap.reader import SeekingReader

from onboard.recording.sink import FileSink, FileTaken
from onboard.recording.writer import LogWriter
from tests.recording.logs import READING, FailingSink, MemorySink, reading_rows
from tests.recording.stock_readers import stock_rows


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
