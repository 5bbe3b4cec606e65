"""The QSB driver against an adapter typed from the command list: setting up, streams, marks, faults."""

import time
from math import tau

import numpy as np
import pytest

from drivers.marks import MARK
from drivers.qsb import Qsb, QsbConfig
from drivers.records import SCALAR, SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.qsb_flight import Flight, S, model_counts
from tests.drivers.qsb_model import QsbModel
from tests.drivers.serial_script import MS, Pty, run_for


def test_it_is_set_up_with_the_manuals_commands_and_streams(flight):
    assert flight.qsb.commands == [
        *("W161", "W15F", "R14", "W000", "W0303", "W04000", "W0B0", "W0C1", "W0D1", "W02010"),
        *("R05", "R01", "S05", "S01", "S0E"),
    ]
    flight.fly(100)
    rows = flight.rows()
    assert len(rows) == 512 + 1
    np.testing.assert_array_equal(rows["tick"], np.arange(513))
    np.testing.assert_array_equal(rows["value_raw"], model_counts(flight, rows))
    assert rows["scale"][0] == tau / 500_000
    assert rows["unit"][0] == b"rad"
    assert set(rows["status"]) == {0}
    assert flight.device.channels == {"joint": SCALAR, "joint_mark": MARK}
    assert codes(flight.batches) == ["identified", "started"]
    assert texts(flight.batches, "identified") == ["QSB-D, serial number 74565, firmware 0x0e"]
    flight.stop()
    assert flight.qsb.commands[-1] == "W161"
    assert not flight.qsb.streams
    assert len(flight.rows()) == 513
    assert of(flight.batches, "gap").size == 0


@pytest.mark.parametrize(
    ("version", "text"),
    [
        (0xABCDE10A, "QSB-M, serial number 703710, firmware 0x0a"),
        (0x212, "QSB-S, serial number 0, firmware 0x12"),
        (0x300, "unknown model, serial number 0, firmware 0x00"),
    ],
)
def test_it_says_who_it_is(clock, version, text):
    flight = Flight(clock)
    flight.qsb.registers[0x14] = version
    flight.start()
    assert texts(flight.batches, "identified") == [text]


def test_streams_that_do_not_acknowledge_are_waited_for_a_little(clock):
    flight = Flight(clock)
    flight.qsb.acknowledges_streams = False
    flight.start()
    flight.fly(30)
    assert codes(flight.batches) == ["identified", "started"]
    assert len(flight.rows()) > 80
    assert flight.rows()["host_ns"][0] - S <= 120 * MS


def test_what_a_former_run_left_streaming_does_not_disturb(clock):
    flight = Flight(clock)
    flight.qsb.registers |= {0x0C: 1, 0x15: 0x5}
    flight.qsb.streams = [0x0E]
    flight.port.waiting += b"".join(flight.qsb.line("s", 0x0E, n) for n in range(9))[5:]
    flight.start()
    flight.fly(50)
    assert len(flight.rows()) > 200
    assert "bad_frame" not in codes(flight.batches)


def test_an_adapter_that_opening_resets_is_waited_for(clock):
    flight = Flight(clock)
    flight.qsb.deaf = True  # it boots; what is sent now is lost
    flight.start()
    flight.fly(5)
    flight.qsb.deaf = False
    flight.port.say(b"\xf8" + flight.qsb.power_up())
    flight.fly(20)
    assert flight.qsb.commands[:3] == ["W161", "W15F", "R14"]
    assert codes(flight.batches) == ["identified", "started"]
    assert len(flight.rows()) > 80


@pytest.mark.parametrize(("counting", "shift"), [(1, 2), (2, 1), (4, 0)])
def test_counting_and_direction(clock, counting, shift):
    flight = Flight(clock, counting=counting, count_down=True)
    flight.start()
    flight.fly(50)
    rows = flight.rows()
    np.testing.assert_array_equal(rows["value_raw"], -(model_counts(flight, rows) >> shift))
    assert rows["value_raw"][-1] < -1000 >> shift


