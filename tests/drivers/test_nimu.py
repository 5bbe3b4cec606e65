"""The nIMU's packets, against packets typed from the data sheet, and its configuration.

The nIMU's timer: 16 bits that turn over, losses counted by it, restarts and standstill seen.
"""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.nimu import PacketStream, PacketTimer
from tests.drivers.nimu_model import PACKET, PERIOD, TICK_NS, WORDS, NimuModel
from tests.drivers.serial_script import MS, bytewise, fed, pieces
from tests.drivers.serial_script import whole as at_once

S = 1_000_000_000


class Timed:
    """A timer that is fed in reads; device time runs on the host's clock, ``late_ns`` late."""

    def __init__(self, period=PERIOD) -> None:
        self.timer, self.period, self.number = PacketTimer(), period, 0

    def read(self, numbers, late_ns=5 * MS, fresh=True, broken_at=()):
        """The packets of these numbers come in one read, ``late_ns`` after the last of them was made."""
        words = np.array([number * self.period % 65536 for number in numbers], np.uint16)
        broken = np.array([number in broken_at for number in numbers])
        host_ns = S + round(numbers[-1] * self.period * TICK_NS) + late_ns
        return self.timer.place(words, broken, host_ns, fresh)


def test_an_unbroken_stream_needs_no_host_time():
    timed = Timed()
    placed = timed.read(range(10), broken_at=(0,))
    assert placed.ticks.tolist() == [PERIOD * n for n in range(10)]
    assert placed.steps.tolist() == [1] * 10
    assert not placed.restarted.any()
    assert not placed.stuck.any()
    rng = np.random.default_rng(0)
    at = 10
    while at < 3000:
        count = int(rng.integers(1, 8))
        late_ns = int(rng.integers(0, 300 * MS))
        placed = timed.read(range(at, at + count), late_ns, fresh=bool(late_ns < 30 * MS))
        assert placed.ticks.tolist() == [PERIOD * n for n in range(at, at + count)]
        assert set(placed.steps) == {1}
        assert not placed.restarted.any()
        assert not placed.stuck.any()
        at += count
    assert timed.timer.period_ns == pytest.approx(PERIOD * TICK_NS)


@pytest.mark.parametrize("lost", [1, 2, 5, 10, 20, 21, 22])
@pytest.mark.parametrize("late_ns", [0, 30 * MS])
@pytest.mark.parametrize("told", [True, False], ids=["with junk", "clean"])
def test_a_loss_is_counted_by_the_timer(lost, late_ns, told):
    timed = Timed()
    timed.read(range(50))
    first = 50 + lost
    placed = timed.read(range(first, first + 4), late_ns, broken_at=(first,) if told else ())
    assert placed.steps.tolist() == [lost + 1, 1, 1, 1]
    assert int(placed.ticks[0]) == PERIOD * first
    assert not placed.restarted.any()


def test_a_loss_of_a_whole_number_of_turns_is_seen_by_the_host():
    timed = Timed()
    timed.read(range(50))
    placed = timed.read(range(50 + 64, 50 + 68))  # 64 periods are 3 turns to the tick
    assert placed.steps.tolist() == [65, 1, 1, 1]
    assert int(placed.ticks[0]) == PERIOD * 114
    assert placed.restarted.tolist() == [True, False, False, False]  # long enough to hide a restart


def test_a_loss_in_a_late_read_is_made_good_by_the_next():
    timed = Timed()
    timed.read(range(50))
    placed = timed.read(range(50 + 64, 50 + 68), fresh=False)
    assert placed.steps.tolist() == [1, 1, 1, 1]
    placed = timed.read(range(118, 120))
    assert int(placed.ticks[-1]) == PERIOD * 119
    assert placed.steps.tolist() == [65, 1]


def test_a_loss_before_the_period_is_known_is_one_packet_at_least():
    timed = Timed()
    timed.read(range(3))
    assert timed.timer.period_ns is None
    assert timed.read([6, 7], broken_at=(6,)).steps.tolist() == [2, 1]


def test_a_timer_that_began_anew_is_seen():
    timed = Timed()
    timed.read(range(50))
    words = (np.arange(5) * PERIOD + 20_000).astype(np.uint16)
    host_ns = S + round(60 * PERIOD * TICK_NS)
    placed = timed.timer.place(words, np.array([True] + [False] * 4), host_ns, True)
    assert placed.restarted.tolist() == [True, False, False, False, False]


def test_a_timer_that_stands_still_is_seen_and_makes_no_loss():
    timed = Timed()
    timed.read(range(50))
    stuck = np.full(200, 49 * PERIOD % 65536, np.uint16)
    for at in range(0, 200, 4):
        host_ns = S + round((50 + at) * PERIOD * TICK_NS)
        placed = timed.timer.place(stuck[at : at + 4], np.zeros(4, bool), host_ns, True)
        assert placed.stuck.all()
        assert set(placed.steps) == {1}
        assert not placed.restarted.any()


