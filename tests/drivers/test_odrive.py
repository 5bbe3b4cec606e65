"""ODrive axes on CAN: messages of the published table, what is lost or repeated, silences, errors, any frames."""

import math
import struct

import numpy as np
import pytest
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, FrameError
from drivers.odrive import COUNTS, OdriveAxis, Odrives, decode_heartbeat, decode_pair
from drivers.ports import CanFrame
from drivers.records import SampleStatus
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, texts, whole

MS = 1_000_000
BAD, RESET = SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET
AXES = (
    OdriveAxis("knee", 3, -8 * COUNTS, velocity=True, torque=True),
    OdriveAxis("hip", 63, COUNTS),
)


def heartbeat(node=3, errors=0, state=8):
    return node << 5 | 1, struct.pack("<IBBBB", errors, state, 0, 1, 0)


def estimates(position, velocity=0.0, node=3):
    return node << 5 | 9, struct.pack("<ff", position, velocity)


def torques(estimate, node=3):
    return node << 5 | 0x1C, struct.pack("<ff", 99.0, estimate)


class Bus:
    """A CAN port in memory."""

    def __init__(self, clock):
        self.clock, self.waiting, self.broken, self.is_mute = clock, [], False, False

    def say(self, *frames):
        self.waiting += [CanFrame(self.clock(), identifier, data) for identifier, data in frames]

    def send(self, identifier, data):
        raise AssertionError("nothing is ever sent")

    def receive(self, timeout_s):
        if self.broken:
            raise OSError("network is down")
        frames, self.waiting = self.waiting, []
        return frames

    def mute(self):
        self.is_mute = True

    def close(self):
        pass


class Flight:
    """The driver, and axis 3 that sends both estimates every 10 ms and a heartbeat every 100."""

    def __init__(self, axes=AXES):
        self.clock = VirtualClock()
        self.bus = Bus(self.clock)
        self.device = Odrives(self.bus, axes, "odrives")
        self.batches = list(self.device.start(self.clock()))
        self.number, self.errors, self.state = 0, 0, 8

    def pump(self, after_ns=0, *frames):
        self.clock.advance(after_ns)
        self.bus.say(*frames)
        self.batches += self.device.pump(self.clock())

    def run(self, n):
        for _ in range(n):
            beat = [heartbeat(3, self.errors, self.state)] if self.number % 10 == 0 else []
            self.pump(10 * MS, *beat, estimates(0.5 + 1e-3 * self.number, 0.1), torques(-0.25))
            self.number += 1
        return self

    def pause(self, n):
        self.number += n
        for _ in range(n):
            self.pump(10 * MS)
        return self

    def stop(self):
        self.batches += self.device.stop(self.clock())
        return self


def test_messages_of_the_table_are_rows_of_the_joint():
    flight = Flight().run(20).stop()
    assert codes(flight.batches) == ["started", "stopped"]
    assert flight.bus.is_mute
    knee = whole(flight.batches, "knee")
    assert knee["value_raw"] * knee["scale"] == pytest.approx(
        -(0.5 + 1e-3 * np.arange(20)) * math.tau / 8.0, abs=4e-7
    )  # half a count
    assert (knee["tick"] == knee["host_ns"]).all()
    assert set(knee["device_status"]) == {8}
    speed, torque = whole(flight.batches, "knee_velocity"), whole(flight.batches, "knee_torque")
    assert speed["value_raw"] * speed["scale"] == pytest.approx([-0.1 * math.tau / 8.0] * 20, rel=1e-5)
    assert torque["value_raw"] * torque["scale"] == pytest.approx([2.0] * 20)  # 8 x 0.25, against the joint
    assert {(set(rows["unit"]).pop(), len(rows)) for rows in (knee, speed, torque)} == {
        (b"rad", 20),
        (b"rad/s", 20),
        (b"N m", 20),
    }
    assert not of(flight.batches, "hip").size


def test_lost_messages_are_counted_by_the_time_that_passed():
    flight = Flight().run(3).pause(4).run(2).stop()
    for channel in ("knee", "knee_torque"):
        assert whole(flight.batches, channel)["sequence"].tolist() == [0, 1, 2, 7, 8]
    assert set(of(flight.batches, "gap")["cause"]) == {b"messages_lost"}


