"""Before drives are driven: drives that are not as they have to be, and motions that cannot be."""

import math
import struct

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from drivers.errors import ConfigurationError
from hil_sim.arm_rig import BUS, START_NS
from onboard import config
from onboard.config.driving import joint_ranges, read_motion, resampled
from tests.flight.driven_bench import COUNTS, MOTORS, MS, Bench, closed_after, csv_of, swing, urdf, written


@pytest.fixture
def bench(tmp_path):
    yield from closed_after(tmp_path, Bench)


def never_enables(drive):
    controlword = drive.dictionary.find(0x6040, 0)
    command = controlword.changed
    controlword.changed = lambda word, now: command(word & ~0x08, now)


def keeps_its_mode(drive):
    entry = drive.dictionary.find(0x6061, 0)
    entry.read = lambda _: 1


def keeps_its_limits(drive):
    entry = drive.dictionary.find(0x607D, 1)
    entry.changed = lambda value, now: setattr(entry, "value", 0)


def has_no_quick_stop(drive):
    drive.dictionary.remove(0x605A, 0)


def in_fault(drive):
    drive._at("fault", START_NS + 150 * MS, lambda now: drive.trip(0x2310, now))


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (never_enables, "drive_stopped", "not enabled within 3 s, statuswords: elbow 0"),
        (keeps_its_mode, "drive_stopped", "elbow is in mode 1, not 8"),
        (keeps_its_limits, "configuration", "607Dh:01 was written"),
        pytest.param(
            has_no_quick_stop, "configuration", "605Ah", marks=pytest.mark.campaign
        ),  # an abort: test_canopen_frame
        (in_fault, "drive_refused", "elbow "),
    ],
)
def test_drives_that_are_not_as_they_have_to_be(bench, change, code, said):
    flown = bench(change={"elbow": change}).run(11.5 if code == "configuration" else 5.0)
    assert said in flown.text(code)
    assert flown.axis("shoulder").highest_rad - flown.axis("shoulder").lowest_rad < 0.02
    if code == "configuration":
        assert "not ready: elbow" in flown.text("drive_refused")


def test_other_counts_than_the_drives_are_refused(bench):
    wrong = (MOTORS[0], MOTORS[1]._replace(counts=40_000))
    flown = bench(motors=wrong).run(1.0)
    assert "counts_per_revolution = 20000, the drive says 40000" in flown.text("configuration")
    assert flown.axis("elbow").highest_rad == flown.axis("elbow").lowest_rad


def test_an_arm_that_stands_elsewhere_is_not_moved(bench):
    away = (MOTORS[0]._replace(angle_rad=0.3), MOTORS[1])
    flown = bench(motors=away).run(2.0)
    assert flown.codes == ["drive_refused"]
    assert "shoulder stands 17.19 deg from where the motion starts" in flown.text("drive_refused")


def test_way_points_of_a_profile(bench):
    time_s, q = swing(rows=9)
    flown = bench(drive='mode = "profile"', csv=csv_of(time_s, q)).run(5.0)
    assert flown.codes == ["drive_armed", "drive_started", "drive_done"]
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=0.02)
    assert flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"csv": csv_of(*swing()).replace("0.2\n", "nan\n", 1)}, "finite"),
        ({"csv": csv_of(*swing()).replace(",0.2\n", ",\n", 1)}, "could not convert"),
        ({"csv": csv_of(*swing(), head="time_s,j1,wrist")}, "lacks j2 and has wrist, which nothing drives"),
        ({"csv": csv_of(*swing(seconds=1.5))}, "its largest rate"),  # 1.05 of 1 rad/s
        ({"csv": csv_of(*swing(size=(1.2, 0.0), seconds=6.0))}, "its range less the margin"),
        ({"csv": csv_of(*(part[:26] for part in swing(seconds=4.0)))}, "begins and ends at rest"),
        ({"csv": csv_of(swing()[0][::-1], swing()[1])}, "time_s has to rise"),
        ({"csv": "time_s,j1,j2\n0,0,0\n"}, "4 rows"),
        ({"low": 1.0, "high": -1.0}, "lower below upper"),
        ({"speed": 0.0}, "no largest rate"),
        ({"drive": "margin_rad = 1.0"}, "leaves 'j1' no range"),
        ({"drive": "acceleration_rad_s2 = 0.5"}, "acceleration_rad_s2"),
        ({"drive": "master_node = 2"}, "master node 2"),
        ({"drive": 'mode = "profile"'}, "0.2 s apart"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(tmp_path, said, why):
    with pytest.raises((config.ConfigError, ConfigurationError), match=why):
        config.load(written(tmp_path, **said)).model_copy(update={"arm": True}).play(BUS)


def test_a_flight_with_such_a_motion_says_so_and_moves_nothing(bench):
    flown = bench(csv="time_s,j1,j2\n0,0,0\n").run(1.0)
    assert "4 rows" in flown.text("bus_failed")
    assert all(not drive.uploads for drive in flown.rig.drives.values())


def test_a_motion_at_another_rate_is_put_on_the_sync(tmp_path):
    time_s, q = swing(rows=33)
    (tmp_path / "m.csv").write_text(csv_of(time_s + 16.0, q))
    read_s, read = read_motion(tmp_path / "m.csv", ["j1", "j2"])
    at_s, on_sync = resampled(read_s, read, 0.005)
    assert len(at_s) == 401
    wanted = np.stack([0.25 * (1 - np.cos(np.pi * at_s)), 0.2 - 0.2 * (1 - np.cos(np.pi * at_s))], 1)
    assert np.abs(on_sync - wanted).max() < 1e-5
    assert np.abs(on_sync - CubicSpline(time_s, read, bc_type="clamped")(at_s)).max() < 1e-12
    assert (on_sync[[0, -1]] == read[[0, -1]]).all()


def test_software_limits_are_the_urdfs_less_the_margin_whichever_way_it_counts(bench):
    flown = bench().run(0.6)
    for name, sense, zero, counts in (("shoulder", 1, 0, COUNTS), ("elbow", -1, 777, 20_000)):
        drive = flown.rig.drives[name]
        ends = sorted(zero + round(sense * end * counts / math.tau) for end in (-0.95, 0.95))
        assert [drive.dictionary.find(0x607D, sub).value for sub in (1, 2)] == ends
    targets = [row for row in flown.kept.of("elbow_sent") if row["cob_id"] == 0x302]
    first = struct.unpack("<i", bytes(targets[0]["data"][:4]))[0]
    assert first == pytest.approx(777 - 0.2 * 20_000 / math.tau, abs=1)


def test_ranges_of_a_urdf():
    assert joint_ranges(urdf(-0.5, 0.7, 2.0))["j2"] == (-0.5, 0.7, 2.0)
    with pytest.raises(config.ConfigError, match="limits of the URDF"):
        joint_ranges("<robot>")
