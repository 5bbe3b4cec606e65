"""The small parts of the flight app: history, phases, zeroing, publisher, smoothed signals."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter

from drivers import records
from drivers.records import Batch, Severity, event
from onboard import config
from onboard.config.estimation import Estimation
from onboard.devices.can.cia404 import Cia404Device
from onboard.devices.can.cia406 import Cia406Device
from onboard.estimation.gates import GateReason
from onboard.flight.acquire.publisher import Publisher, joined
from onboard.flight.estimate.phases import PhaseTrack
from onboard.flight.estimate.problem.identification import METHODS
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks
from onboard.flight.estimate.readings.history import History
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.flight.estimate.readings.zeroing import Temperatures, Zeroing
from onboard.identification.quantities import Findings
from onboard.ring import RingReader, RingWriter
from onboard.timebase.specs import FollowerChannel, ProducerChannel, RecordedChannel
from onboard.timebase.timebase import Timebase
from tests.flight import mixed

ROCKSAT = config.load(config.packaged("rocksat"))


@given(batches=st.lists(st.integers(0, 30), max_size=30), capacity=st.integers(1, 20))
def test_history_is_the_tail_of_a_list(batches: list[int], capacity: int) -> None:
    history, told = History(capacity, 2), 0
    for count in batches:
        ticks = np.arange(told, told + count)
        rows = np.zeros(count, records.SCALAR)
        rows["tick"], rows["host_ns"] = ticks, 7 * ticks
        history.append(rows, np.column_stack([ticks, -ticks]).astype(float), ticks % 3)
        told += count
        ticks = history.stamps["tick"]
        kept = len(ticks)
        assert min(told, capacity) <= kept <= 2 * capacity
        assert ticks.tolist() == list(range(told - kept, told))
        assert (history.stamps["host_ns"] == 7 * ticks).all()
        assert (history.values[:, 1] == -ticks).all()
        assert (history.wrong == ticks % 3).all()
    history.clear()
    assert len(history.stamps) == len(history.values) == 0


def phase_rows(*changes: tuple[int, int]) -> records.Rows:
    rows = np.zeros(len(changes), records.SCALAR)
    rows["host_ns"], rows["value_raw"] = [c[0] for c in changes], [c[1] for c in changes]
    return rows


def test_phases_are_told_once_and_the_payload_goes_when_they_say() -> None:
    track = PhaseTrack(ROCKSAT.file.estimation.phases)
    at = np.array([5, 15, 25, 35])
    assert track.at(at).tolist() == [-1] * 4
    assert track.attached(at).all()
    assert track.update({"arm_phase": phase_rows((10, 0), (11, 0), (20, 3))}) == ["phase 0", "phase 3"]
    assert track.at(at).tolist() == [-1, 0, 3, 3]
    assert track.update({"arm_phase": phase_rows((30, 5)), "imu_base": np.zeros(0, records.IMU)}) == ["phase 5"]
    assert track.attached(at).all()  # until it is read back
    assert track.update({"arm_phase": phase_rows((32, 5))}) == []
    assert track.attached(at).tolist() == [True, True, True, False]
    assert PhaseTrack(None).attached(at).all()


def test_a_payload_that_is_taken_in_flight_is_not_held_before() -> None:
    settings = ROCKSAT.file.estimation.phases
    assert settings is not None
    track = PhaseTrack(settings.model_copy(update={"payload_taken": 3}))
    at = np.array([5, 15, 25, 35])
    track.update({"arm_phase": phase_rows((10, 0), (11, 0), (20, 3))})
    assert not track.attached(at).any()  # until it is read back
    track.update({"arm_phase": phase_rows((21, 3), (30, 5), (31, 5))})
    assert track.attached(at).tolist() == [False, False, True, False]


def test_one_false_reading_does_not_let_the_payload_go() -> None:
    track = PhaseTrack(ROCKSAT.file.estimation.phases)
    doubted = phase_rows((22, 5), (23, 5))
    doubted["status"] = records.SampleStatus.NOT_VALID
    assert track.update({"arm_phase": phase_rows((10, 4), (11, 4))}) == ["phase 4"]
    assert track.update({"arm_phase": doubted}) == []
    assert track.update({"arm_phase": phase_rows((25, 5), (26, 4), (30, 5))}) == ["phase 5", "phase 4", "phase 5"]
    at = np.array([24, 28, 40])
    assert track.attached(at).all()
    assert track.at(at).tolist() == [4, 4, 5]


def test_zero_is_the_mean_at_rest_and_waits_for_enough_of_it() -> None:
    zeroing = Zeroing(config.Zero(phases=[0], ticks=4), moving=[3])
    offset = np.array([0.3, -0.2, 0.5])
    force = offset + np.array([[0.01], [-0.01], [9.0], [0.02], [-0.02], [1.0], [1.0]])
    usable = np.array([True, True, False, True, True, True, True])
    first = zeroing.apply(force[:2], np.array([0, 0]), usable[:2])
    assert np.isnan(first).all()
    pushed = zeroing.apply(force[5:6], np.array([1]), usable[5:6])  # a push after too short a rest: wait for more
    assert np.isnan(pushed).all()
    assert np.isnan(zeroing.apply(force[5:6], np.array([3]), usable[5:6])).all()
    (warned,), again = zeroing.news(1, "imu"), zeroing.news(2, "imu")
    assert warned.rows["text"][0].endswith(b": 2 of 4 ticks at rest in phases 0")
    assert again == []
    rest = zeroing.apply(force[2:5], np.array([0, 0, 0]), usable[2:5])
    assert np.isnan(rest).all()
    swept = zeroing.apply(force[6:], np.array([3]), usable[6:])
    assert swept == pytest.approx(np.ones((1, 3)))
    assert (zeroing.ticks, zeroing.lost) == (4, 1)
    assert [one.rows["code"][0] for one in zeroing.news(3, "imu") + zeroing.news(4, "imu")] == [b"zeroed"]
    assert zeroing.offset_m_s2 == pytest.approx(offset)


def warmed(rng: np.random.Generator, slope: float, drag: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Rest, sweep, rest, sweep of 2 s each while the chip warms by 12 K: residual specific force, and its phases."""
    t = np.arange(0.0, 8.0, 0.01)
    kelvin = 12.0 * (1.0 - np.exp(-t / 4.0))
    codes = np.where((t % 4.0) < 2.0, 0, 3)
    force = 0.3 + slope * kelvin[:, None] + 0.01 * rng.standard_normal((len(t), 3))
    force[t >= 4.0] += drag
    zeroing = Zeroing(config.Zero(phases=[0], ticks=100))
    steps = [slice(k, k + 5) for k in range(0, len(t), 5)]
    out = [zeroing.apply(force[step], codes[step], np.ones(5, bool), kelvin[step]) for step in steps]
    return np.concatenate(out), codes


