"""The node frame's device: its clock, its pulses, and a node that begins anew."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from tests.drivers.batches import codes, of
from tests.drivers.node_flight import CHANNELS, Flight, S
from tests.drivers.node_model import NodeModel
from tests.drivers.serial_script import MS


@pytest.fixture
def flight(flight):
    flight.descend()
    return flight


@pytest.mark.parametrize("tick_at_zero", [0, 2**32 - 1_030_000, 2**40 - 1_030_000, 2**61])
def test_the_clock_is_whole_across_the_turn_of_its_low_half(clock, tick_at_zero):
    flight = Flight(clock)
    flight.tick_at_zero = tick_at_zero
    flight.start()
    flight.descend()
    flight.fly(60)
    ticks = flight.rows()["tick"]
    assert int(ticks[0]) == tick_at_zero + 1_001_000
    assert set(np.diff(ticks)) == {1000}


@pytest.mark.parametrize("away_s", [10, pytest.param(3000, marks=pytest.mark.campaign), 4295])  # between the others
def test_an_outage_longer_than_a_turn_of_the_low_half_keeps_the_clock(flight, away_s):
    flight.fly(30)
    flight.node.sequence += 1000 * away_s
    flight.clock.advance(away_s * S)
    flight.fly(30)
    rows = flight.rows()
    assert rows["tick"][-1] == flight.tick()
    assert rows["sequence"][-1] == 59 + 1000 * away_s
    assert not (rows["status"] & SampleStatus.AFTER_RESET).any()


def test_every_pulse_is_one_mark_however_many_frames_tell_it(flight):
    edges = []
    for _ in range(5):
        flight.fly(37)
        flight.node.edge(flight.tick() - 4)
        edges.append(flight.tick() - 4)
    flight.fly(100)
    marks = of(flight.batches, "rig_mark")
    assert marks["tick"].tolist() == edges
    assert marks["pulse"].tolist() == [1, 2, 3, 4, 5]
    assert marks["sequence"].tolist() == [0, 1, 2, 3, 4]
    assert set(marks["value_raw"]) == {0}


def test_pulses_in_one_read_are_numbered(flight):
    for _ in range(3):
        flight.clock.advance(MS)
        flight.node.edge(flight.tick())
        flight.port.say(flight.frame())
    flight.pump()
    marks = of(flight.batches, "rig_mark")
    assert marks["sequence"].tolist() == [0, 1, 2]
    assert marks["pulse"].tolist() == [1, 2, 3]


def test_of_pulses_between_two_frames_the_last_is_told(flight):
    flight.fly(20)
    flight.node.edge(flight.tick())
    flight.node.edge(flight.tick() + 10)
    flight.fly(20)
    assert of(flight.batches, "rig_mark")["pulse"].tolist() == [2]


def test_a_pulse_before_the_low_half_turned_keeps_its_high_half(clock):
    flight = Flight(clock)
    flight.tick_at_zero = 2**33 - 1_000_000 - 2500
    flight.start()
    flight.descend()
    flight.fly(2)
    flight.node.edge(2**33 - 100)
    flight.clock.advance(10 * MS)
    flight.fly(10)
    assert of(flight.batches, "rig_mark")["tick"].tolist() == [2**33 - 100]


def restarted(flight, boot=0):
    """The node is off for two seconds, then begins anew."""
    flight.clock.advance(2 * S)
    flight.node = NodeModel(CHANNELS, boot=boot)
    flight.tick_at_zero = -(flight.clock() // 1000)


@pytest.mark.parametrize("boot", [0, 77])
@pytest.mark.parametrize("described", [True, False])
def test_a_node_that_began_anew_says_so_once(flight, boot, described):
    flight.node.edge(5)
    flight.fly(100)
    restarted(flight, boot)
    if described:
        flight.descend()
    flight.node.edge(7)
    flight.fly(50)
    flight.descend()
    flight.fly(50)
    rows = flight.rows()
    assert len(rows) == 200
    assert np.flatnonzero(rows["status"] & SampleStatus.AFTER_RESET).tolist() == (
        [100] if described or not boot else [100, 150]
    )
    assert int(rows["tick"][100]) == 1000
    assert rows["tick"][199] == 100_000
    assert "node_reset" in codes(flight.batches)
    np.testing.assert_array_equal(flight.rows("rig_angle")["value_raw"][100:], 100 * np.arange(100))
    assert of(flight.batches, "rig_mark")["tick"].tolist()[:2] == [5, 7]


def test_a_restart_that_only_the_descriptor_tells_is_seen(flight):
    flight.fly(100)
    restarted(flight)
    flight.descend()
    flight.node.sequence = 150  # none of the first ones comes through
    flight.fly(20)
    rows = flight.rows()
    assert np.flatnonzero(rows["status"]).tolist() == [100]
    assert rows["sequence"][100] == 250


def test_the_sequence_may_wrap(flight):
    flight.node.sequence = 2**32 - 50
    flight.fly(100)
    assert len(flight.rows()) == 100
    assert of(flight.batches, "gap").size == 0
    assert set(flight.rows()["status"]) == {0}


def test_frames_held_longer_than_a_turn_of_a_fast_clock_are_placed(clock):
    flight = Flight(clock, NodeModel(CHANNELS, tick_hz=10**9))
    flight.tick = lambda: flight.clock() + 2**50
    flight.start()
    for _ in range(100):
        flight.clock.advance(100 * MS)
        flight.pump(0, flight.frame())
    flight.descend()
    flight.fly(20)
    rows = flight.rows()
    assert rows["tick"][:100].tolist() == [S + 2**50 + n * 100 * MS for n in range(1, 101)]
    assert set(rows["status"]) == {0}


def test_what_was_held_at_a_stop_does_not_come_later(clock):
    flight = Flight(clock)
    flight.start()
    flight.fly(50)
    flight.stop()
    flight.start()
    flight.descend()
    flight.fly(20)
    assert len(flight.rows()) == 20


def test_frames_lost_after_a_restart_are_named(flight):
    flight.fly(100)
    restarted(flight)
    flight.node.sequence = 30
    flight.fly(20)
    rows = flight.rows()
    assert rows["sequence"][100] == 130
    (gap,) = of(flight.batches, "gap")[:1]
    assert gap["cause"] == b"node_reset"


def test_a_clock_that_jumps_is_told(flight):
    flight.fly(100)
    flight.tick_at_zero += 30_000_000
    flight.fly(100)
    rows = flight.rows()
    assert np.flatnonzero(rows["status"]).tolist() == [100]
    assert codes(flight.batches).count("clock_jump") == 1
    assert rows["tick"][-1] == flight.tick()
    flight.tick_at_zero -= 50_000
    flight.fly(100)
    assert np.flatnonzero(flight.rows()["status"]).tolist() == [100, 200]


def test_a_clock_that_jumps_within_a_read_is_told_at_its_frame(flight):
    flight.fly(100)
    for number in range(10):
        flight.clock.advance(MS)
        flight.tick_at_zero += 5_000_000 * (number == 4) - 20_000 * (number == 7)
        flight.port.say(flight.frame())
    flight.pump(0)
    assert np.flatnonzero(flight.rows()["status"]).tolist() == [104, 107]
    assert flight.rows()["tick"][-1] == flight.tick()
