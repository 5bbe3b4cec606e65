"""Servos that are driven, one of which answers anything: well-formed packets with other contents, and damaged ones."""

import random
from contextlib import closing

import pytest

from tests.flight.servo_bench import ServoBench

BEFORE, WITHIN = 0.0, 1.6  # s: before anything is armed, in mid-motion


def crafted(servo, kind, share, rng):
    """A servo of whose answers a share is crafted."""
    read, send = servo.read, servo._send

    def other(data):
        return rng.randbytes(len(data)) if kind == "contents" else changed(data)

    def changed(data):
        at = rng.randrange(max(len(data), 1))
        return data[:at] + rng.randbytes(1) + data[at + 1 :]

    def damaged(packet):
        at = rng.randrange(len(packet))
        return rng.choice([changed(packet), packet[:at], packet + packet[at:], rng.randbytes(at)])

    def is_meant():
        return rng.random() < share

    if kind == "error":
        own = {"_alert": property(lambda _: rng.randrange(1, 256) if is_meant() else 0)}  # the byte, of every answer
        servo.__class__ = type("Crafted", (type(servo),), own)
    elif kind == "packet":
        servo._send = lambda packet, now: send(damaged(packet) if is_meant() else packet, now)
    else:
        servo.read = lambda *asked: other(read(*asked)) if is_meant() else read(*asked)


@pytest.mark.parametrize(
    ("kind", "share", "begin_s"),
    [
        ("contents", 1.0, BEFORE),
        ("error", 0.2, BEFORE),
        ("packet", 1.0, WITHIN),
        *(
            pytest.param(*one, marks=pytest.mark.campaign)
            for one in (("byte", 1.0, BEFORE), ("error", 1.0, WITHIN), ("contents", 0.02, BEFORE))
        ),
    ],
)
def test_no_answer_raises_or_moves_an_arm_and_drives_stand_at_the_end(tmp_path, kind, share, begin_s):
    with closing(ServoBench(tmp_path)) as flown:
        flown.run(begin_s)
        crafted(flown.rig.drives["elbow"], kind, share, random.Random(0))
        flown.run(2.6 if begin_s == BEFORE else 1.5)  # the motion would be over
        if share == 1.0 and begin_s == BEFORE:
            assert "drive_started" not in flown.codes
            assert max(axis.fastest_rad_s for axis in flown.rig.axes.values()) < 0.05
        if share == 1.0 and begin_s == WITHIN:
            assert "drive_stopped" in flown.codes
            assert flown.is_at_rest()
        flown.stop()
        assert flown.is_at_rest()
        assert flown.codes.count("drive_started") <= 1
        assert flown.codes[-1:] != ["drive_started"]
