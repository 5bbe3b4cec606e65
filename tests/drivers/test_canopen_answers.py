"""TPDOs that come late, are lost, or begin anew, and the SYNCs that they answer."""

import numpy as np
import pytest

from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of
from tests.drivers.test_canopen_sync import END, PERIOD_NS, Stream, gaps


def test_a_gap_long_ago_owes_nothing():
    stream = Stream()
    for number in range(1_000):
        stream.sync_at(number)
        if number != 10:
            stream.answer(number)
    stream.answer(999, delay_ns=400_000)
    stream.sync_at(1_000)
    stream.end()
    assert gaps(stream) == [(b"no_pdo", 1), (b"pdo_extra", 1), END]


def test_an_overdue_sync_lets_the_answer_out_and_it_is_not_counted_twice():
    stream = Stream()
    stream.sync_at(0)
    stream.answer(0)
    stream.channel.settle()
    stream.take()
    assert of(stream.batches, "n")["tick"].tolist() == [0]
    stream.answer(1)  # its SYNC was lost
    stream.channel.settle()
    stream.channel.settle()
    stream.sync_at(3)
    stream.answer(3)
    stream.sync_at(4)
    assert stream.end()["tick"].tolist() == [0, 1, 3]
    assert "pdo_extra" not in codes(stream.batches)


def test_answers_before_the_node_is_live_are_no_samples():
    stream = Stream()
    stream.sync_at(1)
    stream.channel.live = False
    stream.answer(1)
    stream.sync_at(2)
    stream.channel.go_live()
    stream.answer(2)
    stream.sync_at(3)
    stream.answer(3)
    stream.sync_at(4)
    stream.answer(4)
    rows = stream.end()
    assert rows["tick"].tolist() == [2, 3, 4]
    assert rows["sequence"].tolist() == [0, 1, 2]


def test_a_reset_node_says_so_in_its_next_row_and_its_gap():
    stream = Stream()
    for number in range(3):
        stream.sync_at(number)
        stream.answer(number)
    stream.sync_at(3)
    stream.channel.node_reset()
    for number in range(4, 50):
        stream.sync_at(number)
    stream.channel.go_live()
    for number in range(50, 53):
        stream.sync_at(number)
        stream.answer(number)
    rows = stream.end()
    assert rows["tick"].tolist() == [0, 1, 2, 50, 51, 52]
    assert rows["status"].tolist() == [0, 0, 0, SampleStatus.AFTER_RESET, 0, 0]
    (gap,) = of(stream.batches, "gap")
    assert (int(gap["first_missing"]), int(gap["last_missing"]), gap["cause"]) == (3, 49, b"node_reset")
    assert "silent" not in codes(stream.batches)


def test_a_node_that_runs_and_is_silent_is_told_once():
    stream = Stream()
    for number in range(100):
        stream.sync_at(number)
    stream.take()
    assert codes(stream.batches) == ["silent"]
    assert not len(np.concatenate([batch.rows for batch in stream.batches if batch.channel == "n"] or [np.zeros(0)]))


@pytest.mark.parametrize(("first", "named"), [(3, []), (50, [(b"no_pdo", 50)]), (None, [(b"no_pdo", 100)])])
def test_answers_lost_before_the_first_row_are_a_gap_and_a_node_that_starts_is_given_time(first, named):
    stream = Stream()
    stream.channel.live = False
    stream.sync_at(0, 0)
    stream.channel.go_live()
    for number in range(1, 101):
        stream.sync_at(number)
        if first is not None and number > first:
            stream.answer(number)
    rows = stream.end()
    assert len(rows) == (0 if first is None else 100 - first)
    assert gaps(stream) == named
    assert not any(gap["counted"] for gap in of(stream.batches, "gap"))


