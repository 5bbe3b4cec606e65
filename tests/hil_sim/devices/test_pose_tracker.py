"""The pose tracker's twin: its messages against the MAVLink guide's description, its times, its faults."""

import struct

import numpy as np
import pytest

from hil_sim.devices.serial_line.pose_tracker import PoseTrackerTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.drivers.pose_model import x25
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import START_NS, RateClock

LATENCY_NS = 5_000_000


class Cameras:
    """They see x = t, y = 2, z = 3 m, turned by t rad about z; noise that only moves z."""

    def __init__(self):
        self.count = 0

    def poses(self, times_s):
        ones = np.ones(len(times_s))
        half = 0.5 * times_s
        return np.column_stack([times_s, 2 * ones, 3 * ones, np.cos(half), 0 * ones, 0 * ones, np.sin(half)])

    def noisy(self, poses):
        out = poses.copy()
        out[:, 2] += 1e-3 * np.arange(self.count, self.count + len(poses))
        self.count += len(poses)
        return out


def tracker(*faults, **options):
    own = {"latency_ns": LATENCY_NS, "jitter_ns": 0, **options}
    given = FaultPlan(faults, START_NS).of("tracker")
    return PoseTrackerTwin(Cameras(), RateClock(own.pop("rate_error", 0.0)), START_NS, faults=given, **own)


def heard(line, ms):
    """Times in us since power-up, positions, quaternions and numbers of the messages received; their CRCs are right."""
    data, found = line.run(ms), []
    while data:
        size = data[1]
        message, data = data[: 12 + size], data[12 + size :]
        assert len(message) == 12 + size
        assert message[:4] == bytes([0xFD, size, 0, 0])
        assert int.from_bytes(message[7:10], "little") == 138
        assert struct.unpack("<H", message[-2:])[0] == x25(message[1:-2] + bytes([109]))
        content = struct.unpack("<Q28f", message[10:-2].ljust(120, b"\0"))
        assert np.isnan(content[8])
        found.append((content[0] - 1_790_000_000_000_000, content[5:8], content[1:5], message[4]))
    times, places, turns, numbers = zip(*found, strict=True)
    return np.array(times), np.array(places), np.array(turns), np.array(numbers)


def test_poses_are_sent_as_they_were_at_their_stamps():
    times, places, turns, numbers = heard(Line(tracker(rate_error=0.001)), 3000)
    assert len(times) == 300
    assert times.tolist() == [10_000 * n for n in range(300)]
    assert numbers.tolist() == [n % 256 for n in range(300)]
    assert places[:, 0] == pytest.approx(1e-6 * times / 1.001, abs=1e-6)
    assert turns[:, 3] == pytest.approx(np.sin(0.5e-6 * times / 1.001), abs=1e-6)
    assert (turns[:, 0] > 0.0).all()


def test_a_message_leaves_after_the_latency():
    line = Line(tracker())
    line.run(20)
    assert line.ends_ns[0] == START_NS + LATENCY_NS + round(1e10 / 230_400)


def test_jitter_only_delays():
    line = Line(tracker(jitter_ns=500_000, seed=3))
    line.run(2000)
    plain = Line(tracker())
    plain.run(2000)
    late = np.array(line.ends_ns[:1000]) - np.array(plain.ends_ns[:1000])
    assert late.min() >= 0
    assert late.max() > 500_000


def test_hidden_markers_send_nothing():
    twin = tracker(hidden=(2.0, 0.1), seed=5)
    times, places, _, numbers = heard(Line(twin), 10_000)
    gaps = np.diff(times) // 10_000 - 1
    assert 5 <= (gaps > 0).sum() <= 40
    assert 0.02 < gaps[gaps > 0].mean() * 0.01 < 0.3
    assert numbers.tolist() == [n % 256 for n in range(len(times))]
    assert places[:, 0] == pytest.approx(1e-6 * times, abs=1e-6)
    assert twin.produced - len(times) <= 1


def test_stuck_holds_a_pose_to_the_bit_and_time_goes_on():
    times, places, turns, _ = heard(Line(tracker(Fault("stuck", "tracker", 1.0, 2.0))), 3000)
    held = (times >= 1_000_000) & (times < 2_000_000)
    assert held.sum() == 100
    assert len(np.unique(np.hstack([places, turns])[held], axis=0)) == 1
    assert len(np.unique(places[~held], axis=0)) == 200


def test_wrong_is_a_scale_of_the_room_and_delayed_is_late():
    times, places, turns, _ = heard(Line(tracker(Fault("wrong", "tracker", 1.0, value=0.05))), 2000)
    assert places[:, 0] == pytest.approx(1e-6 * times * np.where(times < 1_000_000, 1.0, 1.05), abs=1e-6)
    assert turns[:, 3] == pytest.approx(np.sin(0.5e-6 * times), abs=1e-6)
    times, places, turns, _ = heard(Line(tracker(Fault("delayed", "tracker", 1.0, value=0.05))), 2000)
    seen = 1e-6 * times - np.where(times < 1_000_000, 0.0, 0.05)
    assert places[:, 0] == pytest.approx(seen, abs=1e-6)
    assert turns[:, 3] == pytest.approx(np.sin(0.5 * seen), abs=1e-6)


def test_axes_that_are_sent_for_each_other():
    times, places, _, _ = heard(Line(tracker(swapped=(0, 1))), 500)
    assert places[:, 1] == pytest.approx(1e-6 * times, abs=1e-6)
    assert places[:, 0] == pytest.approx(2.0)


def test_what_it_cannot_have():
    with pytest.raises(FaultError, match="cannot have the fault nack"):
        tracker(Fault("nack", "tracker", 1.0))
    with pytest.raises(ValueError, match="do not fit"):
        tracker(line=LineFormat(115_200))