def test_an_accelerometer_that_warms_up_is_followed(rng: np.random.Generator) -> None:
    left, codes = warmed(rng, 0.005)
    assert np.isnan(left[:200]).all()
    assert abs(np.nanmean(left[codes == 3])) < 0.002
    assert abs(left[600:].mean()) < 0.002  # 0.04 m/s^2 where the offset of the first rest is kept


def test_a_specific_force_that_no_temperature_explains_is_not_zeroed_away(rng: np.random.Generator) -> None:
    left, _ = warmed(rng, 0.005, drag=0.2)
    assert left[600:].mean() == pytest.approx(0.2, abs=0.02)


def test_without_a_setting_nothing_is_zeroed() -> None:
    force = np.array([[1.0, 2.0, 3.0]])
    assert (Zeroing(None).apply(force, np.array([-1]), np.array([True])) == force).all()


def test_the_publisher_numbers_what_many_hands_write(tmp_path: Path) -> None:
    rings = {
        "event_x": RingWriter(tmp_path / "event_x.ring", records.EVENT, 16),
        "pulse": RingWriter(tmp_path / "pulse.ring", records.PULSE, 16),
    }
    publisher = Publisher(rings, "_x")
    pulse = np.zeros(1, records.PULSE)
    pulse["sequence"] = 7
    said = [event(n, Severity.INFO, "code", "source", "text") for n in range(3)]
    publisher.publish([said[0], Batch("pulse", pulse), said[1]])
    publisher.publish([said[2]])
    assert RingReader(tmp_path / "event_x.ring").read()[0]["sequence"].tolist() == [0, 1, 2]
    assert RingReader(tmp_path / "pulse.ring").read()[0]["sequence"].tolist() == [7]


