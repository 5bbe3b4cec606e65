"""Rings to log: every row is in the log once, or in a gap record."""

import errno

import numpy as np
import pytest

from drivers.records import GAP, Severity
from onboard.recording.reader import LogReader
from onboard.recording.recorder import EVENT_CHANNEL, GAP_CHANNEL, Recorder
from onboard.recording.writer import LogWriter
from tests.recording.logs import DISK_ERRORS, LABEL, FailingSink, label_rows, reading_rows, same_fields
from tests.recording.recorder_bench import STEP_NS, Bench, FakeRing, events, gaps


@pytest.fixture
def ring():
    return FakeRing("reading")


@pytest.fixture
def bench(tmp_path, ring):
    return Bench(tmp_path / "log.mcap", ring)


def test_rows_go_through(bench, ring):
    ring.next = [(reading_rows(0, 10), 0), (reading_rows(10, 0), 0), (reading_rows(10, 5), 0)]
    assert [bench.step() for _ in range(3)] == [(10, 0, False), (0, 0, False), (5, 0, False)]
    log = bench.log()
    assert same_fields(log.read("reading"), reading_rows(0, 15))
    assert gaps(log) == events(log) == []
    assert list(log.channels) == ["reading", GAP_CHANNEL, EVENT_CHANNEL]


def test_an_overrun_becomes_a_gap_record(bench, ring):
    ring.next = [(reading_rows(0, 10), 0), (reading_rows(14, 6), 4)]
    bench.step()
    assert bench.step() == (6, 4, False)
    log = bench.log()
    [gap] = log.read(GAP_CHANNEL)
    assert (gap["channel"], gap["cause"]) == (b"reading", b"ring_overrun")
    assert (gap["first_missing"], gap["last_missing"]) == (10, 13)
    assert gap["duration_ns"] == 5 * 1000  # from row 9 to row 14
    assert gap["host_ns"] == 2 * STEP_NS


def test_rows_lost_before_the_first_are_told(bench, ring):
    ring.next = [(reading_rows(100, 5), 100)]
    bench.step()
    assert gaps(bench.log()) == [(b"reading", 0, 99)]


def test_rows_lost_among_those_read_are_told(bench, ring):
    rows = reading_rows(0, 20)
    ring.next = [(rows[:5], 0), (np.concatenate([rows[7:10], rows[12:13], rows[15:]]), 6)]
    bench.step()
    bench.step()
    assert gaps(bench.log()) == [(b"reading", 5, 6), (b"reading", 10, 11), (b"reading", 13, 14)]


def test_a_gap_that_the_device_has_told_is_not_told_again(bench, ring):
    """Rows 5..6 were lost by the ring; 10..11 never came from the device, whose driver has recorded so."""
    rows = reading_rows(0, 20)
    ring.next = [(rows[:5], 0), (np.concatenate([rows[7:10], rows[12:]]), 2)]
    bench.step()
    bench.step()
    assert gaps(bench.log()) == [(b"reading", 5, 6)]


def test_a_loss_with_nothing_left_is_told_with_the_next_rows(bench, ring):
    ring.next = [(reading_rows(0, 5), 0), (reading_rows(0, 0), 3), (reading_rows(8, 2), 0)]
    assert [bench.step().lost for _ in range(3)] == [0, 3, 0]
    assert gaps(bench.log()) == [(b"reading", 5, 7)]


def test_a_loss_that_numbers_do_not_show_is_an_event(bench, ring):
    ring.next = [(reading_rows(0, 5), 0), (reading_rows(0, 5), 4)]  # the device began again at 0
    bench.step()
    bench.step()
    log = bench.log()
    assert gaps(log) == []
    [event] = log.read(EVENT_CHANNEL)
    assert b"4 rows" in event["text"]
    assert event["severity"] == Severity.ERROR


@pytest.mark.parametrize("number", DISK_ERRORS)
@pytest.mark.parametrize("operation", ["refuse_writes", "refuse_syncs"])
def test_a_disk_that_refuses_costs_nothing_while_the_ring_holds(bench, ring, number, operation):
    ring.next = [(reading_rows(n * 40, 40), 0) for n in range(40)]
    for _ in range(8):
        assert not bench.step().failing
    setattr(bench.sink, operation, number)
    reports = [bench.step() for _ in range(20)]
    assert reports[-1].failing
    assert sum(report.rows for report in reports[4:]) == 0  # the ring is the buffer
    assert bench.recorder.close(bench.now_ns).failing
    setattr(bench.sink, operation, 0)
    while ring.next:
        bench.step()
    log = bench.log()
    assert same_fields(log.read("reading"), reading_rows(0, 1600))
    assert events(log) == [("ERROR", "disk_error"), ("INFO", "disk_resumed")]
    assert gaps(log) == []
    refused, resumed = log.read(EVENT_CHANNEL)
    assert refused["host_ns"] < resumed["host_ns"]
    assert b"refused" in refused["text"]


def test_a_disk_that_refuses_at_the_very_end_can_be_asked_again(bench, ring):
    ring.next = [(reading_rows(0, 30), 0)]
    bench.sink.refuse_syncs = errno.EIO
    assert bench.recorder.close(STEP_NS).failing
    assert not bench.sink.closed
    bench.sink.refuse_syncs = 0
    assert same_fields(bench.log().read("reading"), reading_rows(0, 30))
    assert bench.sink.closed


def test_a_failing_disk_is_not_hammered(bench, ring):
    ring.next = [(reading_rows(n, 1), 0) for n in range(200)]
    bench.step()
    tries = []
    bench.sink.refuse_writes = errno.EIO
    real = bench.sink.write_at
    bench.sink.write_at = lambda offset, data: (tries.append(offset), real(offset, data))
    for _ in range(60):
        bench.step()
    assert 15 <= len(tries) <= 21  # 3 s at one try each 150 ms


def test_several_rings(tmp_path):
    sink = FailingSink(tmp_path / "log.mcap")
    readings, labels = FakeRing("reading"), FakeRing("label", LABEL)
    readings.next, labels.next = [(reading_rows(0, 3), 0)], [(label_rows(0, 2), 1)]
    recorder = Recorder(LogWriter(sink), [readings, labels])
    assert recorder.step(0) == (5, 1, False)
    recorder.close(1)
    log = LogReader(tmp_path / "log.mcap")
    assert same_fields(log.read("reading"), reading_rows(0, 3))
    assert same_fields(log.read("label"), label_rows(0, 2))
    assert log.channels[GAP_CHANNEL] == GAP
