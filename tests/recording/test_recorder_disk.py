"""Rings to log when the disk refuses, stalls, is full, or the recorder dies: what is missing is in gap records."""

import errno
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.records import EVENT, Severity, event
from onboard.recording.reader import LogReader
from onboard.recording.recorder import GAP_CHANNEL, Recorder
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.space import Room
from onboard.ring import RingReader, RingWriter
from tests.recording.logs import DISK_ERRORS, READING, reading_rows, same_fields
from tests.recording.recorder_bench import STEP_NS, Bench, FakeRing, events, gaps


@pytest.fixture
def ring():
    return FakeRing("reading")


@pytest.fixture
def bench(tmp_path, ring):
    return Bench(tmp_path / "log.mcap", ring)


class RealRing:
    """A real ring with a writer, under a bench."""

    def __init__(self, directory, capacity=64):
        self.path = directory / "reading.ring"
        self.writer = RingWriter(self.path, READING, capacity)
        self.number = 0

    def push(self, count):
        self.writer.push(reading_rows(self.number, count))
        self.number += count


def exactly(log, total):
    """Rows and gap records are together the numbers 0 .. total, none twice."""
    told = [n for _, first, last in gaps(log) for n in range(first, last + 1)]
    recorded = log.read("reading")["sequence"].tolist()
    assert sorted(recorded + told) == list(range(total))
    assert same_fields(log.read("reading"), reading_rows(0, total)[recorded])
    return told


@pytest.mark.parametrize("number", DISK_ERRORS)
@pytest.mark.parametrize("operation", ["refuse_writes", "refuse_syncs"])
def test_what_a_ring_can_hold_no_longer_is_given_up_and_told_exactly(tmp_path, number, operation):
    ring = RealRing(tmp_path)
    bench = Bench(tmp_path / "log.mcap", RingReader(ring.path))
    for _ in range(5):
        ring.push(10)
        bench.step()
    setattr(bench.sink, operation, number)
    lost = 0
    for _ in range(40):
        ring.push(10)
        lost += bench.step().lost
    setattr(bench.sink, operation, 0)
    for _ in range(6):
        ring.push(10)
        lost += bench.step().lost
    log = bench.log()
    told = exactly(log, 510)
    assert len(told) == lost > 250
    [gap] = log.read(GAP_CHANNEL)
    assert gap["cause"] == (b"disk_full" if number == errno.ENOSPC else b"disk_refused")
    before, after = int(gap["first_missing"]) - 1, int(gap["last_missing"]) + 1
    assert gap["duration_ns"] == (after - before) * 1000
    assert events(log) == [("ERROR", "disk_error"), ("INFO", "disk_resumed"), ("ERROR", "rows_lost")]


@pytest.mark.parametrize(("stall_s", "lost"), [(0.5, 0), (5.0, 0), (15.0, 3050)])
def test_a_write_that_stalls_costs_what_the_ring_overran_and_that_is_told(tmp_path, stall_s, lost):
    """A channel at 1 kHz in a ring of 12 s; the recorder stands still in a sync, acquisition goes on pushing."""
    ring = RealRing(tmp_path, 12_000)
    bench = Bench(tmp_path / "log.mcap", RingReader(ring.path))
    for _ in range(8):
        ring.push(50)
        bench.step()
    real = bench.sink.sync

    def stalled():
        bench.sink.sync = real
        for _ in range(round(stall_s / 0.05)):
            ring.push(50)
        real()

    bench.sink.sync = stalled
    for _ in range(8):
        ring.push(50)
        bench.step()
    log = bench.log()
    assert len(exactly(log, ring.number)) == lost
    assert set(log.read(GAP_CHANNEL)["cause"].tolist()) == ({b"ring_overrun"} if lost else set())


class FakeSpace:
    """Says what the test wants."""

    def __init__(self):
        self.for_all, self.removed, self.closed = True, (), False

    def look(self, *, refused=False):
        self.for_all &= not refused
        return Room(self.for_all, self.removed)

    def close(self):
        self.closed = True


def test_on_a_full_disk_events_go_on_and_all_else_is_told_as_missing(tmp_path):
    ring, event_ring = RealRing(tmp_path), RingWriter(tmp_path / "event.ring", EVENT, 64)
    space = FakeSpace()
    bench = Bench(tmp_path / "log.mcap", RingReader(ring.path), RingReader(tmp_path / "event.ring"), space=space)

    def second(count=20):
        for _ in range(count):
            row = event(bench.now_ns, Severity.INFO, "tick", "test", f"{event_ring.published}").rows
            row["sequence"] = event_ring.published
            event_ring.push(row)
            ring.push(10)
            bench.step()

    second()
    space.for_all = False
    second(60)
    halfway = len(gaps_so_far(bench))
    assert halfway >= 2  # reported while it lasts, once a second
    space.for_all, space.removed = True, (tmp_path / "old_000.mcap",)
    second()
    space.removed = ()
    space.for_all = False
    second()
    log = bench.log()
    assert space.closed
    told = exactly(log, ring.number)
    assert len(told) > 500
    assert set(log.read(GAP_CHANNEL)["cause"].tolist()) == {b"disk_full"}
    assert log.read("event")["sequence"].tolist() == list(range(event_ring.published))
    said = [code for _, code in events(log)]
    assert said.count("disk_nearly_full") == 2
    assert said.count("disk_has_room") == 1
    assert "old_flight_removed" in said