@pytest.mark.parametrize("paused", [6, 11, 60])
def test_a_bus_that_pauses_while_a_node_is_started_has_lost_no_answer(paused):
    """A busy computer, or an adapter: SYNCs come late and at once, and the command to start waited as long."""
    stream = Stream()
    stream.channel.live = False
    for number in range(20):
        stream.sync_at(number)
    stream.channel.go_live()
    for number in range(20, 20 + paused):
        stream.sync_at(number, (20 + paused) * PERIOD_NS)
    for number in range(20 + paused, 50 + paused):
        stream.sync_at(number, number * PERIOD_NS + PERIOD_NS // 10)
        if number > 20 + paused:
            stream.answer(number, PERIOD_NS // 2)
    assert len(stream.end()) == 29
    assert gaps(stream) == []


@pytest.mark.parametrize("paused", [3, 10, 60])
def test_an_answer_that_comes_after_a_pause_belongs_to_the_sync_before_it(paused):
    stream = Stream()
    for number in range(11):
        stream.sync_at(number)
        stream.answer(number, delay_ns=300_000 if number < 10 else paused * PERIOD_NS)
    stream.channel.settle()  # the next SYNC is overdue
    for number in range(11, 11 + paused):
        stream.sync_at(number, (10 + paused) * PERIOD_NS + 200_000)
        stream.answer(number, delay_ns=(10 + paused - number) * PERIOD_NS + 300_000)
    stream.sync_at(11 + paused)
    rows = stream.end()
    assert rows["tick"].tolist() == rows["value_raw"].tolist() == list(range(11 + paused))
    assert gaps(stream) == [END]


def test_the_last_answer_of_a_run_is_a_row_however_late_it_comes():
    stream = Stream()
    for number in range(5):
        stream.sync_at(number)
        stream.answer(number, delay_ns=300_000 if number < 4 else 4 * PERIOD_NS)
    stream.channel.settle()
    assert stream.end()["tick"].tolist() == [0, 1, 2, 3, 4]


def test_answers_before_the_first_sync_are_a_gap():
    stream = Stream()
    for number in range(20):
        stream.answer(number)
    for number in range(20, 30):
        stream.sync_at(number)
        stream.answer(number)
    assert len(stream.end()) == 10
    assert [count for _, count in gaps(stream)] == [20]


def test_a_gap_is_named_even_when_nothing_more_comes():
    stream = Stream()
    stream.sync_at(0)
    stream.answer(0)
    for number in range(1, 11):
        stream.sync_at(number)
    assert len(stream.end(now_ns=77)) == 1
    (gap,) = of(stream.batches, "gap")
    assert (int(gap["first_missing"]), int(gap["last_missing"]), int(gap["host_ns"])) == (1, 10, 77)


@pytest.mark.parametrize("lost", [26, 155, 240, 266, 480])
@pytest.mark.parametrize("boundary_ms", [0, 3])
def test_what_a_full_queue_lost_behind_it_is_counted_and_no_restart(lost, boundary_ms):
    """A reader stood still; the queue holds the oldest frames, stamped when read, in portions; then live ones come."""
    period_ns, kept = 5_000_000, 300
    counter = SyncCounter(period_ns)
    for tick in range(100):
        counter.advance(tick % 240 + 1, tick * period_ns)
    read_ns = (99 + kept + lost) * period_ns + 1_000_000
    missing, restarts = 0, 0
    for tick in range(100, 100 + kept):
        at_ns = read_ns + boundary_ms * 1_000_000 * (tick >= 200)
        step = counter.advance(tick % 240 + 1, at_ns, read_ns - (kept - 1) * period_ns if tick == 100 else None, True)
        missing, restarts = missing + step.lost, restarts + step.restarted
    assert (missing, restarts) == (0, 0)
    for tick in range(100 + kept + lost, 150 + kept + lost):
        step = counter.advance(tick % 240 + 1, tick * period_ns + 100_000, None, True)
        missing, restarts = missing + step.lost, restarts + step.restarted
    assert (missing, restarts) == (lost, 0)
    assert counter.tick == 149 + kept + lost