def test_a_first_read_without_junk_is_not_stuck():
    assert not Timed().read(range(3)).stuck.any()


def test_a_period_that_drifts_is_followed():
    timer, tick, rng = PacketTimer(), 0.0, np.random.default_rng(1)
    for read in range(3000):
        period = PERIOD * (1.0 + 0.5 * read / 3000)
        made = tick + period * np.arange(1, 4) + rng.uniform(-2, 2, 3)
        tick += 3 * period
        words = (made.round().astype(np.int64) % 65536).astype(np.uint16)
        placed = timer.place(words, np.zeros(3, bool), S + round(tick * TICK_NS), True)
        assert placed.steps.tolist() == [1, 1, 1]
        assert not placed.restarted.any()
    assert timer.period_ns == pytest.approx(1.5 * PERIOD * TICK_NS, rel=0.01)


@pytest.mark.parametrize("period", [1000, PERIOD, 9000, 20_000])
def test_the_period_is_learnt(period):
    timed = Timed(period)
    timed.read(range(20))
    placed = timed.read([23, 24], broken_at=(23,))
    assert placed.steps.tolist() == [4, 1]


def test_the_packet_of_the_data_sheet():
    assert len(PACKET) == 38
    assert sum(PACKET[:-1]) % 256 == PACKET[-1]
    (packets,), errors = fed(PacketStream(), PACKET, at_once(PACKET))
    assert packets.timer.tolist() == [0x1234]
    assert packets.words.tolist() == [WORDS]
    assert errors == []


@pytest.mark.parametrize("span", ["packet", "after_sync", "payload"])
def test_each_span_of_the_checksum(span):
    model = NimuModel(span)
    data = b"".join(model.packet() for _ in range(50))
    taken, errors = fed(PacketStream(span), data, at_once(data))
    assert sum(packets.timer.size for packets in taken) == 50
    assert errors == []
    for other in {"packet", "after_sync", "payload"} - {span}:
        taken, errors = fed(PacketStream(other), data, at_once(data))
        assert taken == []
        assert f"it is that of checksum_span = '{span}'" in errors[0]


@pytest.mark.parametrize("at", [*range(5), 6, *range(7, 38)])
def test_a_flipped_bit_is_refused(at):
    spoiled = bytearray(PACKET)
    spoiled[at] ^= 0x10
    data = PACKET + bytes(spoiled)
    (packets,), errors = fed(PacketStream(), data, at_once(data))
    assert packets.timer.size == 1
    assert errors


FEEDS = {"whole": at_once, "bytewise": lambda _: bytewise(), "pieces": lambda _: pieces(7)}
JUNK = {
    "nothing": b"",
    "FF": b"\xff",
    "FFFFFF": b"\xff" * 3,
    "half a packet": PACKET[11:],
    "a header too many": PACKET[:20],
    "zeros": bytes(50),
}


@pytest.mark.parametrize("feed", FEEDS.values(), ids=FEEDS)
@pytest.mark.parametrize("junk", JUNK.values(), ids=JUNK)
@pytest.mark.parametrize("after", [b"", PACKET[:37], b"\xff" * 4])
def test_fed_any_way_the_same_comes_out(feed, junk, after):
    model = NimuModel()
    run = [model.packet() for _ in range(100)]
    data = junk + b"".join(run[:60]) + junk + b"".join(run[60:]) + after
    taken, errors = fed(PacketStream(), data, feed(data))
    words = np.concatenate([packets.words for packets in taken])
    np.testing.assert_array_equal(words, [NimuModel().payload(n) for n in range(100)])
    assert bool(errors) == bool(junk)


def test_a_broken_stream_forgets_its_half_packet():
    stream = PacketStream()
    stream.receive(PACKET[:9])
    stream.clear()
    stream.receive(PACKET[9:] + PACKET)
    with pytest.raises(FrameError):
        stream.take()
    assert stream.take().words.tolist() == [WORDS]


@given(st.lists(st.binary(max_size=60) | st.sampled_from([PACKET, PACKET[:5], b"\xff" * 9, PACKET[5:]]), max_size=10))
def test_any_bytes_give_packets_nothing_or_frame_error(chunks):
    stream = PacketStream()
    for chunk in chunks:
        taken, _ = fed(stream, chunk, at_once(chunk))
        assert all(len(packets.timer) == len(packets.words) > 0 for packets in taken)
        assert len(stream.waiting) < 38


@given(st.binary(max_size=120))
def test_a_packet_after_any_junk_is_found(junk):
    taken, _ = fed(PacketStream(), junk + bytes(37) + 2 * PACKET, bytewise())
    assert taken[-1].words[-1].tolist() == WORDS


def test_a_stretch_full_of_headers_is_got_over_quickly():
    stream = PacketStream()
    data = PACKET[:5] * 4000 + PACKET
    before = time.process_time()
    taken, _ = fed(stream, data, at_once(data))
    assert taken[-1].words.tolist() == [WORDS]
    assert time.process_time() - before < 2.0
