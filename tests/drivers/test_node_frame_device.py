"""The node frame's device: rows and marks out of a node typed from docs/node_frame.md, and every way it goes wrong."""

import time

import numpy as np
import pytest

from drivers.marks import MARK
from drivers.node_frame import NodeFrame, NodeFrameConfig
from drivers.records import SCALAR, SampleStatus
from tests.drivers.batches import codes, of, whole
from tests.drivers.node_flight import ANGLE, CHANNELS, FORCE, Flight, S
from tests.drivers.node_model import NodeModel, framed
from tests.drivers.serial_script import MS, Pty, ScriptedSerial


@pytest.fixture
def flight(flight):
    flight.descend()
    return flight


def test_rows_carry_what_the_node_said(flight):
    flight.fly(1000)
    flight.stop()
    assert flight.device.channels == {"rig_force": SCALAR, "rig_angle": SCALAR, "rig_mark": MARK}
    force, angle = flight.rows(), flight.rows("rig_angle")
    assert len(force) == len(angle) == 1000
    np.testing.assert_array_equal(force["value_raw"], 3 * np.arange(1000) - 1000)
    np.testing.assert_array_equal(angle["value_raw"], 100 * np.arange(1000))  # unwrapped
    np.testing.assert_array_equal(force["tick"], 1_000_000 + 1000 * np.arange(1, 1001))
    assert set(force["scale"]) == {1e-4}
    assert set(force["unit"]) == {b"N"}
    assert set(angle["unit"]) == {b"rad"}
    assert set(force["status"]) == {0}
    assert np.all(force["host_ns"] - force["tick"].astype(np.int64) * 1000 < 10 * MS)
    assert codes(flight.batches) == ["described", "stopped"]
    assert of(flight.batches, "gap").size == 0
    assert flight.device.period_ns == 10 * MS


def test_frames_before_the_descriptor_wait_for_it(clock):
    flight = Flight(clock)
    flight.start()
    flight.fly(35)
    assert of(flight.batches, "rig_force").size == 0
    flight.descend()
    flight.fly(5)
    flight.pump()
    rows = flight.rows()
    np.testing.assert_array_equal(rows["value_raw"], 3 * np.arange(40) - 1000)
    np.testing.assert_array_equal(rows["tick"], 1_000_000 + 1000 * np.arange(1, 41))
    assert len(set(rows["host_ns"])) == 4  # stamped when they came, not when they were understood


def test_too_many_frames_without_a_descriptor_are_a_gap(clock):
    flight = Flight(clock)
    flight.start()
    flight.fly(5000)
    flight.descend()
    flight.fly(10)
    assert "no_descriptor" in codes(flight.batches)
    rows = flight.rows()
    assert len(rows) == 4096 + 10
    assert rows["sequence"][0] == 5000 - 4096
    assert rows["value_raw"][-1] == 3 * 5009 - 1000


def test_no_descriptor_at_all_is_told_at_the_end(clock):
    flight = Flight(clock)
    flight.start()
    flight.fly(100)
    flight.stop()
    assert "no_descriptor" in codes(flight.batches)
    assert of(flight.batches, "rig_force").size == 0


def test_lost_frames_are_gaps_of_exactly_those_frames(flight):
    lost = {0, 17, 18, 19, 500, 998}
    flight.fly(1000, lost - {0})
    rows = flight.rows()
    np.testing.assert_array_equal(rows["sequence"], [n for n in range(1000) if n not in lost - {0}])
    gaps = of(flight.batches, "gap")
    assert sorted(zip(gaps["first_missing"].tolist(), gaps["last_missing"].tolist(), strict=True)) == sorted(
        [(17, 19), (500, 500), (998, 998)] * 2
    )
    assert set(gaps["cause"]) == {b"frames_lost"}
    assert gaps["duration_ns"][0] == 3 * MS
    assert set(gaps["channel"]) == {b"rig_force", b"rig_angle"}


def test_a_spoiled_frame_is_told_and_named(flight):
    flight.fly(20)
    flight.clock.advance(MS)
    spoiled = bytearray(flight.frame())
    spoiled[7] ^= 1
    flight.port.say(bytes(spoiled))
    flight.fly(19)
    assert len(flight.rows()) == 39
    assert codes(flight.batches).count("bad_frame") == 1
    assert flight.device.bad_frames == 1


def test_status_bits_of_the_node_reach_the_rows(flight):
    for status in (0, 1, 2, 3, 0x80):
        flight.clock.advance(MS)
        flight.port.say(flight.frame(status=status))
    flight.pump()
    rows = flight.rows()
    assert rows["device_status"].tolist() == [0, 1, 2, 3, 0x80]
    invalid, saturated = SampleStatus.NOT_VALID, SampleStatus.SATURATED
    assert rows["status"].tolist() == [0, invalid, saturated, invalid | saturated, 0]


def test_a_counter_is_unwrapped_both_ways_and_begins_with_what_it_holds(clock):
    flight = Flight(
        clock, NodeModel([("count", "1", 4, 1, 1, 0), ("total", "1", 6, 1, 1, 0)]), channels=("count", "total")
    )
    flight.start()
    flight.descend()
    counts = [2**32 - 5, 2**32 - 1, 3, 2**31, 10, 2**32 - 2]
    for count in counts:
        flight.port.say(flight.node.data(flight.tick(), count, -(2**63) + count))
    flight.pump()
    values = flight.rows("rig_count")["value_raw"]
    assert values.tolist() == [2**32 - 5, 2**32 - 1, 2**32 + 3, 2**32 + 2**31, 2**32 + 10, 2**32 - 2]
    assert flight.rows("rig_total")["value_raw"].tolist() == [-(2**63) + count for count in counts]


