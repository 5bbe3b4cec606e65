"""Drives that play the segments which the estimation process asks for, one after another, through its ring."""

import numpy as np
import pytest

from hil_sim.arm_rig import START_NS
from hil_sim.faults import Fault
from onboard.channels import REQUEST, Act
from onboard.config.segments import Library, to_bytes
from onboard.flight.acquire.arming import REQUESTS
from onboard.ring import RingWriter
from tests.flight.driven_bench import MS, Bench, closed_after, csv_of, swing

MISSION = '[mission]\nuntil = "mass 1 %"\nsegments = "segments.npz"'
POSTURE = np.array([0.0, 0.2])


def library(sizes=(0.3, -0.45), posture=POSTURE, joints=("j1", "j2")):
    time_s = np.linspace(0.0, 1.5, 151)
    rise = 0.5 * (1.0 - np.cos(2.0 * np.pi * time_s / 1.5))
    q = np.stack([posture + size * rise[:, None] * [1.0, 0.5] for size in sizes])
    k, one = len(sizes), np.zeros((len(sizes), 1))
    return Library(
        tuple(f"s{n}" for n in range(k)),
        joints,
        time_s,
        q,
        np.full(k, 151, np.int64),
        ("u",),
        np.ones(1),
        np.zeros((k, 1, 1, 1), np.float32),
        5.0,
        np.ones((k, 5, 1)),
        np.zeros((k, 7, 3, 0)),
        one,
        one,
        (("rate",),) * k,
        np.inf,
    )


class Asked(Bench):
    """A bench whose arm plays what a ring asks for."""

    def __init__(self, directory, segments=None, **said):
        (directory / "segments.npz").write_bytes(to_bytes(segments or library()))
        self.ring = RingWriter(directory / REQUESTS, REQUEST, 256)
        super().__init__(directory, drive=MISSION, csv=csv_of(*swing(0.8, (0.05, -0.04))), **said)

    def ask(self, name, act=Act.SEGMENT, late_ns=0):
        row = np.zeros(1, REQUEST)
        row["host_ns"], row["segment"], row["act"] = self.rig.now_ns - late_ns, name, act
        self.ring.push(row)


@pytest.fixture
def asked(tmp_path):
    yield from closed_after(tmp_path, Asked)


def test_segments_are_played_one_after_another_as_asked(asked):
    flown = asked()
    flown.run(3.8)
    assert flown.codes == ["drive_armed", "drive_started", "drive_done"]
    for name in ("s1", "s0"):
        flown.ask(name)
        flown.run(2.0)
    assert flown.codes[3:] == ["drive_started", "drive_done"] * 2
    assert flown.axis("shoulder").lowest_rad == pytest.approx(-0.45, abs=3e-3)
    assert flown.axis("elbow").highest_rad == pytest.approx(0.35, abs=3e-3)
    angle_rad = flown.axis("elbow").angle_rad(1e-9 * (flown.rig.now_ns - START_NS))
    assert angle_rad == pytest.approx(0.2, abs=2e-3)


def test_what_is_not_to_be_played_is_refused(asked):
    flown = asked()
    flown.run(3.8)
    flown.ask("s1", late_ns=3_000 * MS)
    flown.ask("nine")
    flown.ask("s1", act=Act.MET)
    flown.run(0.5)
    flown.ask("s0")
    flown.run(0.5)
    flown.ask("s1")  # while s0 is played
    flown.run(2.0)
    assert flown.axis("shoulder").lowest_rad > -0.01
    events = flown.kept.of("event")
    codes = [code.decode() for code in events["code"] if b"segment" in code]
    assert codes == ["segment_late", "segment_refused", "segment_refused"]
    assert "the player is playing" in events["text"][events["code"] == b"segment_refused"][1].decode()


@pytest.mark.parametrize(
    "fault",
    [
        Fault("silent", "sync_box", 5.8, 5.85),
        *(  # of a motion from a file: test_driving
            pytest.param(one, marks=pytest.mark.campaign)
            for one in (Fault("trip", "elbow", 5.8), Fault("silent", "elbow", 5.8, 5.85))
        ),
    ],
)
def test_what_stops_a_motion_stops_it_between_segments_too(asked, fault):
    flown = asked(faults=[fault])
    flown.run(3.8)
    flown.ask("s0")
    flown.run(3.0)
    assert "drive_stopped" in flown.codes
    flown.ask("s1")
    flown.run(2.0)
    assert flown.is_at_rest()
    assert flown.axis("shoulder").lowest_rad > -0.01


@pytest.mark.parametrize(
    ("made", "why"),
    [
        ({"sizes": (2.0,)}, "its range less the margin"),
        ({"posture": np.array([0.1, 0.2])}, "from where"),
        ({"joints": ("j1", "j3")}, "have to be the same"),
    ],
)
def test_segments_that_cannot_be_played_are_refused_as_a_whole(tmp_path, made, why):
    flown = Asked(tmp_path, segments=library(**made))
    try:
        flown.run(4.0)
        assert flown.codes == []
        assert why in b" ".join(flown.kept.of("event")["text"]).decode()
    finally:
        flown.close()
