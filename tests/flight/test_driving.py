"""Drives that are driven: a motion through the acquisition worker, on simulated servo drives, in virtual time.

The drives are ``hil_sim``'s; what they are told is read off the wire, what they did off their axes.
"""

import math
import struct

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from bench.drive_faults import fly
from drivers.errors import ConfigurationError
from drivers.records import CAN_FRAME, SCALAR, Batch
from hil_sim.arm_rig import BUS, START_NS, ArmRig, Motor
from hil_sim.faults import Fault
from onboard import config
from onboard.config.driving import joint_ranges, read_motion, resampled
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.arming import Arming
from onboard.flight.acquire.devices import open_devices
from onboard.flight.acquire.publisher import Publisher

MS = 1_000_000
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
MOTORS = (Motor("shoulder", 1), Motor("elbow", 2, 0.2, 20_000, 777, True))
COUNTS = 500_000


def urdf(low=-1.0, high=1.0, speed=1.0):
    joints = "".join(
        f'<link name="link_{k}">{INERTIAL}</link><joint name="j{k}" type="revolute"><parent link="{parent}"/>'
        f'<child link="link_{k}"/><axis xyz="0 0 1"/>'
        f'<limit lower="{low}" upper="{high}" effort="50" velocity="{speed}"/></joint>'
        for k, parent in ((1, "base"), (2, "link_1"))
    )
    return f'<robot name="arm"><link name="base">{INERTIAL}</link>{joints}</robot>'


def swing(seconds=2.0, size=(0.5, -0.4), rows=101):
    """Times, and angles from (0, 0.2) and back."""
    time_s = np.linspace(0.0, seconds, rows)
    rise = 0.5 * (1.0 - np.cos(2.0 * np.pi * time_s / seconds))
    return time_s, np.stack([size[0] * rise, 0.2 + size[1] * rise], 1)


def csv_of(time_s, q, head="time_s,j1,j2"):
    return "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in np.column_stack([time_s, q]))])


def written(directory, drive="", elbow="gain = -1.0", csv=None, **limits):
    (directory / "arm.urdf").write_text(urdf(**limits))
    (directory / "motion.csv").write_text(csv_of(*swing()) if csv is None else csv)
    (directory / "vehicle.toml").write_text(f"""
[vehicle]
name = "arm"
urdf = "arm.urdf"
base = "fixed"
base_link = "base"
[bus.{BUS}]
url = "can+virtual://arm"
[device.can_sync]
kind = "canopen_sync"
bus = "{BUS}"
period_ms = 5
[device.shoulder]
kind = "cia402"
bus = "{BUS}"
node = 1
joint = "j1"
counts_per_revolution = {COUNTS}
noise_rad = 1e-5
driven = true
torque = true
[device.elbow]
kind = "cia402"
bus = "{BUS}"
node = 2
joint = "j2"
counts_per_revolution = 20000
zero_count = 777
noise_rad = 1e-5
driven = true
{elbow}
[drive]
armed = true
motion = "motion.csv"
{drive}
""")
    return directory / "vehicle.toml"


class Kept(Publisher):
    """Keeps batches."""

    def __init__(self):
        super().__init__({})
        self.rows = {}

    def publish(self, batches):
        for channel, rows in batches:
            self.rows.setdefault(channel, []).append(rows.copy())

    def of(self, channel):
        return np.concatenate(self.rows[channel]) if channel in self.rows else np.zeros(0)


