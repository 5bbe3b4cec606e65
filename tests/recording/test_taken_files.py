"""A log that somebody removes, renames or cuts off while it is written: noticed at once, reported, continued."""

import os
import shutil

import pytest

from onboard.recording.format.segments import segment_path
from onboard.recording.reader import LogReader
from onboard.recording.recorder import EVENT_CHANNEL, GAP_CHANNEL, Recorder
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.ring import RingReader, RingWriter
from tests.recording.logs import READING, reading_rows

STEP_NS = 50_000_000
ROWS = 40


class Flight:
    """40 rows a step of 50 ms."""

    def __init__(self, log, span_ns=10**12, name="f1"):
        self.log, self.said = log, []
        log.parent.mkdir(exist_ok=True)
        self.ring = RingWriter(log.parent.parent / "reading.ring", READING, 10_000)
        self.preamble = Preamble(name, (), {"flight": {"vehicle": "x"}})
        self.writer = SegmentedLog(log, self.preamble, limits=SegmentLimits(span_ns))
        reader, losses = RingReader(self.ring.path), self.writer.take_losses
        self.recorder = Recorder(self.writer, [reader], losses=losses, said=self.said.extend)
        self.now_ns = self.number = 0

    def take_over(self):
        self.writer, self.said = SegmentedLog.resume(self.log, self.preamble), []
        recorded, losses = self.writer.recorded, self.writer.take_losses
        reader = RingReader(self.ring.path)
        self.recorder = Recorder(self.writer, [reader], recorded=recorded, losses=losses, said=self.said.extend)

    def steps_unread(self, count):
        for _ in range(count):
            self.ring.push(reading_rows(self.number, ROWS))
            self.number += ROWS
            self.now_ns += STEP_NS

    def steps(self, count):
        for _ in range(count):
            self.ring.push(reading_rows(self.number, ROWS))
            self.number += ROWS
            self.now_ns += STEP_NS
            self.recorder.step(self.now_ns)

    def codes(self):
        return [row["code"].decode() for row in self.said]

    def end(self):
        """Close; each number is in the log once or in one gap record. The numbers in gap records, and the events."""
        assert not self.recorder.close(self.now_ns).failing
        log = LogReader(self.log)
        told = [gap for gap in log.read(GAP_CHANNEL) if gap["channel"] == b"reading"]
        lost = [n for gap in told for n in range(int(gap["first_missing"]), int(gap["last_missing"]) + 1)]
        assert sorted([*log.read("reading")["sequence"].tolist(), *lost]) == list(range(self.number))
        assert all(gap["counted"] and gap["duration_ns"] >= 0 for gap in told)
        return lost, {row["code"].decode(): row["text"].decode() for row in log.read(EVENT_CHANNEL)}


@pytest.fixture(params=["flight.mcap", "flight"])
def flight(request, tmp_path):
    return Flight(tmp_path / "flights" / request.param)


def test_a_file_left_alone_is_not_taken(flight):
    flight.steps(30)
    assert flight.end() == ([], {})
    assert len(LogReader(flight.log).segments) == 1