def test_ticks_are_even_however_long_messages_wait():
    """Of 100 messages a third wait up to 6 ms; after a silence ticks begin anew at what arrives."""
    flight = Flight().run(1)
    waited = 0
    for k in range(1, 100):
        wait = 6 * MS * (k % 3 == 0) * (k % 7) // 6
        flight.pump(10 * MS + wait - waited, estimates(0.0))
        waited = wait
    rows = whole(flight.batches, "knee")
    assert set(np.diff(rows["tick"].astype(int))) == {10 * MS}
    assert np.ptp(rows["host_ns"] - rows["tick"]) == 6 * MS
    flight.pump(703 * MS, heartbeat(), estimates(0.0))
    after = whole(flight.batches, "knee")[-1]
    assert after["tick"] == after["host_ns"]


def test_messages_faster_than_stated_have_the_times_of_their_arrivals_and_it_is_told():
    flight = Flight()
    for _ in range(1100):
        flight.pump(9 * MS, estimates(0.0))
    rows = whole(flight.batches, "knee")
    assert (rows["tick"][1000:] == rows["host_ns"][1000:]).all()
    told, _ = texts(flight.batches, "rate")
    assert told.startswith("messages come at 111 Hz, not at 100: set rate_hz to that")


def test_what_a_host_that_stalls_reads_at_once_is_no_other_rate():
    flight = Flight()
    flight.pump(0, *[estimates(0.0)] * 40)  # of 0.4 s
    flight.run(100)
    assert set(np.diff(whole(flight.batches, "knee")["tick"].astype(int))) == {10 * MS}
    assert "rate" not in codes(flight.batches)


@pytest.mark.parametrize(("late_ms", "lost"), [(8.9, 0), (9.1, 1)])
def test_a_late_message_is_another_one_where_the_next_could_have_come(late_ms, lost):
    flight = Flight().run(3)
    flight.pump(round((10.0 + late_ms) * MS), estimates(1.0))
    flight.pump(round((10.0 - late_ms) * MS), estimates(1.0))
    assert whole(flight.batches, "knee")["sequence"].tolist() == [0, 1, 2, 3 + lost, 4 + lost]


@pytest.mark.parametrize("period_ms", [9.91, 10.09])
def test_an_axis_whose_crystal_is_off_loses_none(period_ms):
    flight, rng = Flight(), np.random.default_rng(3)
    late_ms = np.append(0.0, rng.exponential(0.5, 1000).clip(0, 7))
    for step_ms in period_ms + np.diff(late_ms):
        flight.pump(round(step_ms * MS), estimates(1.0))
    assert whole(flight.batches, "knee")["sequence"].tolist() == list(range(1000))


def test_frames_that_waited_while_nobody_read_are_not_lost_ones():
    flight = Flight().run(3)
    flight.clock.advance(50 * MS)
    flight.pump(0, *(estimates(1.0) for _ in range(5)))
    assert whole(flight.batches, "knee")["sequence"].tolist() == list(range(8))


def test_a_silent_axis_is_told_once_and_one_that_went_on_keeps_its_zero():
    flight = Flight().run(10).pause(120)
    assert codes(flight.batches) == ["started", "silent", "silent"]  # the knee, and the hip that was never heard
    flight.run(20).stop()
    assert codes(flight.batches)[3:] == ["recovered", "stopped"]
    status = whole(flight.batches, "knee")["status"]
    assert not status.any()  # the heartbeat came first
    assert "node 3 is not heard" in " ".join(texts(flight.batches, "silent"))


def test_estimates_before_the_first_heartbeat_after_a_silence_are_not_valid():
    flight = Flight().run(10).pause(63).run(20)
    status = whole(flight.batches, "knee")["status"].tolist()
    assert status[10:17] == [BAD] * 7
    assert not any(status[17:])