def test_rows_of_a_channel_are_joined_but_not_past_an_event() -> None:
    def pulse(*numbers: int) -> Batch:
        rows = np.zeros(len(numbers), records.PULSE)
        rows["sequence"] = numbers
        return Batch("pulse", rows)

    said = event(5, Severity.INFO, "code", "source", "text")
    made = joined([pulse(0), Batch("edge", pulse(7).rows), pulse(1, 2), pulse(), said, pulse(3)])
    assert [batch.channel for batch in made] == ["pulse", "edge", "event", "pulse"]
    assert [batch.rows["sequence"].tolist() for batch in made] == [[0, 1, 2], [7], [0], [3]]
    assert made[0].rows.dtype is pulse(0).rows.dtype
    assert made[0].rows.flags.writeable


LINK = """<link name="{}"><inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
BODIES = f"""<robot name="t">{LINK.format("body")}{LINK.format("arm")}
<joint name="j" type="continuous"><parent link="body"/><child link="arm"/></joint></robot>"""


def recorded_vehicle(tmp_path: Path) -> config.Vehicle:
    text = (
        '[vehicle]\nname="t"\nurdf="t.urdf"\nbase="free"\nbase_link="body"\n'
        '[device.imu]\nkind="recorded_imu"\nframe="body"\nperiod_ms=1\naccel_noise_m_s2=0.1\ngyro_noise_rad_s=0.01\n'
        "[estimation]\nsmoothing_ms=50\n"
    )
    (tmp_path / "t.urdf").write_text(BODIES)
    return config.parse(text, tmp_path / "vehicle.toml")


def imu_rows(seconds: np.ndarray, scale: float = 1e-4) -> records.Rows:
    rows = np.zeros(len(seconds), records.IMU)
    rows["host_ns"] = np.rint(seconds * 1e9)
    rows["gyro_scale_rad_s"] = rows["accel_scale_m_s2"] = scale
    rows["gyro_raw"][:, 2] = np.rint(np.sin(4 * seconds) / scale)
    rows["accel_raw"][:, 0] = np.rint(seconds / scale)
    return rows


def test_signals_are_si_smoothed_and_differentiated(tmp_path: Path) -> None:
    signals = SignalSmoother(recorded_vehicle(tmp_path))
    seconds = np.arange(0.0, 1.0, 1e-3)
    signals.append({"imu": imu_rows(seconds)})
    at_ns = np.array([300_000_000, 500_000_000])
    smoothed = signals.at("imu", recorded("imu"), at_ns, 1)
    one_count = 1e-4
    assert smoothed.derivatives[0][:, 2] == pytest.approx(np.sin(4 * at_ns * 1e-9), abs=one_count)
    assert smoothed.derivatives[1][:, 2] == pytest.approx(4 * np.cos(4 * at_ns * 1e-9), abs=0.005)
    assert smoothed.derivatives[0][:, 3] == pytest.approx(at_ns * 1e-9, abs=one_count)
    assert (smoothed.refused == 0).all()
    assert (smoothed.sigma[0][:, 0] < 0.01).all()  # smoothing averages
    assert (smoothed.sigma[0][:, 3] < 0.1).all()


def test_a_time_that_is_not_known_well_makes_what_changes_uncertain(tmp_path: Path) -> None:
    signals = SignalSmoother(recorded_vehicle(tmp_path))
    signals.append({"imu": imu_rows(np.arange(0.0, 1.0, 1e-3))})
    at_ns = np.array([190, 200, 210]) * 1_000_000
    sharp = signals.at("imu", Timebase({"imu": RecordedChannel(0.0)}, None), at_ns, 1)
    vague = signals.at("imu", Timebase({"imu": RecordedChannel(2e6)}, None), at_ns, 1)
    two_milliseconds = 2e-3
    for order in (0, 1):
        added = np.sqrt(vague.sigma[order] ** 2 - sharp.sigma[order] ** 2)
        assert added[:, 0] == pytest.approx(0.0, abs=1e-6)  # it does not change
    rate = 4 * np.cos(4 * at_ns * 1e-9)
    added = np.sqrt(vague.sigma[0] ** 2 - sharp.sigma[0] ** 2)
    more_than_noise = np.sqrt(np.maximum(rate**2 - sharp.sigma[1][:, 2] ** 2, 0.0))
    assert added[:, 2] == pytest.approx(two_milliseconds * more_than_noise, rel=0.02, abs=1e-6)
    alone = signals.at("imu", Timebase({"imu": RecordedChannel(2e6)}, None), at_ns, 0)  # the rate from tick to tick
    added = np.sqrt(alone.sigma[0] ** 2 - sharp.sigma[0] ** 2)
    assert added[1, 2] == pytest.approx(two_milliseconds * abs(rate[1]), rel=0.2)


def behind_a_gear(rate_rad_s: float, *, cyclic_fitted: bool) -> ChannelAtTicks:
    """Joint 1 of DYMAFLEX at a steady rate, its phases 1 and 0."""
    vehicle = config.load(config.packaged("dymaflex"))
    device, signals = vehicle.file.device["joint_1"], SignalSmoother(vehicle, cyclic_fitted=cyclic_fitted)
    assert isinstance(device, Cia406Device)
    seconds = np.arange(0.0, 2.0, 2e-3)
    motor = device.gear_ratio * rate_rad_s * seconds
    ripple = device.eccentricity_rad * np.sin(motor + 1.0) + device.transmission_error_rad * np.sin(2.0 * motor)
    rows = np.zeros(len(seconds), records.SCALAR)
    rows["host_ns"], rows["unit"] = np.rint(seconds * 1e9), b"rad"
    rows["scale"] = 2.0 * np.pi / device.counts_per_revolution
    angle = rate_rad_s * seconds + np.sqrt(2.0) * ripple
    rows["value_raw"] = device.zero_count + np.floor(angle / rows["scale"])
    signals.append({"joint_1": rows})
    return signals.at("joint_1", recorded("joint_1"), np.arange(200, 1800, 10) * 1_000_000, 2)


@pytest.mark.parametrize("rate_rad_s", [0.05, 0.1, 0.2])
def test_behind_a_gear_rate_and_acceleration_scatter_as_their_sigma_says(rate_rad_s: float) -> None:
    smoothed = behind_a_gear(rate_rad_s, cyclic_fitted=False)
    assert smoothed.cyclic is None
    for order, truth in ((1, rate_rad_s), (2, 0.0)):
        scatter = np.sqrt(np.mean((smoothed.derivatives[order] - truth) ** 2))
        assert scatter == pytest.approx(np.sqrt(np.mean(smoothed.sigma[order] ** 2)), rel=0.25)


@pytest.mark.parametrize("rate_rad_s", [0.05, 0.1, 0.2])
def test_the_functions_of_cyclic_errors_are_smoothed_as_the_joint_is(rate_rad_s: float) -> None:
    """With the amplitudes and phases of the gear nothing but quantisation and squares of the errors is left."""
    smoothed = behind_a_gear(rate_rad_s, cyclic_fitted=True)
    assert smoothed.cyclic is not None
    once, twice = np.sqrt(2.0) * 1.6e-5, np.sqrt(2.0) * 5e-5
    gears = np.array([once * np.sin(1.0), once * np.cos(1.0), 0.0, twice])  # of cosine and sine, once and twice a turn
    for order, truth in ((1, rate_rad_s), (2, 0.0)):
        scatter = smoothed.derivatives[order][:, 0] - truth
        left = scatter - smoothed.cyclic[:, order] @ gears
        told = np.sqrt(np.mean(smoothed.sigma[order] ** 2))
        assert np.sqrt(np.mean(left**2)) < 1.25 * told < 0.5 * np.sqrt(np.mean(scatter**2))


def test_means_of_a_cell_behind_its_filter_scatter_as_their_sigma_says(rng: np.random.Generator) -> None:
    """DYMAFLEX's cell: half of what a sample reads of its noise is in the next one too."""
    vehicle = config.load(config.packaged("dymaflex"))
    device, signals = vehicle.file.device["load_cell"], SignalSmoother(vehicle)
    assert isinstance(device, Cia404Device)
    b, a = butter(2, np.sqrt(2.0) / (1e-3 * device.delay_ms), fs=2.0 * np.pi * 1e4)
    noise = lfilter(b, a, rng.normal(size=120_000))[::20][500:]  # every 2 ms
    rows = np.zeros(len(noise), records.SCALAR)
    rows["host_ns"], rows["unit"], rows["scale"] = 2_000_000 * np.arange(len(noise)), b"N", 1e-5
    rows["value_raw"] = np.rint(device.noise_N * noise / noise.std() / 1e-5)
    signals.append({"load_cell": rows})
    at_ns = np.arange(8_000, 10_500, 10) * 1_000_000
    found = signals.means(["load_cell"], recorded("load_cell"), at_ns, 10_000_000)
    kept = found.refused == 0  # of the history
    assert kept.sum() > 100
    assert found.derivatives[0][kept].std() == pytest.approx(found.sigma[0][kept].mean(), rel=0.15)