def test_one_that_was_removed_is_followed_by_the_next_segment_within_a_second(flight):
    flight.steps(20)
    flight.writer.path.unlink()
    flight.steps(1_000_000_000 // STEP_NS)
    assert flight.codes() == ["log_lost"]
    flight.steps(20)
    lost, events = flight.end()
    assert 20 * ROWS <= len(lost) <= 25 * ROWS  # what the next segment began with is in it
    first = segment_path(flight.log, 0).name
    assert f"{first} was removed: {len(lost)} rows of 1 channels are lost" in events["log_lost"]
    assert segment_path(flight.log, 1).name in events["log_lost"]


@pytest.mark.parametrize("keep", [0, 1, 5000, 20_000])
def test_one_that_was_cut_off_keeps_what_is_left_and_no_hole_is_read(flight, keep):
    flight.steps(20)
    path = flight.writer.path
    assert path.stat().st_size > keep
    os.truncate(path, keep)
    flight.steps(20)
    assert path.stat().st_size == keep
    lost, events = flight.end()
    assert f"cut off after {keep} of" in events["log_lost"]
    assert len(lost) >= 20 * ROWS - keep // 20
    assert (min(lost) > 0) == (keep > 4000)


def test_of_one_that_was_renamed_nothing_is_lost(flight):
    flight.steps(20)
    path, elsewhere = flight.writer.path, flight.writer.path.with_name("elsewhere")
    path.rename(elsewhere)
    flight.steps(20)
    assert flight.codes() == ["log_moved"]
    elsewhere.rename(path)
    lost, events = flight.end()
    assert not lost
    assert f"renamed to {elsewhere}" in events["log_moved"]
    assert LogReader(flight.log).complete


def test_one_that_was_renamed_to_the_next_is_gone_on_with_after_that(flight):
    flight.steps(20)
    flight.writer.path.rename(segment_path(flight.log, 1))
    flight.steps(20)
    assert flight.writer.path == segment_path(flight.log, 2)
    lost, events = flight.end()
    assert not lost
    assert set(events) == {"log_moved"}


def test_one_that_another_file_took_the_place_of_is_left_alone(flight):
    flight.steps(20)
    other = flight.log.parent / "other"
    other.write_bytes(b"mine")
    path = flight.writer.path
    other.rename(path)  # the file in use has no name any more
    flight.steps(20)
    assert path.read_bytes() == b"mine"
    lost, events = flight.end()
    assert len(lost) >= 20 * ROWS
    assert "removed" in events["log_lost"]


def test_a_directory_that_was_removed_is_made_again(flight):
    flight.steps(20)
    shutil.rmtree(flight.log.parent)
    flight.steps(20)
    lost, events = flight.end()
    assert 20 * ROWS <= len(lost) <= 25 * ROWS
    assert set(events) == {"log_lost"}


def test_while_it_cannot_be_made_the_rings_hold_and_it_is_said_once(flight):
    flight.steps(20)
    place = flight.log.parent
    shutil.rmtree(place)
    place.write_bytes(b"in the way")
    flight.steps(40)
    assert flight.codes() == ["disk_error"]
    assert "was removed, and no other can be made" in flight.said[0]["text"].decode()
    assert flight.recorder.failing
    assert flight.recorder.close(flight.now_ns).failing  # the rings are kept for the next start
    place.unlink()
    flight.now_ns += 10**9
    flight.steps(20)
    lost, events = flight.end()
    assert len(lost) <= 30 * ROWS
    assert {"log_lost", "disk_resumed"} <= set(events)


def test_the_one_opened_ahead_is_opened_again(tmp_path):
    flight = Flight(tmp_path / "flights" / "a.mcap", span_ns=20 * STEP_NS)
    flight.steps(10)
    segment_path(flight.log, 1).unlink()
    flight.steps(40)
    assert flight.end() == ([], {})
    assert len(LogReader(flight.log).segments) >= 3


def test_a_log_in_one_file_goes_on_in_another_only_where_it_is_taken(tmp_path):
    flight = Flight(tmp_path / "flights" / "virtual.mcap", name="")
    flight.steps(20)
    assert os.listdir(flight.log.parent) == ["virtual.mcap"]
    flight.log.unlink()
    flight.steps(20)
    second = flight.log.with_name("virtual_001.mcap")
    assert flight.writer.path == second
    assert flight.codes() == ["log_lost"]
    flight.log = second
    lost, events = flight.end()
    assert f"virtual.mcap was removed: {len(lost)} rows" in events["log_lost"]


def test_a_recorder_that_takes_over_says_at_the_end_that_rows_are_lost(tmp_path):
    flight = Flight(tmp_path / "flights" / "a.mcap")
    flight.steps(4)
    flight.writer.abandon()  # killed
    flight.steps_unread(300)  # more than the ring holds
    flight.take_over()
    flight.steps(4)
    flight.writer.sync(flight.now_ns + 10**9)
    flight.writer.abandon()  # again, with the gap in the log
    flight.take_over()
    flight.steps(4)
    lost, events = flight.end()
    assert len(lost) > 1000
    assert flight.codes() == ["rows_lost"]
    assert "1 gap records" in events["rows_lost"]
