"""A pose tracker on its way to the estimator: its delay, its ticks, the sign of its quaternions, who uses it.

A flight before a tracker: its poses are fused, and lengths that are wrong from the start do not mislead.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from drivers.records import POSE, SampleStatus
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.channels import outer_ends
from onboard.cli import main
from onboard.devices.registry import DEVICES
from onboard.flight import hil
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.flight.estimate.readings.tracked import TrackedTicks
from onboard.ground.campaign.instants import off_by
from onboard.ground.identify.mission import mission_table
from onboard.ground.identify.replay.feed import feed
from onboard.ground.identify.replay.replay import replay
from onboard.identification.standing import LEVELS, Level
from onboard.recording.reader import LogReader
from onboard.timebase.timebase import RecordedChannel, Timebase
from tests.flight.missions import Result

DEVICE = {
    "kind": "pose_tracker",
    "bus": "tty_tracker",
    "frame": "imu_base",
    "rate_hz": 100,
    "latency_ms": 8.0,
    "latency_sigma_ms": 1.0,
    "position_noise_m": 5e-4,
    "attitude_noise_rad": 3.5e-3,
}
START_NS = 5_000_000_000


def tracked(name="dymaflex", **keys):
    vehicle = config.load(config.packaged(name))
    tree = vehicle.file.model_dump(exclude_unset=True, by_alias=True)
    tree["bus"]["tty_tracker"] = {"url": "serial:///dev/ttyUSB0?baud=230400"}
    tree["device"]["tracker"] = DEVICE | keys
    return config.parse_tree(tree, vehicle.path, config.Origin("test"))


def poses(count, signs=1.0):
    """A drift of 0.1 m/s along x, a turn of 0.2 rad/s about z."""
    rows = np.zeros(count, POSE)
    time_s = 0.01 * np.arange(count)
    rows["sequence"], rows["host_ns"] = np.arange(count), START_NS + np.arange(count) * 10_000_000
    rows["tick"] = rows["host_ns"]
    rows["position_m"][:, 0] = 0.1 * time_s
    rows["quaternion"] = (signs * np.array([np.cos(0.1 * time_s), 0 * time_s, 0 * time_s, np.sin(0.1 * time_s)])).T
    return rows


def at_ticks(rows, ticks=50):
    vehicle = tracked()
    [role] = roles_of(vehicle).trackers
    signals = SignalSmoother(vehicle, trackers=[role])
    assert signals.append({"tracker": rows[:70]}) == []
    assert signals.append({"tracker": rows[70:]}) == []
    timebase = Timebase({"tracker": RecordedChannel(0.0)}, None)
    at_ns = START_NS + 503_000_000 + np.arange(ticks, dtype=np.int64) * 10_000_000
    at_ns -= at_ns % 10_000_000
    return at_ns, TrackedTicks(role, 10_000_000).at(signals, timebase, at_ns)


def test_every_fourth_tick_has_a_line_through_four_poses():
    at_ns, found = at_ticks(poses(150))
    read = np.flatnonzero(np.isfinite(found.derivatives[0][:, 0]))
    assert len(read) in (12, 13)
    assert set(np.diff(read)) == {4}
    time_s = (at_ns[read] - START_NS) * 1e-9
    a_micrometre = 1e-6
    assert found.derivatives[0][read, 4] == pytest.approx(0.1 * time_s, abs=a_micrometre)
    assert found.derivatives[0][read, 3] == pytest.approx(np.sin(0.1 * time_s), abs=1e-5)
    assert found.sigma[0][read, 4].min() > 0.4 * 5e-4
    assert found.sigma[0][read, 0] == pytest.approx(0.5 * found.sigma[0][read, 4] * 3.5e-3 / 5e-4)


def test_a_quaternion_that_changes_its_sign_is_the_same_attitude():
    plain, turned = poses(150), poses(150, np.where(np.arange(150) // 7 % 2, -1.0, 1.0))
    assert (turned["quaternion"] != plain["quaternion"]).any()
    for one, other in zip(at_ticks(plain)[1].derivatives, at_ticks(turned)[1].derivatives, strict=True):
        assert one == pytest.approx(other, nan_ok=True, abs=1e-7)


def test_poses_that_are_not_valid_are_no_readings():
    rows = poses(150)
    rows["status"][90:110] = SampleStatus.NOT_VALID
    rows["quaternion"][95] = np.nan
    at_ns, found = at_ticks(rows)
    known = (at_ns[np.isfinite(found.derivatives[0][:, 0])] - START_NS) * 1e-9
    assert len(known) >= 5
    assert not ((known > 0.89) & (known < 1.10)).any()


def test_the_delay_is_that_of_the_least_delayed_message_and_half_of_a_poll():
    vehicle = tracked(poll_period_ms=4.0)
    [delay] = vehicle.file.device["tracker"].delays("tracker", vehicle)
    assert delay.delay_s == pytest.approx(8e-3 + 2e-3 + 52 * 10 / 230_400)
    assert delay.sigma_s == pytest.approx(1e-3 * np.hypot(1.0, 4.0 / 12**0.5))
    assert DEVICES["pose_tracker"].model_validate(DEVICE | {"covariance": True}).covariance


def test_a_free_base_has_its_poses_as_rows_of_the_flight_and_not_of_what_is_fitted_afterwards():
    vehicle = tracked()
    online = build_free_flyer(vehicle)[0]
    assert online.row_names[-7:] == (
        *(f"attitude_{part}_tracker" for part in "wxyz"),
        *(f"position_{axis}_tracker" for axis in "xyz"),
    )
    assert online.ekf.predictor.moving.size == 10
    assert Estimator(vehicle).online.row_names == online.row_names
    bare = build_free_flyer(config.load(config.packaged("dymaflex")))[0].ekf.predictor
    assert build_free_flyer(vehicle, tracked=False)[0].ekf.predictor.names == bare.names


def test_with_thrusters_it_is_recorded_only():
    assert build_free_flyer(tracked("dymaflex_wheels"))[0].ekf.predictor.moving.size == 0


OVER = """
[payload]
mass_kg = [1.0, 2.0]
[[sequence]]
phase = 1
action = "swing"
duration_s = 7.0
band_Hz = [0.2, 1.0]
"""
LENGTHS = 1.06


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> config.Vehicle:
    directory = tmp_path_factory.mktemp("tracked") / "mine"
    assert main(["init", str(directory), "--base", "free", "--joints", "3", "--encoder", "cia402"]) == 0
    path = directory / "vehicle.toml"
    device = "".join(f"{key} = {value!r}\n" for key, value in DEVICE.items())
    bus = '\n[bus.tty_tracker]\nurl = "serial:///dev/ttyUSB0?baud=230400"\n'
    path.write_text(f"{path.read_text()}{bus}[device.tracker]\n{device}")
    return config.load(path)


@pytest.fixture(scope="module")
def flown(vehicle: config.Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("healthy") / "flight.mcap"
    path.with_suffix(".toml").write_text(OVER)
    world, urls = open_in_process(scenario_of(vehicle.path, path.with_suffix(".toml")), 3)
    with world:
        flown = hil.fly_simulated(vehicle, world, urls, path)
    return Result(path, flown, mission_table.result(flown))


def told(flown: Result, vehicle: config.Vehicle, lengths: float) -> Iterator[np.void]:
    """Answers of the flight, or of one whose tracker is off by its lengths."""
    if lengths == 1.0:
        yield from flown.log.read("quantity")
        return
    estimator = Estimator(vehicle)
    process = estimator.process

    def spoilt(now_ns, batches, *rest):
        taken = dict(batches)
        if "tracker" in taken:
            taken["tracker"] = taken["tracker"].copy()
            taken["tracker"]["position_m"] *= lengths
        return process(now_ns, taken, *rest)

    estimator.process = spoilt
    for name, rows in feed(estimator, LogReader(flown.path)):
        yield from rows if name == "quantity" else ()


def answers(flown: Result, vehicle: config.Vehicle, lengths: float) -> tuple[list[float], list[float]]:
    """Errors of all good answers over their sides of their 99.9 % intervals, and the last ten of those of 95 %."""
    truth, off, widths = flown.flown.truth["quantities"], list[float](), list[float]()
    for row in told(flown, vehicle, lengths):
        if LEVELS[row["level"]] is Level.GOOD and (known := truth.get(row["name"].decode())) is not None:
            widths.append(0.5 * (row["high"] - row["low"]))
            off.append(float(off_by(row["value"], *outer_ends(row), known)))
    return off, widths[-10:]


def test_it_is_fused_and_replays_to_the_bit(flown: Result, vehicle: config.Vehicle) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    assert not flown.events("left_out")
    assert replay(flown.path).identical
    assert Estimator(vehicle).online.ekf.predictor.moving.size == 10


@pytest.mark.campaign  # of ticks: prediction/test_pose, test_recursive_tracker
@pytest.mark.parametrize("lengths", [1.0, LENGTHS])
def test_no_answer_is_good_and_wrong_while_the_trackers_lengths_are_off(
    flown: Result, vehicle: config.Vehicle, lengths: float
) -> None:
    off, widths = answers(flown, vehicle, lengths)
    assert len(off) >= 100
    assert np.isfinite(widths).all()
    assert max(off) < 1.0