class Bench:
    """An arm, and an acquisition worker on it."""

    def __init__(self, directory, faults=(), arm=True, motors=MOTORS, change=None, **said):
        self.directory = directory
        written(directory, **said)
        self.rig = ArmRig(motors, faults)
        for name, do in (change or {}).items():
            do(self.rig.drives[name])
        self.arm, self.kept = arm, Kept()
        self.start()

    def start(self):
        vehicle = config.load(self.directory / "vehicle.toml").model_copy(update={"arm": self.arm})
        self.opened = open_devices(vehicle.with_urls({BUS: self.rig.url}), lambda: self.rig.now_ns)
        self.kept.publish(self.opened.problems)
        self.worker = Acquisition(self.opened.devices, self.kept, Arming(vehicle, self.directory))
        self.worker.start(self.rig.now_ns)

    def run(self, seconds, pumped=True):
        end_ns = self.rig.now_ns + round(seconds * 1e9)
        while self.rig.now_ns < end_ns:
            self.rig.advance(self.rig.now_ns + 5 * MS)
            if pumped:
                self.worker.step(self.rig.now_ns)
        return self

    def stop(self):
        self.worker.stop(self.rig.now_ns)
        self.rig.advance(self.rig.now_ns + 500 * MS)

    def close(self):
        self.opened.close()
        self.rig.__exit__()

    @property
    def codes(self):
        events = self.kept.of("event")
        return [code.decode() for code in events["code"] if code.startswith(b"drive_")] if len(events) else []

    def text(self, code):
        events = self.kept.of("event")
        return events["text"][events["code"] == code.encode()][0].decode()

    def axis(self, name):
        return self.rig.axes[name]

    def is_at_rest(self):
        angles = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        self.rig.advance(self.rig.now_ns + 500 * MS)
        later = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        return np.abs(np.subtract(angles, later)).max() < 1e-4


@pytest.fixture
def bench(tmp_path):
    made = []

    def make(**said):
        made.append(Bench(tmp_path, **said))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_the_arm_follows_the_motion(bench):
    flown = bench().run(5.0)
    assert flown.codes == ["drive_armed", "drive_started", "drive_done"]
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=2e-3)
    assert flown.axis("elbow").lowest_rad == pytest.approx(-0.2, abs=2e-3)
    rows = flown.kept.of("shoulder")
    angle = rows["value_raw"] * rows["scale"]
    began = rows["host_ns"][np.argmax(angle > 1e-3)]
    time_s, q = swing()
    at_s = (rows["host_ns"] - began) * 1e-9 + time_s[np.argmax(q[:, 0] > 1e-3)]
    inside = (at_s > 0.0) & (at_s < 2.0)
    assert np.abs(angle[inside] - np.interp(at_s[inside], time_s, q[:, 0])).max() < 0.02
    status = flown.kept.of("shoulder_status")
    assert status["value_raw"][-1] & 0x6F == 0x27
    assert set(status["device_status"][-100:]) == {8}
    flown.stop()
    assert flown.codes[-1] == "drive_stopped"
    assert flown.is_at_rest()
    assert {drive.drive_state for drive in flown.rig.drives.values()} == {0x40}


def test_every_frame_that_was_sent_is_a_row(bench, monkeypatch):
    wire = []
    flown = bench()
    listener = flown.rig.drives["elbow"]
    hear = listener.receive
    monkeypatch.setattr(listener, "receive", lambda i, data, now: (wire.append((i, bytes(data))), hear(i, data, now)))
    flown.run(4.0)
    flown.stop()
    for name in ("shoulder", "elbow"):
        stamps = flown.kept.of(f"{name}_sent")["host_ns"]
        assert stamps[0] == START_NS
        assert (np.diff(stamps) >= 0).all()
    rows = np.concatenate([flown.kept.of("shoulder_sent"), flown.kept.of("elbow_sent")])
    assert rows.dtype == CAN_FRAME
    sent = [(int(row["cob_id"]), bytes(row["data"][: row["length"]])) for row in rows]
    ours = [frame for frame in wire if frame[0] in (0x000, 0x201, 0x202, 0x301, 0x302, 0x601, 0x602, 0x77F)]
    assert len(ours) > 1000
    assert sorted(ours) == sorted(sent)
    assert all(
        (np.diff(flown.kept.of(f"{name}_sent")["sequence"].astype(int)) == 1).all() for name in ("shoulder", "elbow")
    )


