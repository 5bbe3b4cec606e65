"""Recovering a log: what can be read is in a new one, what cannot is named, to the last number."""

import os
from pathlib import Path

import numpy as np
import pytest

from drivers import records
from onboard.recording.reader import LogReader
from onboard.recording.recover import GAP_CHANNEL, LOST, recover
from onboard.recording.writer import LogWriter
from tests.recording import logs


def numbers(gaps, channel):
    return sorted(n for gap in gaps if gap.channel == channel for n in range(gap.first, gap.last + 1))


def test_a_whole_log_is_recovered_without_loss(tmp_path):
    path = tmp_path / "whole.mcap"
    with LogWriter.create(path) as writer:
        writer.add_metadata("host", {"machine": "test"})
        writer.attach("vehicle.toml", "application/toml", b'name = "x"\n')
        writer.register("reading", logs.READING, units={"value": "N"})
        writer.register("label", logs.LABEL)
        writer.register("silent", records.IMU)
        for first in range(0, 3000, 30):
            writer.write("reading", logs.reading_rows(first, 30))
            writer.write("label", logs.label_rows(first // 10, 3))
    done = recover(path, tmp_path / "out.mcap")
    assert (done.exit_code, done.gaps, done.damage) == (0, (), ())
    assert done.rows == {"reading": 3000, "label": 300, "silent": 0}
    before, after = LogReader(path), LogReader(tmp_path / "out.mcap")
    assert after.complete
    assert after.attachments == before.attachments
    assert after.metadata.keys() == {"host", "recovered"}
    assert after.units["reading"] == {"value": "N"}
    for name in before.channels:
        assert logs.same_fields(after.read(name), before.read(name))


def test_a_bit_in_every_chunk_in_turn_costs_that_chunk_and_is_told_to_the_row(tmp_path, small, rng):
    data = small.read_bytes()
    places = logs.chunk_places(data)
    assert len(places) > 5
    lost_in_all = []
    for start, end in places:
        hurt = bytearray(data)
        hurt[int(rng.integers(start + 49, end))] ^= 1 << int(rng.integers(8))
        small.write_bytes(hurt)
        output = tmp_path / f"out{start}.mcap"
        done = recover(small, output)
        log = LogReader(output)
        assert log.complete
        assert list(log.channels) == ["reading", "label", GAP_CHANNEL]
        assert done.exit_code == 3
        assert len(done.damage) >= 1
        kept = log.read("reading")["sequence"].tolist()
        missing = sorted(set(range(logs.SMALL)) - set(kept))
        # after the last row of a channel that the log still has, nobody can know of more
        assert numbers(done.gaps, "reading") == [n for n in missing if n < max(kept)]
        assert {gap.cause for gap in done.gaps} <= {LOST}
        told = [(g["channel"].decode(), int(g["first_missing"]), int(g["last_missing"])) for g in log.read(GAP_CHANNEL)]
        assert told == [(gap.channel, gap.first, gap.last) for gap in done.gaps]
        lost_in_all += missing
    assert sorted(lost_in_all) == list(range(logs.SMALL))  # each row is in one chunk, and lost with it alone


@pytest.mark.parametrize("step", [97, pytest.param(13, marks=pytest.mark.campaign)])
def test_cut_anywhere_the_exit_code_says_what_became_of_it(tmp_path, small, monkeypatch, step):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    data = small.read_bytes()
    codes = set()
    for size in range(0, len(data), step):
        logs.overwrite(small, data[:size])
        output = tmp_path / "out.mcap"
        readable = size >= 8 and any(len(LogReader(small).read(n)) for n in LogReader(small).channels)
        done = recover(small, output)
        codes.add(done.exit_code)
        assert done.exit_code == (3 if readable else 1), size
        assert output.exists() == bool(done.rows)
        if output.exists():
            assert LogReader(output).complete
            output.unlink()
    assert codes == {1, 3}


def test_gaps_that_the_flight_told_are_no_loss_of_the_log(tmp_path):
    path = tmp_path / "a.mcap"
    with LogWriter.create(path) as writer:
        writer.register("reading", logs.READING)
        writer.register("gap", records.GAP)
        writer.write("reading", np.concatenate([logs.reading_rows(0, 10), logs.reading_rows(14, 6)]))
        writer.write("gap", records.gap(14_000, "reading", 10, 13, 5000, "bus").rows)
    done = recover(path, tmp_path / "b.mcap")
    assert done.exit_code == 0
    assert [str(gap) for gap in done.gaps] == ["reading: 10 to 13 missing, 0.000 s, bus"]
    again = recover(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert (again.exit_code, again.gaps) == (0, done.gaps)


def test_a_gap_told_in_part_is_told_for_the_rest(tmp_path):
    path = tmp_path / "a.mcap"
    with LogWriter.create(path) as writer:
        writer.register("reading", logs.READING)
        writer.register("gap", records.GAP)
        writer.write("reading", np.concatenate([logs.reading_rows(5, 5), logs.reading_rows(30, 6)]))
        for first, last in ((12, 13), (20, 22), (28, 29)):
            writer.write("gap", records.gap(14_000, "reading", first, last, 5000, "bus").rows)
    done = recover(path, tmp_path / "b.mcap")
    assert done.exit_code == 3
    untold = [(gap.first, gap.last) for gap in done.gaps if gap.cause == LOST]
    assert untold == [(0, 4), (10, 11), (14, 19), (23, 27)]
    assert {gap.host_ns for gap in done.gaps if gap.cause == LOST} == {5000, 30_000}
    again = recover(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert [gap for gap in again.gaps if gap.cause == LOST] == [gap for gap in done.gaps if gap.cause == LOST]


@pytest.mark.parametrize("content", [b"", b"no log" * 100, b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(500)])
def test_nothing_recoverable_says_so_and_leaves_no_file(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    done = recover(path, tmp_path / "out.mcap")
    assert done.exit_code == 1
    assert done.problem
    assert not (tmp_path / "out.mcap").exists()


def test_nothing_is_overwritten(small):
    with pytest.raises(FileExistsError):
        recover(small, small)
    assert LogReader(small).complete


def test_progress_comes_to_the_end(tmp_path, small):
    seen = []
    recover(small, tmp_path / "out.mcap", lambda done, size: seen.append((done, size)))
    assert seen == sorted(seen)
    assert 0.5 < seen[-1][0] / seen[-1][1] <= 1


def test_gap_records_of_an_earlier_version_are_read_as_estimates(tmp_path: Path) -> None:
    before = np.dtype(
        [(n, "S24" if n == "cause" else records.GAP[n]) for n in records.GAP.names or () if n != "counted"], align=True
    )
    rows = np.zeros(2, before)
    rows[0] = (0, 9, 4, 6, 100, b"reading", b"a cause of 23 letters..")
    rows[1] = (1, 9, 8, 8, 100, b"reading", b"bus")
    with LogWriter.create(tmp_path / "before.mcap") as writer:
        writer.register("gap", before)
        writer.register("recorder_gap", before)
        writer.write("gap", rows)
        writer.write("recorder_gap", rows[:1])
    read = LogReader(tmp_path / "before.mcap").read("gap")
    assert read.dtype == records.GAP
    assert read["counted"].tolist() == [0, 0]
    assert read[0]["cause"] == b"a cause of 23 letters.."
    recover(tmp_path / "before.mcap", tmp_path / "after.mcap")
    assert (LogReader(tmp_path / "after.mcap").read("gap") == read).all()
