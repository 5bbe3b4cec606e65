"""Drives that are driven: a motion through the acquisition worker, on simulated servo drives, in virtual time.

The drives are ``hil_sim``'s; their commands are read off the wire, what they did off their axes.
"""

import numpy as np
import pytest

from bench.drive_faults import fly
from drivers.records import CAN_FRAME, SCALAR, Batch
from hil_sim.arm_rig import BUS, START_NS, ArmRig
from hil_sim.faults import Fault
from onboard import config
from onboard.flight.acquire.arming import Arming
from tests.flight.driven_bench import COUNTS, MOTORS, Bench, Kept, closed_after, swing, written
from tests.flight.servo_bench import ServoBench


@pytest.fixture
def bench(tmp_path):
    yield from closed_after(tmp_path, Bench)


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
        (Fault("silent", "elbow", 2.4, 2.45), "elbow has not answered SYNC"),
        pytest.param(
            Fault("silent", "sync_box", 2.4, 2.45), "no SYNC for", marks=pytest.mark.campaign
        ),  # test_asked_segments
        pytest.param(Fault("off", "sync_box", 2.4, 2.45), "no SYNC for", marks=pytest.mark.campaign),
        pytest.param(Fault("reset", "elbow", 2.4), "elbow has not answered SYNC", marks=pytest.mark.campaign),
        (Fault("bus_off", BUS, 2.4, 2.6), "SYNC for"),  # the producer, or a drive: whichever limit is over first
        *(
            pytest.param(Fault(*fault), said, marks=pytest.mark.campaign)  # a trip, a drive that is silent: above
            for fault, said in (
                (("emergency_stop", "shoulder", 2.4, 2.6), "shoulder reports 5441h"),
                (("frame_drop", BUS, 2.4, 2.6, 0x181), "shoulder has not answered SYNC"),
                (("garbage", "elbow", 2.4, 2.6), "elbow "),
            )
        ),
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
    flown.run(0.5)
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


@pytest.fixture(params=[(Bench, 2.4), (ServoBench, 1.6)], ids=["cia402", "dynamixel"])
def midway(request, tmp_path):
    """Drives of each kind in mid-motion."""
    kind, seconds = request.param
    for make in closed_after(tmp_path, kind):
        yield make().run(seconds)


@pytest.mark.parametrize("away_s", [0.02, pytest.param(1.0, marks=pytest.mark.campaign)])  # 1 s: at rest
def test_an_acquisition_that_is_started_again_does_not_move_the_arm(midway, away_s):
    midway.opened.close()
    midway.run(away_s, pumped=False)
    midway.kept = Kept()
    midway.start()
    midway.run(1.0)
    assert midway.codes == ["drive_not_rearmed"]
    assert midway.is_at_rest()
    assert all(drive.drive_state != 0x27 for drive in midway.rig.drives.values())


def test_a_computer_that_stood_still_stops_the_arm(midway):
    midway.run(0.06, pumped=False).run(0.8)
    assert any(why in midway.text("drive_stopped") for why in ("no target was sent", "no SYNC", "no answer"))
    assert midway.is_at_rest()
    assert not {drive.drive_state for drive in midway.rig.drives.values()} & {0x27, 1}


@pytest.mark.parametrize(
    ("at_s", "late_s"),
    [
        *(pytest.param(*one, marks=pytest.mark.campaign) for one in ((2.3, 0.02), (2.7, 0.03), (2.7, 0.05))),
        (2.55, 0.07),
    ],
)
def test_a_computer_that_was_late_goes_on_from_rest_within_the_limits(bench, at_s, late_s):
    flown = bench(drive="sync_limit_ms = 100").run(at_s).run(late_s, pumped=False)
    flown.run(2.5)
    assert flown.codes == ["drive_armed", "drive_started", "drive_done"]
    for name, node, counts in (("shoulder", 1, COUNTS), ("elbow", 2, 20_000)):
        rows = flown.kept.of(f"{name}_sent")
        sent = rows["data"][rows["cob_id"] == 0x300 + node][:, :4].copy().view("<i4").ravel()
        steps = np.abs(np.diff(sent.astype(float))) * 2.0 * np.pi / counts / 5e-3
        assert 0.6 < steps.max() < 0.86, "the motion's own largest is 0.785 rad/s; targets are whole counts"
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=5e-3)


def test_sigterm_in_mid_motion_is_a_quick_stop(bench):
    flown = bench().run(2.4)
    at = flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS))
    flown.stop()
    assert flown.text("drive_stopped") == "quick stop: the flight ends"
    assert flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)) - at < 0.1
    assert flown.is_at_rest()


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


@pytest.mark.campaign  # of each kind: above
@pytest.mark.parametrize("seed", [2001, 2002, 2003])
def test_random_faults(seed):
    outcome = fly(seed)
    assert outcome.is_safe
    assert outcome.moved_rad > 0.02
