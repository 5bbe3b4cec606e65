"""The QSB driver against an adapter typed from the command list: setting up, streams, marks, faults."""

import time
from math import tau

import numpy as np
import pytest

from drivers.marks import MARK
from drivers.qsb import Qsb, QsbConfig
from drivers.records import SCALAR, SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.qsb_model import QsbModel
from tests.drivers.serial_script import MS, Pty, ScriptedSerial, SerialFlight, fault_at_any_call

S = 1_000_000_000


def turning(ns: int) -> int:
    """A joint at 1 count in 0.1 ms, from 1 s on."""
    return (ns - S) // 100_000


class Flight(SerialFlight):
    """An adapter that is read every 10 ms."""

    def __init__(self, clock, count=turning, tick_ns=1_953_125, **config) -> None:
        self.qsb = QsbModel(clock, count, tick_ns)
        port = ScriptedSerial(self.qsb.receive)
        super().__init__(clock, port, Qsb("joint", port.open, clock, QsbConfig(**config)))

    def fly(self, pumps: int, keep=lambda line: line):
        for _ in range(pumps):
            self.clock.advance(10 * MS)
            for line in self.qsb.due():
                self.port.say(keep(line))
            self.pump(0)

    def edge(self, high_ns=300_000):
        self.port.say(self.qsb.edge())
        self.clock.advance(high_ns)
        self.port.say(self.qsb.edge(rising=False))

    def rows(self):
        return whole(self.batches, "joint")


@pytest.fixture
def flight(clock):
    flight = Flight(clock)
    flight.start()
    return flight


def model_counts(flight, rows):
    """What the model counted at the ticks of the rows."""
    qsb = flight.qsb
    return np.array([qsb.encoder(qsb.zero_ns + int(tick) * qsb.tick_ns) - qsb.zero_count for tick in rows["tick"]])


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
    """A line has no checksum: of what its count may be, only what no joint does can be told."""
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


# Marks


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


# Faults


@pytest.mark.parametrize("greets", [True, False])
def test_an_adapter_that_was_reset_is_set_up_again(flight, greets):
    flight.fly(100)
    before = flight.rows()
    greeting = flight.qsb.power_up()
    if greets:
        flight.port.say(greeting)
    flight.fly(100)
    rows = flight.rows()
    places = np.flatnonzero(rows["status"])
    assert places.tolist() == [len(before)]
    assert rows["status"][places[0]] == SampleStatus.AFTER_RESET
    assert rows["tick"][places[0]] < 3
    assert abs(int(rows["value_raw"][places[0]])) < 10_000
    np.testing.assert_array_equal(rows["value_raw"][places[0] :], model_counts(flight, rows[places[0] :]))
    assert ("device_reset" if greets else "silent") in codes(flight.batches)
    gaps = of(flight.batches, "gap")
    assert gaps["cause"].tolist() == [b"device_reset" if greets else b"silent"][: len(gaps)]
    elapsed = (flight.clock() - before["host_ns"][-1]) / flight.qsb.tick_ns
    assert abs(rows["sequence"][-1] - before["sequence"][-1] - elapsed) < 0.05 * elapsed


def test_a_reset_right_after_the_start_is_one_too(flight):
    flight.fly(30)
    before = len(flight.rows())
    flight.port.say(flight.qsb.power_up())
    flight.fly(30)
    rows = flight.rows()
    assert np.flatnonzero(rows["status"]).tolist() == [before]
    assert rows["tick"][before] < 3


def test_an_adapter_that_only_lost_its_stream_goes_on_counting(flight):
    flight.fly(100)
    flight.qsb.streams.clear()
    flight.fly(100)
    rows = flight.rows()
    assert "W0D1" in flight.qsb.commands[:12]
    assert "W0D1" not in flight.qsb.commands[15:]
    assert set(rows["status"]) == {0}
    np.testing.assert_array_equal(rows["tick"], rows["sequence"])
    np.testing.assert_allclose(rows["value_raw"], model_counts(flight, rows), rtol=0, atol=20)  # S0E answers at once
    assert of(flight.batches, "gap")["cause"].tolist() == [b"silent"]


def test_a_timestamp_that_jumps_is_told(flight):
    flight.fly(100)
    flight.qsb.zero_ns -= 100 * S
    flight.qsb.line_tick = flight.qsb.tick
    flight.fly(50)
    rows = flight.rows()
    assert codes(flight.batches).count("clock_jump") == 1
    assert np.flatnonzero(rows["status"]).size == 1
    assert len(of(flight.batches, "gap")) == 0