@pytest.mark.parametrize("said", [{"arm": False}, {"drive": None, "arm": True}])
def test_off_unless_armed(bench, tmp_path, said):
    if "drive" in said:
        written(tmp_path)
        text = (tmp_path / "vehicle.toml").read_text().replace("armed = true", "armed = false")
        flown = bench()
        flown.close()
        (tmp_path / "vehicle.toml").write_text(text)
        flown.rig = ArmRig(MOTORS)
        flown.kept = Kept()
        flown.start()
    else:
        flown = bench(**said)
    flown.run(2.0)
    assert flown.codes == []
    assert not len(flown.kept.of("shoulder_sent"))
    assert all(axis.highest_rad == axis.lowest_rad for axis in flown.rig.axes.values())
    assert len(flown.kept.of("shoulder_status")) > 100


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault("trip", "elbow", 2.4), "elbow reports 2310h"),
        (Fault("emergency_stop", "shoulder", 2.4, 2.6), "shoulder reports 5441h"),
        (Fault("silent", "elbow", 2.4, 2.45), "elbow has not answered SYNC"),
        (Fault("silent", "sync_box", 2.4, 2.45), "no SYNC for"),
        (Fault("off", "sync_box", 2.4, 2.45), "no SYNC for"),
        (Fault("reset", "elbow", 2.4), "elbow has not answered SYNC"),
        (Fault("frame_drop", BUS, 2.4, 2.6, 0x181), "shoulder has not answered SYNC"),
        (Fault("bus_off", BUS, 2.4, 2.6), "no SYNC for"),
        (Fault("garbage", "elbow", 2.4, 2.6), "elbow "),
    ],
    ids=lambda value: f"{value.kind}-{value.device}" if isinstance(value, Fault) else None,
)
def test_whatever_is_wrong_stops_all_drives(bench, fault, said):
    flown = bench(faults=[fault]).run(2.35)
    moving = [axis.rate_rad_s for axis in flown.rig.axes.values()]
    assert min(map(abs, moving)) > 0.1, "it happens in mid-motion"
    flown.run(0.7)
    assert "drive_stopped" in flown.codes
    assert said in flown.text("drive_stopped")
    assert flown.is_at_rest()
    flown.run(0.5)
    assert all(drive.drive_state != 0x27 for drive in flown.rig.drives.values())
    before = flown.codes
    flown.run(1.0)
    assert flown.codes == before, "a player that has stopped does not start again"


def test_lost_frames_that_are_few_do_not_stop_it(bench):
    few = [Fault("frame_drop", BUS, 2.4, 2.412, 0x181), Fault("silent", "sync_box", 2.8, 2.809)]
    assert bench(faults=few).run(5.0).codes == ["drive_armed", "drive_started", "drive_done"]


def test_a_flight_computer_that_is_killed_leaves_drives_that_stop_themselves(bench):
    flown = bench().run(2.4)
    assert abs(flown.axis("shoulder").rate_rad_s) > 0.1
    flown.run(0.6, pumped=False)
    assert flown.is_at_rest()
    assert {drive.drive_state for drive in flown.rig.drives.values()} == {0x40}


@pytest.mark.parametrize("away_s", [0.02, 1.0])
def test_an_acquisition_that_is_started_again_does_not_move_the_arm(bench, away_s):
    flown = bench().run(2.4)
    flown.opened.close()
    flown.run(away_s, pumped=False)
    flown.kept = Kept()
    flown.start()
    flown.run(1.0)
    assert flown.codes == ["drive_not_rearmed"]
    assert flown.is_at_rest()
    assert all(drive.drive_state != 0x27 for drive in flown.rig.drives.values())


def test_a_computer_that_stood_still_stops_the_arm(bench):
    flown = bench().run(2.4).run(0.06, pumped=False).run(0.5)
    assert "no target was sent" in flown.text("drive_stopped") or "no SYNC" in flown.text("drive_stopped")
    assert flown.is_at_rest()


def test_sigterm_in_mid_motion_is_a_quick_stop(bench):
    flown = bench().run(2.4)
    at = flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS))
    flown.stop()
    assert flown.text("drive_stopped") == "quick stop: the flight ends"
    assert flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)) - at < 0.1
    assert flown.is_at_rest()


def never_enables(drive):
    command = drive._on_controlword

    drive._on_controlword = lambda word, now: command(word & ~0x08, now)
    drive.dictionary.find(0x6040, 0).changed = drive._on_controlword


def keeps_its_mode(drive):
    entry = drive.dictionary.find(0x6061, 0)
    entry.read = lambda _: 1