def test_a_hole_and_a_saturated_sample_refuse_the_ticks_around_them(tmp_path: Path) -> None:
    signals = SignalSmoother(recorded_vehicle(tmp_path))
    seconds = np.arange(0.0, 1.0, 1e-3)
    rows = imu_rows(seconds[(seconds < 0.3) | (seconds > 0.31)])
    rows["status"][np.searchsorted(rows["host_ns"], 600_000_000)] = records.SampleStatus.SATURATED
    signals.append({"imu": rows})
    at_ns = np.array([200, 305, 450, 610, 800]) * 1_000_000
    smoothed = signals.at("imu", recorded("imu"), at_ns, 0)
    assert smoothed.refused.tolist() == [0, GateReason.GAP, 0, GateReason.SATURATED, 0]


def test_a_clock_that_is_not_known_yet_refuses_everything() -> None:
    signals = SignalSmoother(ROCKSAT)
    rows = np.zeros(50, records.SCALAR)
    rows["tick"], rows["unit"] = np.arange(50), b"rad"
    signals.append({"joint_1": rows})
    smoothed = signals.at("joint_1", _unlocked(), np.array([0, 1]), 2)
    assert (smoothed.refused == GateReason.NOT_SYNCHRONISED).all()
    assert np.isnan(smoothed.derivatives[2]).all()


