"""Signals of the page: no peak is left out, however long the flight, and nothing is added."""

import numpy as np
import pytest

from drivers import records
from onboard import channels
from onboard.estimation.gates import GateReason
from onboard.page import signals
from onboard.page.signals import PageSignals
from tests.page.made import SECOND, START


def imu(count: int, rng: np.random.Generator) -> records.Rows:
    rows = np.zeros(count, records.IMU)
    rows["host_ns"] = START + np.cumsum(rng.integers(0, 20_000_000, count))
    rows["accel_raw"], rows["gyro_raw"] = rng.integers(-30000, 30000, (2, count, 3))
    rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = 6e-4, 1e-3
    return rows


@pytest.mark.parametrize("count", [1, 500, 60_000])
def test_each_step_has_the_lowest_and_highest_sample_of_its_time(count: int, rng: np.random.Generator) -> None:
    found, rows = PageSignals(), imu(count, rng)
    for part in np.array_split(rows, max(1, count // 97)):
        found.add("imu_0", part)
    assert found.names() == ["imu_0 rate", "imu_0 specific force"]
    told = found.of("imu_0 rate", START)
    assert 1 <= len(told["points"]) <= signals.STEPS
    assert (told["every_s"] > 0.05) == (count == 60_000)
    points = np.array(told["points"])
    every_ns = round(told["every_s"] * 1e9)
    steps = rows["host_ns"] // every_ns
    assert points[:, 0] == pytest.approx((np.unique(steps) * every_ns - START) * 1e-9, abs=1e-3)
    for axis in range(3):
        rate = rows["gyro_raw"][:, axis] * 1e-3
        for number, step in enumerate(np.unique(steps)):
            its = rate[steps == step]
            assert points[number, 1 + 2 * axis : 3 + 2 * axis] == pytest.approx([its.min(), its.max()], rel=1e-5)


def test_samples_that_are_not_valid_or_no_numbers_are_left_out() -> None:
    found, rows = PageSignals(), np.zeros(4, records.SCALAR)
    rows["host_ns"], rows["value_raw"], rows["scale"] = START, [1, 2, 900, 3], [1.0, 1.0, 1.0, np.nan]
    rows["unit"], rows["status"][2] = b"N", records.SampleStatus.NOT_VALID
    found.add("load_cell", rows[2:])
    assert found.names() == []
    found.add("load_cell", rows)
    assert found.of("load_cell", START)["points"] == [[0.0, 1.0, 2.0]]
    found.add("can_sync", np.zeros(3, records.CAN_SYNC))
    found.add("phase", np.array(rows[:1], records.SCALAR))
    assert found.names() == ["load_cell", "phase"]
    with pytest.raises(KeyError):
        found.of("can_sync", START)


def test_share_of_the_regression_s_lines_that_is_used_or_contradicts() -> None:
    found, rows = PageSignals(), np.zeros(3, channels.row_dtype(4, 1))
    rows["host_ns"] = START + np.arange(3) * SECOND
    rows["gate"] = [
        [0, 0, 0, 0],
        [0, GateReason.RESIDUAL, GateReason.LEFT_OUT | GateReason.GAP, 0],
        [GateReason.PHASE] * 4,
    ]
    rows["innovation"] = [[1.5, np.nan, np.nan, -0.5], [2.5, -9.0, np.nan, np.nan], [np.nan] * 4]
    found.add("estimator", rows)
    joint = np.ones(1, records.SCALAR)
    joint["status"], joint["unit"] = 0, b"rad"
    found.add("joint_1", joint)
    lines = [f"innovation line {number}" for number in (1, 2, 4)]  # nothing was compared in the third
    assert found.names() == ["joint_1", "estimator rows", *lines]
    told = [found.of(name, START) for name in lines]
    assert {one["unit"] for one in told} == {"sigma"}
    assert [one["points"] for one in told] == [[[0, 1.5, 1.5], [1, 2.5, 2.5]], [[1, -9, -9]], [[0, -0.5, -0.5]]]
    told = found.of("estimator rows", START)
    assert (told["unit"], told["components"]) == ("%", ("used", "contradicting"))
    assert told["points"] == [[0, 100, 100, 0, 0], [1, 50, 50, 50, 50], [2, 0, 0, 0, 0]]


def test_a_clock_that_steps_back_keeps_the_order() -> None:
    found, rows = PageSignals(), np.zeros(3, records.SCALAR)
    rows["host_ns"], rows["value_raw"], rows["scale"] = [START + SECOND, START, START + 2 * SECOND], [1, 5, 2], 1.0
    found.add("joint_1", rows)
    assert found.of("joint_1", START)["points"] == [[1.0, 1.0, 5.0], [2.0, 2.0, 2.0]]


def test_prediction_errors_are_shown_in_their_sigmas() -> None:
    found, rows = PageSignals(), np.zeros(4, channels.INNOVATION)
    rows["host_ns"], rows["sigma"] = START, [[0.5] * 3 + [2.0] * 3] * 3 + [[np.nan] * 6]
    rows["error"][:3] = [[0.1, 0, 0, 0, 0, -3.0], [-2.0, 0, 0, 0, 0, 1.0], [0.1, 0, 0, 0, 0, 0]]
    found.add("innovation", rows)
    assert found.names() == ["innovation rate", "innovation specific force"]
    told = found.of("innovation rate", START)
    assert (told["unit"], told["components"]) == ("sigma", ("x", "y", "z"))
    assert told["points"][0][1:3] == pytest.approx([-4.0, 0.2])
    assert found.of("innovation specific force", START)["points"][0][5:] == pytest.approx([-1.5, 0.5])
