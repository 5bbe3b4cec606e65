"""SYNC numbers out of SYNC counters, and TPDOs to the SYNCs they answer."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from drivers.canopen_pdo.profiles.channel import ProcessData, Sample
from drivers.canopen_pdo.profiles.sync_channel import SyncChannel
from drivers.canopen_pdo.sync import SyncConfig, SyncCounter
from drivers.errors import ConfigurationError
from drivers.reporter import Reporter
from tests.drivers.batches import codes, of, whole

PERIOD_NS = 5_000_000


def counter_of(number):
    return number % 240 + 1


def test_the_first_sync_is_numbered_by_its_counter():
    assert SyncCounter(PERIOD_NS).advance(1, 7).tick == 0
    assert SyncCounter(PERIOD_NS).advance(240, 7).tick == 239
    assert SyncCounter(PERIOD_NS).advance(0, 7).tick == 0


@settings(max_examples=40)
@given(
    first=st.integers(0, 10_000),
    steps=st.lists(st.one_of(st.integers(1, 5), st.integers(1, 100_000)), max_size=60),
    rate_error=st.floats(-4e-4, 4e-4),
    data=st.data(),
)
def test_any_losses_are_counted_exactly(first, steps, rate_error, data):
    """Also hours of them: the crystals differ by less than 120 SYNCs in the longest gap here."""
    sync = SyncCounter(PERIOD_NS)
    number = first
    offset = sync.advance(counter_of(number), round(number * PERIOD_NS)).tick - number
    for step in steps:
        number += step
        jitter = data.draw(st.integers(0, 3 * PERIOD_NS)) if step < 240 else 0
        elapsed_error = rate_error * step
        if abs(elapsed_error) > 11:
            return
        now = round(number * PERIOD_NS * (1 + 0) + elapsed_error * PERIOD_NS) + jitter
        made = sync.advance(counter_of(number), now)
        assert made == (number + offset, step - 1, False)


def test_late_delivery_is_no_loss():
    """A host that slept for half a second reads a hundred SYNCs at once."""
    sync = SyncCounter(PERIOD_NS)
    sync.advance(counter_of(0), 0)
    for number in range(1, 101):
        assert sync.advance(counter_of(number), 100 * PERIOD_NS).tick == number
    assert sync.advance(counter_of(101), 101 * PERIOD_NS) == (101, 0, False)


def test_a_producer_that_begins_anew_is_noticed():
    sync = SyncCounter(PERIOD_NS)
    for number in range(100):
        sync.advance(counter_of(number), number * PERIOD_NS)
    made = sync.advance(1, 130 * PERIOD_NS)  # it rebooted in 30 periods; going on, the counter would be 131
    assert made.restarted
    assert made.lost == 0
    assert made.tick > 99
    assert made.tick % 240 == 0
    assert sync.advance(2, 131 * PERIOD_NS) == (made.tick + 1, 0, False)


def test_a_repeated_sync_is_a_restart_and_not_a_round_lost():
    sync = SyncCounter(PERIOD_NS)
    sync.advance(7, 0)
    assert sync.advance(7, 1000).restarted


def test_a_producer_that_stood_still_is_told_from_a_host_that_read_late():
    sync = SyncCounter(PERIOD_NS)
    arrivals = [0, 1, 2, *range(22, 40), *[60] * 21, *range(61, 70)]  # 20 periods still; then 20 more read at once
    pauses = []
    for number, period in enumerate(arrivals):
        assert sync.advance(counter_of(number), period * PERIOD_NS) == (number, 0, False)
        pauses.append(sync.pause_ns)
    assert np.flatnonzero(pauses).tolist() == [4]
    assert pauses[4] == 19 * PERIOD_NS


def test_without_counter_host_time_decides():
    sync = SyncCounter(PERIOD_NS)
    sync.advance(0, 0)
    assert sync.advance(0, PERIOD_NS + 900_000) == (1, 0, False)
    assert sync.advance(0, 5 * PERIOD_NS) == (5, 3, False)
    assert sync.advance(0, 5 * PERIOD_NS + 10) == (6, 0, False)


@pytest.mark.parametrize("period_ms", [0.0, -5.0, float("nan")])
def test_a_period_that_is_none_is_refused(period_ms):
    with pytest.raises(ConfigurationError, match="period_ms"):
        SyncConfig(period_ms=period_ms)


class Number(ProcessData):
    """A TPDO that says which SYNC it answers."""

    def setup(self):
        yield from ()

    def decode(self, data):
        return Sample(int.from_bytes(data, "little"))


class Stream:
    """A synchronous channel fed by hand."""

    def __init__(self):
        self.report = Reporter("bus")
        self.sync = SyncCounter(PERIOD_NS)
        self.channel = SyncChannel(Number("n", 1, 0x281), self.report, self.sync)
        self.channel.go_live()
        self.batches = []

    def sync_at(self, number, host_ns=None):
        host_ns = number * PERIOD_NS if host_ns is None else host_ns
        before, before_ns = self.sync.tick, self.sync.host_ns
        tick = self.sync.advance(counter_of(number), host_ns).tick
        if before is not None:
            self.channel.close(before, before_ns, tick)

    def answer(self, number, delay_ns=300_000):
        self.channel.accept(number * PERIOD_NS + delay_ns, number.to_bytes(4, "little"))

    def end(self, now_ns=0):
        self.channel.finish(now_ns, self.sync.tick)
        self.take()
        return whole(self.batches, "n")

    def take(self):
        self.channel.hand_over()
        self.batches += self.report.take()


END = (b"no_pdo", 1)  # the last SYNC of a test, which nobody answers


def gaps(stream):
    return [(gap["cause"], int(gap["last_missing"] - gap["first_missing"]) + 1) for gap in of(stream.batches, "gap")]


@given(
    seen=st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=120),
    delay_ns=st.integers(100_000, 4_900_000),
)
def test_whatever_frames_are_lost_every_row_has_its_own_sync_and_gaps_add_up(seen, delay_ns):
    """SYNCs and answers lost in any pattern, kernel stamps: as the losses of an overrun socket buffer."""
    stream = Stream()
    stream.sync_at(0)
    answered = []
    syncs = [0]
    for number, (sync_arrives, answer_arrives) in enumerate(seen):
        if number and sync_arrives:
            stream.sync_at(number)
            syncs.append(number)
        if answer_arrives:
            stream.answer(number, delay_ns)
            answered.append(number)
    last = len(seen)
    stream.sync_at(last)
    rows = stream.end()
    assert rows["tick"].tolist() == rows["value_raw"].tolist() == answered if answered else not len(rows)
    if answered:
        covered = len(rows) + sum(
            int(gap["last_missing"]) - int(gap["first_missing"]) + 1 for gap in of(stream.batches, "gap")
        )
        assert covered == last - answered[0] + 1
        assert rows["sync_counter"].tolist() == [counter_of(number) for number in answered]


def test_causes_tell_a_lost_sync_from_a_missing_answer():
    stream = Stream()
    for number in range(20):
        if number not in {5, 15}:
            stream.sync_at(number)
        if number not in {5, 10}:
            stream.answer(number)
    stream.sync_at(20)
    rows = stream.end()
    assert rows["tick"].tolist() == [number for number in range(20) if number not in {5, 10}]
    gaps = of(stream.batches, "gap")
    assert [(int(gap["first_missing"]), gap["cause"], int(gap["duration_ns"])) for gap in gaps] == [
        (5, b"no_sync", PERIOD_NS),
        (10, b"no_pdo", PERIOD_NS),
        (20, b"no_pdo", PERIOD_NS),
    ]


def test_late_stamps_do_not_move_an_answer_where_no_sync_is_missing():
    stream = Stream()
    for number in range(4):
        stream.sync_at(number)
        stream.answer(number, delay_ns=23_000_000)
    stream.sync_at(4)
    assert stream.end()["tick"].tolist() == [0, 1, 2, 3]


def test_late_stamps_and_a_lost_sync_still_leave_each_answer_its_own():
    stream = Stream()
    stream.sync_at(0)
    stream.answer(0, delay_ns=6_000_000)
    stream.answer(1, delay_ns=6_000_000)
    stream.sync_at(2)
    stream.answer(2)
    stream.sync_at(3)
    assert stream.end()["tick"].tolist() == [0, 1, 2]


def test_an_answer_that_comes_twice_is_one_row_even_after_an_overdue_sync():
    stream = Stream()
    stream.sync_at(0)
    stream.answer(0)
    stream.channel.settle()
    stream.answer(0, delay_ns=400_000)
    stream.sync_at(1)
    stream.answer(1)
    stream.sync_at(2)
    rows = stream.end()
    assert rows["tick"].tolist() == [0, 1]
    assert codes(stream.batches) == ["pdo_extra"]
    assert gaps(stream) == [(b"pdo_extra", 1), END]


def test_more_answers_than_syncs_are_told_and_left():
    stream = Stream()
    for number in range(3):
        stream.sync_at(number)
        stream.answer(number)
        stream.answer(number, 400_000)
    stream.sync_at(3)
    rows = stream.end()
    assert rows["tick"].tolist() == [0, 1, 2]
    assert "pdo_extra" in codes(stream.batches)
    assert gaps(stream) == [*[(b"pdo_extra", 1)] * 3, END]


@pytest.mark.parametrize("slow_for", [50, 350])
def test_late_answers_to_syncs_named_as_unanswered_are_not_named_again(slow_for):
    """A node that is slow for a while: it answers each SYNC four SYNCs late, and then again in time."""
    stream = Stream()
    for number in range(slow_for + 20):
        stream.sync_at(number)
        if number < 4 or number >= slow_for:
            stream.answer(number)
        if 4 <= number - 4 < slow_for:
            stream.answer(number - 4, delay_ns=20_300_000)
    stream.sync_at(slow_for + 20)
    rows = stream.end()
    assert len(rows) == slow_for + 20 - 4
    assert gaps(stream) == [(b"no_pdo", 4), END]
    assert "pdo_extra" in codes(stream.batches)


@pytest.mark.parametrize("answers", [1, 2])
def test_of_two_syncs_at_a_restart_of_their_producer_each_has_an_answer_or_a_gap(answers):
    """The second comes before the first is answered; a node with one mailbox then sends one answer, another two."""
    stream = Stream()
    for number in range(10):
        stream.sync_at(number)
        if number < 9:
            stream.answer(number)
    host_ns = 9 * PERIOD_NS + 100_000
    before, before_ns = stream.sync.tick, stream.sync.host_ns
    step = stream.sync.advance(1, host_ns)
    assert step.restarted
    stream.channel.close(before, before_ns, before + 1)
    stream.channel.sync_restarted(host_ns, before, step.tick)
    for place in range(answers):
        stream.channel.accept(host_ns + 200_000 * (place + 1), (9).to_bytes(4, "little"))
    tick = stream.sync.advance(2, host_ns + PERIOD_NS).tick
    stream.channel.close(step.tick, host_ns, tick)
    rows = stream.end()
    assert len(rows) == 10
    assert gaps(stream) == [(b"no_pdo", 1), END]
