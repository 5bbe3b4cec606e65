"""The QSB driver when its adapter is reset, dies, does not answer, or its port is gone."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts
from tests.drivers.qsb_flight import Flight, S, model_counts


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