def keeps_its_limits(drive):
    entry = drive.dictionary.find(0x607D, 1)
    entry.changed = lambda value, now: setattr(entry, "value", 0)


def has_no_quick_stop(drive):
    drive.dictionary.remove(0x605A, 0)


def in_fault(drive):
    drive._at("fault", START_NS + 300 * MS, lambda now: drive.trip(0x2310, now))


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (never_enables, "drive_stopped", "not enabled within 3 s, statuswords: elbow 0"),
        (keeps_its_mode, "drive_stopped", "elbow is in mode 1, not 8"),
        (keeps_its_limits, "configuration", "607Dh:01 was written"),
        (has_no_quick_stop, "configuration", "605Ah"),
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
    flown = bench(drive='mode = "profile"', csv=csv_of(time_s, q)).run(6.0)
    assert flown.codes == ["drive_armed", "drive_started", "drive_done"]
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=0.02)
    assert flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"csv": csv_of(*swing()).replace("0.2\n", "nan\n", 1)}, "finite"),
        ({"csv": csv_of(*swing()).replace(",0.2\n", ",\n", 1)}, "could not convert"),
        ({"csv": csv_of(*swing(), head="time_s,j1,wrist")}, "lacks j2 and has wrist, which nothing drives"),
        ({"csv": csv_of(*swing(seconds=0.5))}, "its largest rate"),
        ({"csv": csv_of(*swing(size=(1.2, 0.0), seconds=6.0))}, "its range less the margin"),
        ({"csv": csv_of(*(part[:26] for part in swing(seconds=4.0)))}, "begins and ends at rest"),
        ({"csv": csv_of(swing()[0][::-1], swing()[1])}, "time_s has to rise"),
        ({"csv": "time_s,j1,j2\n0,0,0\n"}, "4 rows"),
        ({"low": 1.0, "high": -1.0}, "the lower below the upper"),
        ({"speed": 0.0}, "no largest rate"),
        ({"drive": "margin_rad = 1.0"}, "leaves 'j1' no range"),
        ({"drive": "acceleration_rad_s2 = 0.5"}, "acceleration_rad_s2"),
        ({"drive": "master_node = 2"}, "master node 2"),
        ({"drive": 'mode = "profile"'}, "0.2 s apart"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(tmp_path, said, why):
    vehicle = config.load(written(tmp_path, **said)).model_copy(update={"arm": True})
    with pytest.raises((config.ConfigError, ConfigurationError), match=why):
        vehicle.play(BUS)


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


def test_the_phase_arms(bench, tmp_path):
    written(tmp_path)
    vehicle = config.load(tmp_path / "vehicle.toml")
    phases = type("P", (), {"channel": "phase"})
    drive = vehicle.file.drive.model_copy(update={"phase": 3})
    estimation = vehicle.file.estimation.model_copy(update={"phases": phases})
    vehicle = vehicle.model_copy(
        update={"file": vehicle.file.model_copy(update={"drive": drive, "estimation": estimation})}
    )
    arming = Arming(vehicle, tmp_path)

    class Played:
        armed = 0

        def arm(self):
            self.armed += 1

    class Device:
        name, player = "can_0", Played()

    assert arming.started(Device(), 0) == []
    rows = np.zeros(1, SCALAR)
    for value, status, armed in ((2, 0, 0), (3, 2, 0), (3, 0, 1), (3, 0, 1)):
        rows["value_raw"], rows["status"] = value, status
        arming.see([Batch("phase", rows)])
        assert Device.player.armed == armed
    assert [batch.rows["code"][0] for batch in Arming(vehicle, tmp_path).started(Device(), 0)] == [b"drive_not_rearmed"]


def test_ranges_of_a_urdf():
    assert joint_ranges(urdf(-0.5, 0.7, 2.0))["j2"] == (-0.5, 0.7, 2.0)
    with pytest.raises(config.ConfigError, match="limits of the URDF"):
        joint_ranges("<robot>")


@pytest.mark.parametrize("seed", [2001, 2002, 2003])
def test_random_faults(seed):
    outcome = fly(seed)
    assert outcome.is_safe
    assert outcome.moved_rad > 0.02