def gaps_so_far(bench):
    bench.writer.flush()
    copy = bench.path.with_name("copy.mcap")
    copy.write_bytes(bench.sink.data)
    return LogReader(copy).read(GAP_CHANNEL)


def test_a_disk_that_refuses_for_want_of_space_holds_bulk_back_until_there_is_room(tmp_path):
    ring, space = RealRing(tmp_path, 600), FakeSpace()
    bench = Bench(tmp_path / "log.mcap", RingReader(ring.path), space=space)
    ring.push(10)
    bench.step()
    bench.sink.refuse_writes = errno.ENOSPC
    for _ in range(4):
        ring.push(10)
        bench.step()
    bench.sink.refuse_writes = 0  # the ballast has made room
    for _ in range(10):
        ring.push(10)
        bench.step()
    held = len(LogReader(_copy(bench)).read("reading"))
    assert held < 60
    space.for_all = True
    for _ in range(25):
        ring.push(10)
        bench.step()
    assert exactly(bench.log(), ring.number) == []


def _copy(bench):
    copy = bench.path.with_name("copy.mcap")
    copy.write_bytes(bench.sink.data)
    return copy


happenings = st.lists(
    st.one_of(
        st.tuples(st.just("push"), st.integers(1, 90)),
        st.tuples(st.just("skip"), st.integers(1, 5)),  # the device loses samples and counts them
        st.tuples(st.just("step"), st.just(0)),
        st.tuples(st.just("refuse_writes"), st.sampled_from([0, *DISK_ERRORS])),
        st.tuples(st.just("refuse_syncs"), st.sampled_from([0, *DISK_ERRORS])),
    ),
    max_size=60,
)


@settings(max_examples=60)
@given(happenings)
def test_recorded_and_gaps_are_together_what_was_pushed(happenings):
    """Against a plain list: a real ring of 64 rows, a disk that fails at will, a device that loses samples."""
    with tempfile.TemporaryDirectory() as directory:
        source = RingWriter(Path(directory) / "reading.ring", READING, 64)
        reader = RingReader(Path(directory) / "reading.ring")
        bench = Bench(Path(directory) / "log.mcap", reader)
        number, pushed, lost = 0, set(), 0
        for what, value in happenings:
            if what == "push":
                source.push(reading_rows(number, value))
                pushed |= set(range(number, number + value))
                number += value
            elif what == "skip":
                number += value
            elif what == "step":
                lost += bench.step().lost
            else:
                setattr(bench.sink, what, value)
        bench.sink.refuse_writes = bench.sink.refuse_syncs = 0
        for _ in range(4):  # until it is due to try the disk again
            lost += bench.step().lost
        log = bench.log()
        rows = log.read("reading")
        recorded = rows["sequence"].tolist()
        missing = set().union(*(range(first, last + 1) for _, first, last in gaps(log)))
        assert same_fields(rows, reading_rows(0, number)[recorded])
        assert recorded == sorted(set(recorded))
        assert not missing & set(recorded)
        assert len(pushed) - len(recorded) == lost
        assert pushed - set(recorded) == missing & pushed
        assert events(log).count(("ERROR", "disk_error")) == events(log).count(("INFO", "disk_resumed"))
        source.close()
        reader.close()


@pytest.mark.parametrize("capacity", [64, 2000])
def test_recorders_that_die_at_any_step_are_followed_without_a_row_lost_doubled_or_altered(tmp_path, rng, capacity):
    """Writers are abandoned as ``kill -9`` leaves them: what the kernel was given is in the file, the rest is not."""
    ring = RealRing(tmp_path, capacity)
    log, now_ns = tmp_path / "log.mcap", 0
    preamble = Preamble("f1")
    for _ in range(30):
        writer = SegmentedLog.resume(log, preamble, limits=SegmentLimits(span_ns=8 * STEP_NS))
        recorder = Recorder(writer, [RingReader(ring.path)], recorded=writer.recorded)
        for _ in range(int(rng.integers(0, 7))):
            ring.push(int(rng.integers(1, 30)))
            now_ns += STEP_NS
            recorder.step(now_ns)
        writer.abandon()
        ring.push(int(rng.integers(0, 90)))  # while there is no recorder
    writer = SegmentedLog.resume(log, preamble)
    recorder = Recorder(writer, [RingReader(ring.path)], recorded=writer.recorded)
    assert not recorder.close(now_ns).failing
    read = LogReader(log)
    assert read.complete
    told = exactly(read, ring.number)
    assert (len(told) > 0) == (capacity == 64)
    numbers = read.read(GAP_CHANNEL)["sequence"].tolist()
    assert numbers == list(range(len(numbers)))