def test_the_count_is_unwrapped_over_its_32_bits(clock):
    flight = Flight(clock, lambda ns: (ns - S) // 5)  # 0.8 revolutions from line to line
    flight.start()
    flight.fly(1200)
    rows = flight.rows()
    assert rows["value_raw"][-1] > 2**31
    assert not rows["status"].any()
    np.testing.assert_array_equal(rows["value_raw"], model_counts(flight, rows))


def test_the_timestamp_is_unwrapped_over_its_32_bits(flight):
    flight.qsb.zero_ns = flight.clock() - (2**32 - 200) * flight.qsb.tick_ns
    flight.qsb.line_tick = flight.qsb.tick
    flight.fly(100)
    rows = flight.rows()
    assert rows["tick"][-1] > 2**32
    assert set(np.diff(rows["tick"][2:])) == {1}


@pytest.mark.parametrize("interval", [1, 2, 8])
@pytest.mark.parametrize("tick_ns", [1_900_000, 1_953_125])
def test_lost_lines_are_gaps_of_exactly_those_lines(clock, interval, tick_ns):
    flight = Flight(clock, tick_ns=tick_ns, interval_ticks=interval)
    flight.start()
    numbers = iter(range(10**6))
    lost = {5, 6, 7, 20}
    flight.fly(200, lambda line: b"" if next(numbers) in lost else line)
    rows = flight.rows()
    gaps = of(flight.batches, "gap")
    assert list(zip(gaps["first_missing"].tolist(), gaps["last_missing"].tolist(), strict=True)) == [(6, 8), (21, 21)]
    assert set(gaps["cause"]) == {b"lines_lost"}
    assert abs(gaps["duration_ns"][0] / (3 * interval * tick_ns) - 1) < 0.02
    np.testing.assert_array_equal(rows["tick"], interval * rows["sequence"])


def test_jitter_of_the_tick_is_no_loss_where_it_is_allowed(clock):
    flight = Flight(clock, tick_jitter=1)
    flight.start()
    line = flight.qsb.line
    flight.clock.advance(20 * MS)
    flight.port.say(b"".join(line("s", 0x0E, n, n) for n in (1, 3, 3, 4, 6, 7, 11)))
    flight.pump(0)
    assert of(flight.batches, "gap")[["first_missing", "last_missing"]].tolist() == [(7, 9)]


def test_a_spoiled_line_is_told_and_named(flight):
    numbers = iter(range(10**6))
    flight.fly(20, lambda line: line[:7] + line[8:] if next(numbers) == 40 else line)
    rows = flight.rows()
    assert codes(flight.batches).count("bad_frame") == 1
    assert flight.device.bad_frames == 1
    np.testing.assert_array_equal(rows["tick"], rows["sequence"])
    assert 41 not in rows["sequence"]


def test_a_digit_that_turned_into_another_is_not_valid_and_leaves_no_turn_behind(flight):
    """A line has no checksum: a wrong count is recognised only where no joint can move so."""
    numbers = iter(range(10**6))
    spoiled = {40, 41, 55, 90}
    flight.fly(20, lambda line: line[:5] + b"7" + line[6:] if next(numbers) in spoiled else line)
    rows = flight.rows()
    bad = rows["status"] == SampleStatus.NOT_VALID
    assert rows["sequence"][bad].tolist() == [number + 1 for number in sorted(spoiled)]
    assert not rows["status"][~bad].any()
    np.testing.assert_array_equal(rows["value_raw"][~bad], model_counts(flight, rows)[~bad])


def test_a_joint_turned_while_nobody_looked_is_believed_when_it_stays(clock):
    flight = Flight(clock, lambda ns: 0 if ns < 2 * S else 3_000_000)
    flight.start()
    flight.fly(150)
    rows = flight.rows()
    assert np.flatnonzero(rows["status"] == SampleStatus.NOT_VALID).size == 19
    assert rows["value_raw"][-1] == 3_000_000
    assert rows["status"][-1] == SampleStatus.OK


def test_an_edge_is_a_mark_with_the_latched_count(flight):
    edges = []
    for _ in range(8):
        flight.fly(20)
        flight.clock.advance(3 * MS)
        edges.append((flight.qsb.tick, flight.qsb.counter()))
        flight.edge()
    flight.fly(20)
    marks = of(flight.batches, "joint_mark")
    assert marks["tick"].tolist() == [tick for tick, _ in edges]
    assert marks["value_raw"].tolist() == [count for _, count in edges]
    assert marks["sequence"].tolist() == list(range(8))
    assert set(marks["pulse"]) == {0}


def test_an_adapter_that_marks_edges_rests_and_loses_nothing(flight):
    assert flight.device.rests_until(flight.clock()) == flight.clock(), "by arrivals alone each poll counts"
    for _ in range(40):
        flight.fly(2)
        flight.edge()
    flight.fly(2)
    for _ in range(30):
        rest_ns = flight.device.rests_until(flight.clock()) - flight.clock()
        assert rest_ns == 100 * MS
        flight.clock.advance(rest_ns - 10 * MS)
        flight.fly(1)
    flight.stop()
    assert flight.device.rests_until(flight.clock()) == flight.clock()
    rows = flight.rows()
    assert len(rows) > 400
    np.testing.assert_array_equal(rows["value_raw"], model_counts(flight, rows))
    assert len(of(flight.batches, "gap")) == 0


def test_a_joint_at_rest_makes_marks_too(clock):
    flight = Flight(clock, lambda ns: 77 if ns > S else 0)
    flight.start()
    for _ in range(3):
        flight.fly(20)
        flight.edge()
    flight.fly(5)
    marks = of(flight.batches, "joint_mark")
    assert marks["value_raw"].tolist() == [77, 77, 77]


def test_a_mark_waits_for_no_more_than_its_lines(flight):
    flight.fly(20)
    flight.edge()
    flight.stop()
    assert len(of(flight.batches, "joint_mark")) == 1


def test_the_falling_edge_where_it_is_told_to(clock):
    flight = Flight(clock, sync_edge="falling")
    flight.start()
    flight.fly(10)
    flight.port.say(flight.qsb.edge())
    flight.clock.advance(50 * MS)
    tick = flight.qsb.tick
    flight.port.say(flight.qsb.edge(rising=False))
    flight.fly(10)
    assert of(flight.batches, "joint_mark")["tick"].tolist() == [tick]


def test_without_a_sync_line_there_are_no_marks(clock):
    flight = Flight(clock, sync_edge=None)
    flight.start()
    assert "S05" not in flight.qsb.commands
    flight.fly(10)
    flight.edge()
    flight.fly(10)
    assert of(flight.batches, "joint_mark").size == 0


@pytest.mark.parametrize("most", [13, 26, 40])
def test_bytes_in_any_pieces_make_the_same_rows(clock, most):
    flight = Flight(clock)
    flight.port.most = most
    flight.start()
    flight.fly(100)
    for _ in range(1000):
        flight.pump(0)
    rows = flight.rows()
    assert len(rows) > 100
    assert set(np.diff(rows["tick"])) == {1}
    np.testing.assert_allclose(rows["value_raw"], model_counts(flight, rows), rtol=0, atol=20)  # S0E answers at once
    assert "bad_frame" not in codes(flight.batches)


def test_it_works_on_a_pty():
    qsb = QsbModel(time.monotonic_ns, lambda ns: ns // 1_000_000)
    pty = Pty(qsb.receive)
    device = Qsb("joint", lambda: pty.open(230_400), time.monotonic_ns, QsbConfig(poll_period_ms=0))
    edges = []

    def say(batches):
        pty.say(b"".join(qsb.due()))
        if not edges and of(batches, "joint").size > 50:
            edges.append(qsb.edge())
            pty.say(edges[0])

    batches = run_for(device, "joint", 200, say, timeout_s=0.02)
    pty.close()
    rows = whole(batches, "joint")
    assert len(rows) >= 200
    assert set(np.diff(rows["value_raw"])) <= {0, 1, 2, 3}
    assert len(of(batches, "joint_mark")) == 1
    assert codes(batches) == ["identified", "started", "stopped"]
