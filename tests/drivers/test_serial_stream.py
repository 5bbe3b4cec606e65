"""The serial link under all serial drivers: opening, fresh stamps, back-off; and the counters they share."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import UrlError
from drivers.marks import MARK
from drivers.reporter import Reporter
from drivers.serial_line.device import SerialLink
from drivers.unwrap import steps
from tests.drivers.batches import codes, texts
from tests.drivers.serial_script import MS, ScriptedSerial

S = 1_000_000_000


class Bench:
    """A link on a scripted port."""

    def __init__(self, clock, open_port=None) -> None:
        self.port = ScriptedSerial()
        self.report = Reporter("x")
        self.link = SerialLink(open_port or self.port.open, clock, self.report)


@pytest.fixture
def bench(clock):
    bench = Bench(clock)
    assert bench.link.connect(0)
    return bench


def test_nothing_is_read_or_written_without_a_port(clock):
    link = Bench(clock).link
    assert not link.is_open
    assert link.read(0, 1) is None
    assert link.write(0, b"x") is None
    link.close()


def test_a_read_takes_all_that_waits_and_stamps_its_return(bench, clock):
    bench.port.say(b"abc")
    read = bench.port.read
    bench.port.read = lambda size: (clock.advance(3 * MS), read(size))[1]
    began = clock()
    assert bench.link.read(0, 1) == (b"abc", began + 3 * MS, True)
    assert bench.link.read(0, 1) is None  # nothing came


def test_nothing_is_asked_for_where_nothing_is_wanted(bench):
    bench.port.read = None
    assert bench.link.read(0, 0) is None


@pytest.mark.parametrize(("took_ms", "count", "fresh"), [(35, 4000, True), (36, 10, False), (0, 4001, False)])
def test_a_late_stamp_or_a_full_buffer_is_not_fresh(bench, clock, took_ms, count, fresh):
    bench.port.say(bytes(count))
    read = bench.port.read
    bench.port.read = lambda size: (clock.advance(took_ms * MS), read(size))[1]
    chunk = bench.link.read(0, 1)
    assert len(chunk.data) == count
    assert chunk.fresh is fresh


def test_a_write_is_stamped_before_it(bench, clock):
    write = bench.port.write
    bench.port.write = lambda data: (clock.advance(MS), write(data))[1]
    before = clock()
    assert bench.link.write(0, b"hi") == before
    assert bench.port.written == b"hi"
    bench.port.write = lambda data: None  # some ports do not say how many they took
    assert bench.link.write(0, b"hi") is not None


@pytest.mark.parametrize("act", ["read", "write"])
def test_a_fault_closes_the_port_and_it_is_opened_again_ever_more_slowly(bench, act):
    now_ns = 0
    opened = []
    bench.port.open = None
    for _ in range(100):
        bench.port.broken = True
        bench.link.read(now_ns, 1) if act == "read" else bench.link.write(now_ns, b"x")
        assert not bench.link.is_open
        bench.port.broken = False
        while not bench.link.connect(now_ns):
            now_ns += 10 * MS
        opened.append(now_ns)
    waits = np.diff([0, *opened])[:10] / MS
    assert waits.tolist() == [20, 40, 80, 160, 320, 640, 1000, 1000, 1000, 1000]
    batches = bench.report.take()
    assert codes(batches) == ["bus_error"]
    assert {"read": "cannot be read", "write": "cannot be written"}[act] in texts(batches, "bus_error")[0]
    bench.link.alive(now_ns)
    assert texts(bench.report.take(), "bus_recovered") == [f"answers again after {now_ns // MS} ms"]
    bench.link.alive(now_ns)
    assert bench.report.take() == []
    bench.port.broken = True
    bench.link.read(now_ns, 1)
    assert not bench.link.connect(now_ns + 19 * MS)  # the back-off begins anew too
    bench.port.broken = False
    assert bench.link.connect(now_ns + 20 * MS)


@pytest.mark.parametrize("error", [OSError(2, "No such file"), UrlError("no such rate: choose another")])
def test_a_port_that_cannot_be_opened_is_told(clock, error):
    def refuse():
        raise error

    bench = Bench(clock, refuse)
    assert not bench.link.connect(0)
    assert not bench.link.connect(19 * MS)
    assert not bench.link.connect(20 * MS)
    batches = bench.report.take()
    assert codes(batches) == ["bus_error"]
    assert "cannot be opened" in texts(batches, "bus_error")[0]


def test_another_kind_of_fault_is_told_too(bench):
    bench.link.drop(0, "silent", "nothing comes")
    bench.link.drop(0, "silent", "nothing came")
    bench.link.drop(0, "no_answer", "no answer")
    assert codes(bench.report.take()) == ["silent", "no_answer"]


def test_a_bug_is_not_taken_for_a_fault(bench):
    bench.port.read = lambda size: 1 // 0
    bench.port.say(b"x")
    with pytest.raises(ZeroDivisionError):
        bench.link.read(0, 1)


# What they share


@given(st.integers(2, 63), st.lists(st.integers(-(2**40), 2**40), max_size=30), st.integers(-(2**62), 2**62))
def test_steps_are_the_shorter_way_round(bits, moves, before):
    half = 2 ** (bits - 1)
    wanted = [(move + half) % (2 * half) - half for move in moves]
    words, value = [], before
    for move in wanted:
        value += move
        words.append(value % (2 * half))
    made = steps(np.array(words, np.uint64 if bits > 31 else np.uint32), bits, before)
    assert made.dtype == np.int64
    assert made.tolist() == wanted


def test_steps_of_signed_words():
    assert steps(np.array([-32768, 32767, 0], np.int16), 16, 32767).tolist() == [1, -1, -32767]


def test_mark_keeps_the_rules_of_the_records():
    assert MARK.names[:3] == ("sequence", "host_ns", "tick")
    assert MARK.isalignedstruct
    assert all(dtype.str[0] in "<|" for dtype, *_ in MARK.fields.values())
    assert MARK.itemsize == sum(dtype.itemsize for dtype, *_ in MARK.fields.values())
