"""Logs whose writer died, ended for it: cut at every byte, whole again, nothing lost that could be read."""

import io
import os

import pytest
from mcap.reader import SeekingReader

from onboard.recording.reader import LogReader
from onboard.recording.seal import seal
from tests.recording.logs import LEAST, chunk_places, overwrite, write_small


@pytest.fixture
def small(tmp_path):
    return write_small(tmp_path / "small.mcap")


def rows_of(log):
    """The bytes of each channel's rows, in one pass."""
    rows = {}
    for name, batch in log.batches():
        rows[name] = rows.get(name, b"") + batch.tobytes()
    return rows


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.campaign)])
def test_cut_at_every_byte_it_is_whole_again_with_every_row_that_could_be_read(tmp_path, monkeypatch, step):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    data = write_small(tmp_path / "least.mcap", LEAST).read_bytes()
    path = tmp_path / "cut.mcap"
    for size in range(8, len(data), step):
        overwrite(path, data[:size])
        log = LogReader(path)
        before = rows_of(log)
        sealed = seal(path)
        after = LogReader(path)
        assert sealed.whole
        assert after.complete, size
        assert rows_of(after) == before
        assert (after.metadata, after.attachments) == (log.metadata, log.attachments)
        assert sealed.used == bool(before)


@pytest.mark.parametrize("share", [0.4, 0.75, 0.97, "before the indexes of both channels"])
def test_stock_tools_read_what_was_sealed(small, share):
    data = small.read_bytes()
    small.write_bytes(data[: chunk_places(data)[4][1] if isinstance(share, str) else int(share * len(data))])
    expected = {name: log.size for name, log in ((n, LogReader(small).read(n)) for n in ("reading", "label"))}
    seal(small)
    reader = SeekingReader(io.BytesIO(small.read_bytes()), validate_crcs=True)
    counts = {"reading": 0, "label": 0}
    for _, channel, _ in reader.iter_messages():
        counts[channel.topic] += 1
    assert counts == expected
    summary = reader.get_summary()
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    said = {topics[number]: count for number, count in summary.statistics.channel_message_counts.items()}
    assert said == expected
    assert len(summary.chunk_indexes) > 1
    for index in summary.chunk_indexes:
        assert index.message_index_offsets
        for channel, offset in index.message_index_offsets.items():
            record = small.read_bytes()[offset:]
            assert record[0] == 7
            assert int.from_bytes(record[9:11], "little") == channel


def test_a_whole_log_and_one_damaged_elsewhere_stay_as_they_are(small):
    data = small.read_bytes()
    assert seal(small) == (True, True)
    assert small.read_bytes() == data
    hurt = bytearray(data[: len(data) // 2])
    hurt[300] ^= 1
    small.write_bytes(hurt)
    assert seal(small) == (True, False)
    assert small.read_bytes() == hurt


def test_what_is_no_log_is_left_alone(tmp_path):
    path = tmp_path / "other.mcap"
    path.write_bytes(b"not a log at all" * 40)
    assert seal(path) == (False, False)
    assert path.read_bytes() == b"not a log at all" * 40
