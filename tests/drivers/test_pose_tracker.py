"""Poses of a motion capture bridge: messages of the MAVLink project's encoder, fed three ways; losses; held poses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, FrameError
from drivers.pose_tracker import PoseTracker, PoseTrackerConfig, decode_message, decode_pose, message_stream
from drivers.records import SampleStatus
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.pose_model import HEARTBEAT, SHORT, SIGNED, WHOLE, message, pose
from tests.drivers.serial_script import (
    MS,
    ScriptedSerial,
    SerialFlight,
    bytewise,
    fed,
    fuzzed,
    pieces,
)
from tests.drivers.serial_script import whole as at_once

GOOD, BAD = SampleStatus.OK, SampleStatus.NOT_VALID


def test_a_pose_of_the_projects_own_encoder():
    row = decode_pose(decode_message(WHOLE))[0]
    assert (int(row["tick"]), int(row["link_sequence"])) == (1_234_567_890_123, 41)
    assert row["quaternion"].tolist() == [0.5, -0.5, 0.5, 0.5]
    assert row["position_m"].tolist() == [1.25, -2.5, 0.375]
    assert row["covariance"] == pytest.approx(1e-6 * np.arange(1, 22), rel=1e-6)
    assert decode_message(WHOLE)[:4] == (41, 7, 198, 138)


@pytest.mark.parametrize("data", [SHORT, SIGNED])
def test_zeros_at_the_end_that_are_not_sent_and_a_signature(data):
    row = decode_pose(decode_message(data))[0]
    assert row["quaternion"].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert row["position_m"] == pytest.approx([1e-3, 2e-3, -3e-3])
    assert np.isnan(row["covariance"][0])
    assert not row["covariance"][1:].any()


def test_a_heartbeat_is_a_message_and_no_pose():
    heard = decode_message(HEARTBEAT)
    assert (heard.identifier, heard.sequence) == (0, 43)
    with pytest.raises(FrameError, match="no ATT_POS_MOCAP"):
        decode_pose(heard)


@pytest.mark.parametrize("at", range(len(SHORT)))
def test_a_flipped_bit_is_refused(at):
    spoiled = bytearray(SHORT)
    spoiled[at] ^= 0x10
    with pytest.raises(FrameError):
        decode_message(bytes(spoiled))
    with pytest.raises(FrameError):
        decode_message(SHORT[:at])


def test_what_the_receiver_must_know_and_does_not_is_refused():
    with pytest.raises(FrameError, match="incompatibility"):
        decode_message(message(bytes(8) + b"\1", flags=2))
    with pytest.raises(FrameError, match="message 30 is not known"):
        decode_message(message(b"\1", 30))
    with pytest.raises(FrameError, match="121 bytes is no ATT_POS_MOCAP"):
        decode_pose(decode_message(message(bytes(120) + b"\1")))
    with pytest.raises(ConfigurationError):
        PoseTrackerConfig(system=256)


FEEDS = {"whole": at_once, "bytewise": lambda _: bytewise(), "pieces": lambda _: pieces(7)}
JUNK = {
    "nothing": b"",
    "FD": b"\xfd",
    "half a message": WHOLE[50:],
    "MAVLink 1": b"\xfe" + WHOLE[1:],
    "zeros": bytes(200),
    "unknown": message(b"\1\2\3", 30),
}


@pytest.mark.parametrize("feed", FEEDS.values(), ids=FEEDS)
@pytest.mark.parametrize("junk", JUNK.values(), ids=JUNK)
def test_fed_any_way_the_same_comes_out(feed, junk):
    good = [WHOLE, HEARTBEAT, SIGNED, SHORT]
    data = b"".join(good) + junk + b"".join(good) * 3
    taken, errors = fed(message_stream(), data, feed(data))
    wanted = [decode_message(one) for one in good]
    assert taken[:4] == wanted
    assert taken[-8:] == wanted * 2
    assert bool(errors) is bool(junk)


@given(data=st.lists(st.binary(max_size=40) | st.sampled_from([WHOLE, SHORT, SIGNED, HEARTBEAT, b"\xfd"]), max_size=8))
def test_any_bytes_give_messages_or_frame_errors(data):
    stream = message_stream()
    taken = fed(stream, b"".join(data), pieces(3))[0]
    assert len(taken) <= sum(len(one) >= 12 for one in data) + sum(map(len, data)) // 12


def flight(config=None):
    clock, port = VirtualClock(), ScriptedSerial()
    made = SerialFlight(clock, port, PoseTracker("tracker", port.open, clock, config))
    made.start()
    return made


def flown(messages, config=None):
    made = flight(config)
    for one in messages:
        made.pump(said=one)
    made.stop()
    return made


def run(numbers, first_us=10_000):
    return [pose(n, first_us + 10_000 * n, 0.001 * n) for n in numbers]


def test_poses_are_rows():
    made = flown(run(range(300)))
    rows = whole(made.batches, "tracker")
    assert len(rows) == 300
    assert rows["tick"].tolist() == [10_000 + 10_000 * n for n in range(300)]
    assert rows["link_sequence"].tolist() == [n % 256 for n in range(300)]
    assert not rows["status"].any()
    assert codes(made.batches) == ["started", "stopped"]


def test_lost_messages_are_counted_by_their_numbers():
    made = flown(run([*range(20), *range(25, 40)]))
    assert len(whole(made.batches, "tracker")) == 35
    [gap] = of(made.batches, "gap")
    assert (gap["first_missing"], gap["last_missing"], gap["counted"]) == (20, 24, 1)
    assert gap["duration_ns"] == 60_000_000


def test_what_the_tracker_does_not_see_is_no_lost_message():
    seen = [pose(n, 10_000 * (n if n < 20 else n + 30), 0.001 * n) for n in range(40)]
    made = flown(seen)
    assert len(of(made.batches, "gap")) == 0
    assert of(made.batches, "tracker")["sequence"].tolist() == list(range(40))


def test_among_other_messages_losses_are_about():
    data = run(range(20))
    made = flown([*data, message(b"\1" * 9, 0, 20), message(b"\1" * 9, 0, 23), pose(26, 300_000, 1.0)])
    gaps = of(made.batches, "gap")
    assert [(g["first_missing"], g["last_missing"], g["counted"]) for g in gaps] == [(20, 21, 0), (22, 23, 0)]
    assert len(whole(made.batches, "tracker")) == 21


def test_a_sender_that_begins_again_loses_nothing():
    made = flown([*run(range(40)), *run(range(10), first_us=500_000), *run(range(5), first_us=1_000)])
    assert len(of(made.batches, "gap")) == 0
    rows = whole(made.batches, "tracker")
    assert (rows["status"] & SampleStatus.AFTER_RESET).nonzero()[0].tolist() == [50]


@pytest.mark.parametrize(
    "spoilt",
    [
        pose(10, 110_000, 0.009),  # as the one before
        pose(10, 110_000, 0.5, (0.9, 0.0, 0.0, 0.0)),
        pose(10, 110_000, float("nan")),
        pose(10, 110_000, 0.5, (float("inf"), 0.0, 0.0, 0.0)),
        pose(10, 100_000, 0.5),  # its time stands still
    ],
)
def test_a_pose_that_cannot_be_used_says_so(spoilt):
    made = flown([*run(range(10)), spoilt, *run(range(11, 15))])
    assert of(made.batches, "tracker")["status"].tolist() == [GOOD] * 10 + [BAD] + [GOOD] * 4
    assert codes(made.batches) == ["started", "not_tracked", "tracked", "stopped"]
    assert "uncover" in texts(made.batches, "not_tracked")[0]


def test_a_pose_of_no_time_is_a_bad_frame():
    made = flown([*run(range(10)), pose(10, 1 << 60), *run(range(11, 15))])
    assert len(whole(made.batches, "tracker")) == 14
    assert "no time" in texts(made.batches, "bad_frame")[0]


def test_only_the_sender_that_is_wanted_is_heard():
    mixed = [one for n in range(10) for one in (pose(n, 10_000 * n, 0.001 * n), message(b"\1" * 60, 138, 3 * n, 9))]
    made = flown(mixed, PoseTrackerConfig(system=1, component=196))
    assert len(whole(made.batches, "tracker")) == 10
    assert len(of(flown(mixed, PoseTrackerConfig(component=7)).batches, "tracker")) == 0


def fly(made):
    for one in run(range(12)):
        made.pump(said=one)


def fly_on(made):
    made.pump(2_000_000_000)
    for one in run(range(12, 60)):
        made.pump(said=one)


def flight_closed():
    clock, port = VirtualClock(), ScriptedSerial()
    return SerialFlight(clock, port, PoseTracker("tracker", port.open, clock))


MESSAGES = st.builds(
    message,
    st.binary(max_size=130),
    st.sampled_from([138, 138, 138, 0, 2, 111, 30]),
    st.integers(0, 255),
    st.sampled_from([1, 1, 2]),
    st.sampled_from([0, 0, 0, 1, 2]),
)
TIMES = st.sampled_from([0, MS, 10 * MS, 10 * MS, 600 * MS, 10_000 * MS])


@settings(max_examples=60)
@given(moves=st.lists(st.tuples(TIMES, MESSAGES | st.binary(max_size=50), st.integers(0, 40)), max_size=25))
def test_nothing_that_comes_in_can_raise_or_be_lost_in_silence(moves):
    clock, port = VirtualClock(), ScriptedSerial()
    flight = SerialFlight(clock, port, PoseTracker("x", port.open, clock))
    flight.start()
    fuzzed(flight, moves)