def test_an_axis_that_is_no_longer_driven_after_a_silence_has_started_again():
    flight = Flight().run(10).pause(60)
    flight.state = 1
    flight.run(20).stop()
    status = whole(flight.batches, "knee")["status"].tolist()
    assert status.count(RESET) == 1
    assert status[10] == RESET
    assert codes(flight.batches)[1:] == ["restarted", "axis_state", "stopped"]
    assert not whole(flight.batches, "knee_torque")["status"].any()


def test_one_that_is_let_go_while_it_is_heard_has_not_started_again():
    flight = Flight().run(10)
    flight.state = 1
    flight.run(20)
    flight.state = 8
    flight.run(20)
    assert codes(flight.batches)[1:] == ["axis_state"]  # once in a second, with the count of others
    assert not whole(flight.batches, "knee")["status"].any()


@pytest.mark.parametrize(
    ("errors", "named", "bad"), [(0x8, "missing estimate", 1), (0x1, "initializing", 1), (0x2000, "too hot", 0)]
)
def test_errors_are_told_by_name_and_spoil_the_estimates_that_they_are_of(errors, named, bad):
    flight = Flight().run(10)
    flight.errors = errors
    flight.run(10)
    flight.errors = 0
    flight.run(1)
    assert codes(flight.batches)[1:] == ["axis_error", "axis_normal"]
    assert named in texts(flight.batches, "axis_error")[0]
    assert whole(flight.batches, "knee")["status"].tolist() == [0] * 10 + [BAD * bad] * 10 + [0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_what_is_no_number_is_not_valid(value):
    flight = Flight().run(1)
    flight.pump(10 * MS, estimates(value, 1.0))
    assert of(flight.batches, "knee")["status"].tolist() == [0, BAD]
    assert of(flight.batches, "knee_velocity")["status"].tolist() == [0, 0]


@pytest.mark.parametrize("data", [b"", bytes(6), bytes(9)])
def test_a_message_of_another_length_is_refused(data):
    for decode in (decode_heartbeat, decode_pair):
        with pytest.raises(FrameError):
            decode(data)
    flight = Flight()
    flight.pump(MS, (3 << 5 | 9, data))
    assert codes(flight.batches) == ["bad_frame"]
    assert decode_heartbeat(bytes.fromhex("00200000080001")) == (0x2000, 8)
    assert decode_pair(struct.pack("<ff", 1.5, -2.0)) == (1.5, -2.0)


def test_other_nodes_and_commands_are_left_alone_and_error_frames_told():
    flight = Flight()
    flight.pump(MS, (4 << 5 | 9, bytes(8)), (3 << 5 | 0x17, bytes(8)), (3 << 5 | 3, b""))
    assert not flight.batches
    flight.bus.waiting.append(CanFrame(flight.clock(), 0x040, bytes(8), True))
    flight.pump()
    assert codes(flight.batches) == ["can_error_040"]


def test_a_bus_that_fails_is_tried_again():
    flight = Flight().run(3)
    flight.bus.broken = True
    flight.pump(10 * MS)
    assert flight.device.period_ns > 0
    flight.bus.broken = False
    flight.run(3).stop()
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered", "stopped"]
    assert whole(flight.batches, "knee")["sequence"].tolist() == [0, 1, 2, 4, 5, 6]


def test_a_stop_tells_what_is_missing_at_the_end():
    flight = Flight().run(3).pause(90).stop()
    assert set(of(flight.batches, "gap")["last_missing"]) == {3 + 90 - 1}


FRAMES = st.lists(
    st.builds(estimates, st.floats(width=32), st.floats(width=32), st.sampled_from([3, 63, 5]))
    | st.builds(torques, st.floats(width=32))
    | st.builds(heartbeat, st.sampled_from([3, 63]), st.integers(0, 2**32 - 1), st.integers(0, 255))
    | st.tuples(st.integers(0, 2047), st.binary(max_size=8)),
    max_size=6,
)


@pytest.mark.parametrize("axes", [(), (OdriveAxis("a", 1), OdriveAxis("b", 1))])
def test_nodes_are_different(axes):
    with pytest.raises(ConfigurationError, match="give the axes"):
        Flight(axes)
