"""Smoothed signals of a flight: units, scatter, and what refuses a tick."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from drivers import records
from onboard import config
from onboard.devices.can.cia404 import Cia404Device
from onboard.devices.can.cia406 import Cia406Device
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.timebase.timebase import FollowerChannel, ProducerChannel, RecordedChannel, Timebase
from tests.flight.test_parts import ROCKSAT, mixed_vehicle, recorded, scalar_rows

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


def behind_a_gear(rate_rad_s: float, *, jumps: bool) -> ChannelAtTicks:
    """Joint 1 of DYMAFLEX at a steady rate, its phases 1 and 0; ``jumps``: its angle does, before the ticks."""
    vehicle = config.load(config.packaged("dymaflex"))
    device, signals = vehicle.file.device["joint_1"], SignalSmoother(vehicle, follows_jumps=True)
    assert isinstance(device, Cia406Device)
    seconds = np.arange(0.0, 2.0, 2e-3)
    motor = device.gear_ratio * rate_rad_s * seconds
    ripple = device.eccentricity_rad * np.sin(motor + 1.0) + device.transmission_error_rad * np.sin(2.0 * motor)
    rows = np.zeros(len(seconds), records.SCALAR)
    rows["host_ns"], rows["unit"] = np.rint(seconds * 1e9), b"rad"
    rows["scale"] = 2.0 * np.pi / device.counts_per_revolution
    angle = rate_rad_s * seconds + np.sqrt(2.0) * ripple
    angle[seconds > 0.1] += 0.02 * jumps
    rows["value_raw"] = device.zero_count + np.floor(angle / rows["scale"])
    rows["sequence"] = np.arange(len(rows))
    signals.append({"joint_1": rows}, lambda _, some: some["host_ns"])
    assert bool(signals.jumped) == jumps
    return signals.at("joint_1", recorded("joint_1"), np.arange(200, 1800, 10) * 1_000_000, 2)


@pytest.mark.parametrize("rate_rad_s", [0.05, 0.1, 0.2])
def test_behind_a_gear_rate_and_acceleration_scatter_as_their_sigma_says(rate_rad_s: float) -> None:
    """Where the encoder has jumped, and the errors of one that begins elsewhere are not to be fitted."""
    smoothed = behind_a_gear(rate_rad_s, jumps=True)
    for order, truth in ((1, rate_rad_s), (2, 0.0)):
        scatter = np.sqrt(np.mean((smoothed.derivatives[order] - truth) ** 2))
        assert scatter == pytest.approx(np.sqrt(np.mean(smoothed.sigma[order] ** 2)), rel=0.25)


@pytest.mark.parametrize("rate_rad_s", [0.05, 0.1, 0.2])
def test_the_functions_of_cyclic_errors_are_smoothed_as_the_joint_is(rate_rad_s: float) -> None:
    """With the amplitudes and phases of the gear nothing but quantisation and squares of the errors is left."""
    smoothed = behind_a_gear(rate_rad_s, jumps=False)
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