@pytest.mark.parametrize("command", ["W161", "W15F", "R14", "W0303", "W02010", "R05", "S0E"])
def test_a_command_without_an_answer_is_tried_again(clock, command):
    flight = Flight(clock)
    flight.qsb.refuse[command] = b""
    flight.start()
    flight.fly(45)
    assert flight.qsb.commands.count(command) == 3
    flight.fly(20)
    assert "no_answer" in codes(flight.batches)
    assert command in texts(flight.batches, "no_answer")[0]
    del flight.qsb.refuse[command]
    flight.fly(100)
    assert codes(flight.batches)[-2:] == ["bus_recovered", "started"]
    assert len(flight.rows()) > 100


def test_an_echo_that_is_wrong_is_not_taken(clock):
    flight = Flight(clock)
    flight.qsb.refuse["W0303"] = b"w 03 0000004F 00000000 !\r\n"
    flight.start()
    flight.fly(70)
    assert "W0303 was echoed with 4F" in texts(flight.batches, "no_answer")[0]


@pytest.mark.parametrize(
    ("reply", "word"), [(b"e 03 00000003 00000000 !\r\n", "refuses"), (b"x 03 !\r\n", "does not know")]
)
def test_a_refused_command_is_told(clock, reply, word):
    flight = Flight(clock)
    flight.qsb.refuse["W0303"] = reply
    flight.start()
    flight.fly(100)
    (text,) = texts(flight.batches, "configuration")
    assert f"{word} W0303" in text
    assert flight.port.opened > 3
    assert of(flight.batches, "joint").size == 0


def test_complaints_nobody_asked_for_are_told(flight):
    flight.fly(10)
    flight.port.say(b"e 0E 00000005 00000123 !\r\n")
    flight.fly(1)
    flight.port.say(b"x 2A !\r\n")
    flight.fly(10)
    assert codes(flight.batches).count("complaint") == 1
    flight.stop()
    assert "1 more" in texts(flight.batches, "complaint")[-1]


def test_a_dead_adapter_is_told_and_found_again(flight):
    flight.fly(100)
    before = len(flight.rows())
    flight.qsb.streams.clear()
    flight.qsb.deaf = True
    flight.fly(500)
    assert "silent" in codes(flight.batches)
    assert codes(flight.batches).count("no_answer") == 1
    flight.qsb.deaf = False
    flight.qsb.power_up()
    flight.fly(300)
    assert codes(flight.batches)[-1] == "started"
    rows = flight.rows()
    assert rows["status"][before] == SampleStatus.AFTER_RESET


def test_a_port_that_is_gone_is_opened_again_and_the_adapter_set_up(flight):
    flight.fly(100)
    flight.port.broken = True
    flight.fly(200)
    assert 1 <= codes(flight.batches).count("bus_error") <= 2
    flight.port.broken = False
    flight.fly(200)
    rows = flight.rows()
    assert set(rows["status"]) == {0}  # it was powered all the time
    np.testing.assert_array_equal(rows["tick"], rows["sequence"])
    assert of(flight.batches, "gap")["cause"].tolist() == [b"port_lost"]


def test_what_a_stop_finds_missing_is_named_once(flight):
    flight.fly(100)
    flight.clock.advance(S)
    flight.stop()
    assert of(flight.batches, "gap")["cause"].tolist() == [b"silent"]
    assert flight.qsb.commands[-1] == "W161"
    assert flight.qsb.commands.count("W161") == 2
    flight.clock.advance(S)
    flight.start()
    flight.fly(50)
    rows = flight.rows()
    np.testing.assert_array_equal(rows["tick"], rows["sequence"])


def test_a_fault_at_any_call_is_survived(clock):
    for flight in fault_at_any_call(lambda: Flight(clock), lambda f: f.fly(30), lambda f: f.fly(15), 60):
        assert len(flight.rows()) > 120


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
    batches = device.start(time.monotonic_ns())
    deadline = time.monotonic() + 5.0
    edge = None
    while of(batches, "joint").size < 200 and time.monotonic() < deadline:
        pty.say(b"".join(qsb.due()))
        if edge is None and of(batches, "joint").size > 50:
            edge = qsb.edge()
            pty.say(edge)
        batches += device.pump(time.monotonic_ns(), 0.02)
    batches += device.stop(time.monotonic_ns())
    pty.close()
    rows = whole(batches, "joint")
    assert len(rows) >= 200
    assert set(np.diff(rows["value_raw"])) <= {0, 1, 2, 3}
    assert len(of(batches, "joint_mark")) == 1
    assert codes(batches) == ["identified", "started", "stopped"]