def _unlocked() -> Timebase:
    return Timebase({"can_sync": ProducerChannel(5e6, 0.0), "joint_1": FollowerChannel("can_sync")}, None)


def mixed_vehicle(tmp_path: Path) -> config.Vehicle:
    text = (Path(__file__).with_name("mixed.toml")).read_text(encoding="utf-8")
    (tmp_path / "mixed.urdf").write_text(mixed.urdf())
    return config.parse(text, tmp_path / "vehicle.toml")


def scalar_rows(raw: float, scale: float, unit: bytes, start_ms: int = 0, period_ms: int = 5) -> records.Rows:
    """Half a second of steady rows."""
    rows = np.zeros(500 // period_ms, records.SCALAR)
    rows["host_ns"] = rows["tick"] = (start_ms + period_ms * np.arange(len(rows))) * 1_000_000
    rows["value_raw"], rows["scale"], rows["unit"] = raw, scale, unit
    return rows


def recorded(*channels: str) -> Timebase:
    return Timebase({channel: RecordedChannel(0.0) for channel in channels}, None)


@pytest.mark.parametrize(
    ("channel", "unit", "expected"),
    [
        ("wrist_angle", b"rad", 2.5),
        ("wrist_angle", b"deg", np.radians(2.5)),
        ("wrist_force", b"N", 2.5),
        ("wrist_force", b"kg", 2.5 * 9.80665),
        ("wrist_gyro_x", b"rad/s", 2.5),
        ("wrist_gyro_x", b"deg/s", np.radians(2.5)),
        ("wrist_accel_z", b"m/s^2", 2.5),
        ("wrist_accel_z", b"g", 2.5 * 9.80665),
    ],
)
def test_rows_become_si_by_their_own_unit(tmp_path: Path, channel: str, unit: bytes, expected: float) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    assert signals.append({channel: scalar_rows(250, 0.01, unit)}) == []
    smoothed = signals.at(channel, recorded(channel), np.array([250_000_000]), 0)
    assert smoothed.refused.tolist() == [0]
    assert smoothed.derivatives[0][0, 0] == pytest.approx(expected, rel=1e-12)


def test_rows_of_a_unit_that_the_role_has_not_are_refused_and_told_once(tmp_path: Path) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    ((channel, said),) = signals.append({"wrist_force": scalar_rows(1, 1.0, b"V")})
    assert (channel, said.code) == ("wrist_force", "not_usable")
    assert said.text == "unit 'V' is none of N, kg: not used, correct its device"
    assert signals.append({"wrist_force": scalar_rows(1, 1.0, b"V", 500)}) == []
    assert signals.append({"wrist_force": scalar_rows(1, 1.0, b"N", 1000)}) == []
    at_ns = np.array([250, 750, 1250]) * 1_000_000
    smoothed = signals.at("wrist_force", recorded("wrist_force"), at_ns, 0)
    assert (smoothed.refused == 0).tolist() == [False, False, True]


def test_a_force_at_the_capacity_is_saturated_whatever_the_transmitter_says(tmp_path: Path) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    rows = scalar_rows(4999, 0.01, b"N")
    rows["value_raw"][50] = 5000
    signals.append({"load_cell": rows})
    at_ns = np.array([100, 250, 400]) * 1_000_000
    smoothed = signals.at("load_cell", recorded("load_cell"), at_ns, 0)
    assert smoothed.refused.tolist() == [0, GateReason.SATURATED, 0]


@pytest.mark.parametrize(("channel", "absolute"), [("shoulder", True), ("elbow", False), ("wrist_angle", False)])
def test_after_a_reset_only_an_absolute_encoder_still_knows_its_zero(
    tmp_path: Path, channel: str, absolute: bool
) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    period_ms = 2 if channel == "elbow" else 5
    rows = scalar_rows(100, 0.01, b"rad", 0, period_ms)
    rows["status"][20] = records.SampleStatus.AFTER_RESET
    said = signals.append({channel: rows})
    assert (said == []) is absolute
    assert signals.append({channel: scalar_rows(100, 0.01, b"rad", 500, period_ms)}) == []
    smoothed = signals.at(channel, recorded(channel), np.array([700_000_000]), 0)
    assert bool(smoothed.refused[0] == 0) is absolute


def test_a_timer_that_stands_still_costs_its_samples_and_nothing_else(tmp_path: Path) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    rows = scalar_rows(100, 0.01, b"rad")
    rows["host_ns"][40:45] = rows["host_ns"][40]
    rows["status"][41:45] = records.SampleStatus.NOT_VALID
    signals.append({"shoulder": rows})
    smoothed = signals.at("shoulder", recorded("shoulder"), np.array([100, 210, 350]) * 1_000_000, 1)
    assert smoothed.refused.tolist() == [0, GateReason.GAP, 0]


def test_the_roles_of_a_mixed_vehicle(tmp_path: Path) -> None:
    roles = roles_of(mixed_vehicle(tmp_path))
    wrist = tuple(f"wrist_{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz")
    assert [imu.channels for imu in roles.imus] == [("imu_base",), ("imu_elbow",), ("imu_tip",), wrist]
    assert roles.imu.frame == "body"
    assert {joint.joint: joint.channel for joint in roles.joints} == {
        "joint_1": "shoulder",
        "joint_2": "upper",
        "joint_3": "elbow",
        "joint_4": "wrist_angle",
        "joint_5": "tip",
        "joint_6": "servo_6",
        "joint_7": "servo_7",
        "joint_8": "robot_8",
    }
    assert [cell.name for cell in roles.cells] == [
        "load_cell",
        "cell",
        "grip",
        "flange",
        "hand",
        "bridge",
        "wrist_force",
    ]
    assert roles.signals.keys() == {"imu_base", "imu_elbow", "imu_tip", *wrist} | {j.channel for j in roles.joints} | {
        cell.channel for cell in roles.cells
    }


def test_the_parts_of_an_imu_stand_side_by_side(tmp_path: Path) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    names = roles_of(mixed_vehicle(tmp_path)).imus[3].channels
    for place, name in enumerate(names):
        rows = scalar_rows(100 * (place + 1), 0.01, b"rad/s" if "gyro" in name else b"m/s^2")
        signals.append({name: rows if place else rows[rows["tick"] < 300_000_000]})
    smoothed = signals.together(names, recorded(*names), np.array([150, 350]) * 1_000_000, 1)
    assert smoothed.derivatives[0][0] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert smoothed.sigma[1].shape == (2, 6)
    assert smoothed.refused.tolist() == [0, GateReason.GAP]


def test_every_method_of_the_vehicle_file_has_an_estimator_that_flies() -> None:
    named = get_args(Estimation.model_fields["method"].annotation)
    assert len(named) >= 3
    assert set(METHODS) == set(named)


@pytest.mark.parametrize(("kelvin", "said"), [(12.0, ("imu_base is 12 K warmer than at first",)), (3.0, ())])
def test_an_imu_that_has_warmed_is_named_before_what_speaks_against_all_answers(
    kelvin: float, said: tuple[str, ...]
) -> None:
    rows = np.zeros(5, records.IMU)
    temperatures = Temperatures(roles_of(ROCKSAT).imu)
    for counts in (0, round(340.0 * kelvin)):
        rows["temperature_raw"] = counts
        temperatures.append({"imu_base": rows}, lambda _, rows: rows["tick"].astype(np.int64))
    assert temperatures.noted(Findings(("it swings",))).against == (*said, "it swings")
    assert temperatures.noted(Findings((), ("noisy",))) == Findings((), ("noisy",))
