"""The small parts of the flight app: history, phases, zeroing, publisher, roles."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import records
from drivers.records import Batch, Severity, event
from onboard import config
from onboard.config.estimation import Estimation
from onboard.config.methods import METHODS
from onboard.estimation.gates import GateReason
from onboard.flight.acquire.publisher import Publisher, joined
from onboard.flight.estimate.phases import PhaseTrack
from onboard.flight.estimate.readings.at_ticks import side_by_side
from onboard.flight.estimate.readings.history import History
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.flight.estimate.readings.zeroing import Temperatures, Zeroing
from onboard.identification.quantities import Findings
from onboard.ring import RingReader, RingWriter
from onboard.timebase.timebase import RecordedChannel, Timebase
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


def test_the_roles_of_a_mixed_vehicle(tmp_path: Path) -> None:
    roles = roles_of(mixed_vehicle(tmp_path))
    wrist = tuple(f"wrist_{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz")
    imus = [("imu_base",), ("imu_elbow",), ("imu_tip",), wrist, ("imu_hand",), ("imu_foot",)]
    assert [imu.channels for imu in roles.imus] == imus
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
        "joint_9": "wrist_9",
        "joint_10": "knee",
        "joint_11": "hip",
    }
    assert [cell.name for cell in roles.cells] == [
        "load_cell",
        "cell",
        "grip",
        "flange",
        "hand",
        "palm",
        "finger",
        "bridge",
        "wing",
        "wrist_force",
        "thumb",
    ]
    assert roles.signals.keys() == {"imu_base", "imu_elbow", "imu_tip", "imu_hand", "imu_foot", *wrist} | {
        j.channel for j in roles.joints
    } | {cell.channel for cell in roles.cells}


def test_the_parts_of_an_imu_stand_side_by_side(tmp_path: Path) -> None:
    signals = SignalSmoother(mixed_vehicle(tmp_path))
    names = roles_of(mixed_vehicle(tmp_path)).imus[3].channels
    for place, name in enumerate(names):
        rows = scalar_rows(100 * (place + 1), 0.01, b"rad/s" if "gyro" in name else b"m/s^2")
        signals.append({name: rows if place else rows[rows["tick"] < 300_000_000]})
    smoothed = side_by_side(signals.each(names, recorded(*names), np.array([150, 350]) * 1_000_000, 1))
    assert smoothed.derivatives[0][0] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert smoothed.sigma[1].shape == (2, 6)
    assert smoothed.refused.tolist() == [0, GateReason.GAP]


def test_every_method_of_the_vehicle_file_has_an_estimator_that_flies() -> None:
    named = get_args(Estimation.model_fields["method"].annotation)
    assert len(named) >= 2
    assert set(METHODS) == set(named)


@pytest.mark.parametrize(("kelvin", "said"), [(8.0, ("imu_base is 8 K warmer than at first",)), (3.0, ()), (120.0, ())])
def test_an_imu_that_has_warmed_is_named_before_what_speaks_against_all_answers(
    kelvin: float, said: tuple[str, ...]
) -> None:
    rows = np.zeros(5, records.IMU)
    temperatures = Temperatures(roles_of(ROCKSAT).imu)
    for counts in (-17_000, round(340.0 * kelvin) - 17_000):
        rows["temperature_raw"] = counts
        temperatures.append({"imu_base": rows}, lambda _, rows: rows["tick"].astype(np.int64))
    assert temperatures.noted(Findings(("it swings",))).against == (*said, "it swings")
    assert temperatures.noted(Findings((), ("noisy",))) == Findings((), ("noisy",))