STRANGERS = {
    "wrong_device": lambda f: NodeModel([FORCE]).descriptor(0),
    "other_node": lambda f: NodeModel(CHANNELS, node=9).data(0, 1, 2),
    "version": lambda f: framed(b"\x20\x01\0\0\0\0"),
    "bad_descriptor": lambda f: framed(b"\x11\x01\0\0\0\0"),
}


@pytest.mark.parametrize(("code", "frame"), STRANGERS.items(), ids=STRANGERS)
def test_a_stranger_is_told_and_makes_no_rows(flight, code, frame):
    flight.fly(20)
    flight.port.say(frame(flight))
    flight.fly(20)
    assert codes(flight.batches) == ["described", code]
    assert len(flight.rows()) == 40


def test_another_schema_is_taken_from_its_descriptor_on(flight):
    flight.fly(20)
    flight.node = NodeModel([("force", "N", 5, 0, 2, -4), ANGLE])
    flight.fly(10)
    flight.descend()
    flight.fly(10)
    rows = flight.rows()
    assert len(rows) == 40
    assert rows["scale"][[19, 20, 39]].tolist() == [1e-4, 2e-4, 2e-4]
    assert np.flatnonzero(rows["status"]).tolist() == [20]


def test_frames_of_a_schema_that_nobody_described_are_told(flight):
    flight.fly(20)
    flight.port.say(NodeModel([FORCE]).data(0, 1))
    flight.fly(20)
    flight.node = NodeModel(CHANNELS, boot=1)
    flight.descend()
    flight.fly(20)
    assert "unknown_schema" in codes(flight.batches)


@pytest.mark.parametrize("most", [1, 7, 100])
def test_it_does_not_matter_how_the_bytes_come(clock, flight, most):
    flight.fly(50)
    wanted = flight.rows()[["sequence", "tick", "value_raw"]]
    node, port = NodeModel(CHANNELS), ScriptedSerial()
    port.most = most
    device = NodeFrame("rig", port.open, clock, NodeFrameConfig(("force", "angle")))
    clock.now_ns = S
    batches = device.start(clock())
    port.say(node.descriptor(1_000_000))
    for number in range(50):
        port.say(node.data(1_000_000 + 1000 * (number + 1), *Flight.values(number)))
    while port.waiting:
        batches += device.pump(clock.advance(MS))
    np.testing.assert_array_equal(whole(batches, "rig_force")[["sequence", "tick", "value_raw"]], wanted)


def test_silence_reopens_the_port_and_the_end_of_it_is_told(flight):
    flight.fly(50)
    for _ in range(400):
        flight.pump()
    assert codes(flight.batches).count("silent") == 1
    assert flight.port.opened > 1
    flight.node.sequence += 4000
    flight.fly(50)
    assert codes(flight.batches)[-1] == "bus_recovered"
    assert flight.rows()["sequence"][-1] == 50 + 4000 + 50 - 1


def test_what_a_stop_finds_missing_is_named_once(flight):
    flight.fly(100)
    flight.clock.advance(S)
    flight.stop()
    assert of(flight.batches, "gap")["cause"].tolist() == [b"silent"] * 2
    assert flight.rows()["sequence"][-1] == 99
    flight.node.sequence += 1500
    flight.clock.advance(500 * MS)
    flight.start()
    flight.fly(100)
    rows = flight.rows()
    assert rows["sequence"][100] == 1600
    assert len(rows) == 200
    flight.fly(20, lost={5, 6})
    rows = flight.rows()
    assert rows["sequence"][-1] == 1600 + 119
    assert len(rows) == 218


def test_a_port_that_is_gone_is_told_once_and_opened_again(flight):
    flight.fly(100)
    flight.port.broken = True
    for _ in range(100):
        flight.pump(20 * MS)
    assert codes(flight.batches).count("bus_error") in {1, 2}  # read, then open
    flight.port.broken = False
    flight.node.sequence += 2000
    flight.pump(S)
    flight.fly(100)
    assert codes(flight.batches)[-1] == "bus_recovered"
    assert flight.rows()["sequence"][-1] == 2199


def test_it_works_on_a_pty():
    node = NodeModel(CHANNELS)
    pty = Pty(lambda _: b"")
    device = NodeFrame("rig", pty.open, time.monotonic_ns, NodeFrameConfig(("force", "angle"), poll_period_ms=0))
    batches = device.start(time.monotonic_ns())
    pty.say(node.descriptor(0) + b"".join(node.data(1000 * n, *Flight.values(n)) for n in range(100)))
    deadline = time.monotonic() + 5.0
    while of(batches, "rig_force").size < 100 and time.monotonic() < deadline:
        batches += device.pump(time.monotonic_ns(), 0.02)
    batches += device.stop(time.monotonic_ns())
    pty.close()
    assert whole(batches, "rig_force")["value_raw"].tolist() == [3 * n - 1000 for n in range(100)]
    assert codes(batches) == ["described", "stopped"]
