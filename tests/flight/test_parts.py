"""The small parts of the flight app: history, phases, zeroing, publisher, smoothed signals."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import records
from drivers.records import Batch, Severity, event
from onboard import config
from onboard.estimation.gates import GateReason
from onboard.flight.history import History
from onboard.flight.phases import PhaseTrack
from onboard.flight.publisher import Publisher
from onboard.flight.signals import Signals
from onboard.flight.zeroing import Zeroing
from onboard.ring import RingReader, RingWriter
from onboard.timebase.timebase import FollowerChannel, RecordedChannel, SyncChannel, Timebase

ROCKSAT = config.load(config.packaged("rocksat"))


@given(batches=st.lists(st.integers(0, 30), max_size=30), capacity=st.integers(1, 20))
def test_history_is_the_tail_of_a_list(batches: list[int], capacity: int) -> None:
    history, told = History(capacity, 2), 0
    for count in batches:
        ticks = np.arange(told, told + count)
        history.append(ticks, np.column_stack([ticks, -ticks]).astype(float), ticks % 3 > 0)
        told += count
        kept = len(history.ticks)
        assert min(told, capacity) <= kept <= 2 * capacity
        assert history.ticks.tolist() == list(range(told - kept, told))
        assert history.values[:, 1].tolist() == [-float(t) for t in history.ticks]
        assert history.valid.tolist() == [t % 3 > 0 for t in history.ticks.tolist()]
    history.clear()
    assert len(history.ticks) == len(history.values) == 0


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
    assert track.attached(at).tolist() == [True, True, True, False]
    assert PhaseTrack(None).attached(at).all()


def test_zero_is_the_mean_at_rest_and_waits_for_enough_of_it() -> None:
    zeroing = Zeroing(config.Zero(phases=[0], ticks=4))
    offset = np.array([0.3, -0.2, 0.5])
    force = offset + np.array([[0.01], [-0.01], [9.0], [0.02], [-0.02], [1.0], [1.0]])
    usable = np.array([True, True, False, True, True, True, True])
    first = zeroing.apply(force[:2], np.array([0, 0]), usable[:2])
    assert np.isnan(first).all()
    pushed = zeroing.apply(force[5:6], np.array([1]), usable[5:6])  # a push after too short a rest: wait for more
    assert np.isnan(pushed).all()
    rest = zeroing.apply(force[2:5], np.array([0, 0, 0]), usable[2:5])
    assert np.isnan(rest).all()
    swept = zeroing.apply(force[6:], np.array([3]), usable[6:])
    assert swept == pytest.approx(np.ones((1, 3)))
    assert zeroing.ticks == 4
    assert zeroing.offset_m_s2 == pytest.approx(offset)


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


def recorded_vehicle(tmp_path: Path) -> config.Vehicle:
    text = (
        '[vehicle]\nname="t"\nurdf="t.urdf"\nbase="free"\nbase_link="body"\n'
        '[device.imu]\nkind="recorded_imu"\nframe="body"\nperiod_ms=1\naccel_noise_m_s2=0.1\ngyro_noise_rad_s=0.01\n'
        "[estimation]\nsmoothing_ms=50\n"
    )
    (tmp_path / "t.urdf").write_text("<robot/>")
    return config.parse(text, tmp_path / "vehicle.toml")


def imu_rows(seconds: np.ndarray, scale: float = 1e-4) -> records.Rows:
    rows = np.zeros(len(seconds), records.IMU)
    rows["host_ns"] = np.rint(seconds * 1e9)
    rows["gyro_scale_rad_s"] = rows["accel_scale_m_s2"] = scale
    rows["gyro_raw"][:, 2] = np.rint(np.sin(4 * seconds) / scale)
    rows["accel_raw"][:, 0] = np.rint(seconds / scale)
    return rows


def test_signals_are_si_smoothed_and_differentiated(tmp_path: Path) -> None:
    signals = Signals(recorded_vehicle(tmp_path))
    seconds = np.arange(0.0, 1.0, 1e-3)
    signals.append({"imu": imu_rows(seconds)})
    at_ns = np.array([300_000_000, 500_000_000])
    smoothed = signals.at("imu", Timebase({"imu": RecordedChannel(0.0)}, None), at_ns, 1)
    one_count = 1e-4
    assert smoothed.derivatives[0][:, 2] == pytest.approx(np.sin(4 * at_ns * 1e-9), abs=one_count)
    assert smoothed.derivatives[1][:, 2] == pytest.approx(4 * np.cos(4 * at_ns * 1e-9), abs=0.005)
    assert smoothed.derivatives[0][:, 3] == pytest.approx(at_ns * 1e-9, abs=one_count)
    assert (smoothed.refused == 0).all()
    assert (smoothed.sigma[0][:, 0] < 0.01).all()  # smoothing averages
    assert (smoothed.sigma[0][:, 3] < 0.1).all()


def test_a_hole_and_a_saturated_sample_refuse_the_ticks_around_them(tmp_path: Path) -> None:
    signals = Signals(recorded_vehicle(tmp_path))
    seconds = np.arange(0.0, 1.0, 1e-3)
    rows = imu_rows(seconds[(seconds < 0.3) | (seconds > 0.31)])
    rows["status"][np.searchsorted(rows["host_ns"], 600_000_000)] = records.SampleStatus.SATURATED
    signals.append({"imu": rows})
    at_ns = np.array([200, 305, 450, 610, 800]) * 1_000_000
    smoothed = signals.at("imu", Timebase({"imu": RecordedChannel(0.0)}, None), at_ns, 0)
    assert smoothed.refused.tolist() == [0, GateReason.GAP, 0, GateReason.SATURATED, 0]


def test_a_clock_that_is_not_known_yet_refuses_everything() -> None:
    signals = Signals(ROCKSAT)
    rows = np.zeros(50, records.SCALAR)
    rows["tick"] = np.arange(50)
    signals.append({"joint_1": rows})
    smoothed = signals.at("joint_1", _unlocked(), np.array([0, 1]), 2)
    assert (smoothed.refused == GateReason.NOT_SYNCHRONISED).all()
    assert np.isnan(smoothed.derivatives[2]).all()


def _unlocked() -> Timebase:
    return Timebase({"can_sync": SyncChannel(5e6, 0.0), "joint_1": FollowerChannel("can_sync")}, None)
