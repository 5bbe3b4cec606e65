"""Faults of inputs: scalars and IMUs that stick, saturate, are wrong or late; phases as reported."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.faults import NO_FAULTS, Fault, FaultyImu, FaultyScalar, reported_phases
from tests.hil_sim.devices.twin_bench import START_NS, Analog, FlatImu, StairImu
from tests.hil_sim.faults.fault_bench import S, of


def test_scalar_sticks_to_the_last_healthy_value():
    analog = FaultyScalar(Analog(lambda t: t), of(Fault("stuck", "x", 1.0, 2.0)), START_NS)
    assert [analog.value(t) for t in (0.5, 0.9, 1.0, 1.9, 2.0)] == [0.5, 0.9, 0.9, 0.9, 2.0]


def test_scalar_that_was_never_read_sticks_to_the_first_value_read():
    analog = FaultyScalar(Analog(lambda t: t), of(Fault("stuck", "x", 1.0, 2.0)), START_NS)
    assert [analog.value(t) for t in (1.5, 1.9)] == [1.5, 1.5]


@pytest.mark.parametrize(("value", "end"), [(1.0, math.inf), (0.0, math.inf), (-1.0, -math.inf)])
def test_scalar_saturates_at_either_end(value, end):
    analog = FaultyScalar(Analog(lambda t: t), of(Fault("saturated", "x", 1.0, 2.0, value)), START_NS)
    assert [analog.value(t) for t in (0.5, 1.5, 2.5)] == [0.5, end, 2.5]


def test_imu_without_faults_is_the_imu_itself():
    times_s = np.arange(1, 5) * 1e-3
    healthy = StairImu().counts(times_s, 1.0, 1.0, 0)
    assert (FaultyImu(StairImu(), NO_FAULTS, START_NS).counts(times_s, 1.0, 1.0, 0) == healthy).all()


@given(st.lists(st.integers(1, 20), min_size=1, max_size=8))
def test_imu_sticks_the_same_however_the_samples_are_batched(batches):
    faults = of(Fault("stuck", "x", 0.0105, 0.0305))
    analog, k, rows = FaultyImu(StairImu(), faults, START_NS), 1, []
    for n in batches:
        rows.append(analog.counts(np.arange(k, k + n) * 1e-3, 1.0, 1.0, 0))
        k += n
    steps = np.concatenate(rows)[:, 0]
    ms = np.arange(1, k)
    expected = np.where((ms > 10) & (ms < 31), 10, ms % 64)
    assert (steps == expected).all()


def test_imu_stuck_from_the_first_sample():
    analog = FaultyImu(StairImu(), of(Fault("stuck", "x", 0.0)), START_NS)
    assert (analog.counts(np.arange(1, 5) * 1e-3, 1.0, 1.0, 0)[:, 0] == 1).all()


def test_scalar_is_wrong_by_a_share_and_late_by_a_time():
    wrong = FaultyScalar(Analog(lambda t: t), of(Fault("wrong", "x", 1.0, 2.0, 0.5)), START_NS)
    assert [wrong.value(t) for t in (0.5, 1.0, 1.5, 2.0)] == [0.5, 1.5, 2.25, 2.0]
    late = FaultyScalar(Analog(lambda t: t), of(Fault("delayed", "x", 1.0, 2.0, 0.25)), START_NS)
    assert [late.value(t) for t in (0.5, 1.0, 1.5, 2.0)] == [0.5, 0.75, 1.25, 2.0]


def test_imu_is_late_and_wrong_and_keeps_its_temperature():
    times_s = np.arange(1, 41) * 1e-3
    late = FaultyImu(StairImu(), of(Fault("delayed", "x", 0.0105, 0.0205, 0.003)), START_NS)
    ms = np.arange(1, 41)
    expected = np.where((ms > 10) & (ms < 21), ms - 3, ms)
    assert (late.counts(times_s, 1.0, 1.0, 0)[:, 0] == expected).all()
    wrong = FaultyImu(FlatImu([10, -10, 20000, 7, 0, 2, -30000]), of(Fault("wrong", "x", 0.0, 1.0, 1.0)), START_NS)
    assert wrong.counts(times_s, 1.0, 1.0, 0)[0].tolist() == [20, -20, 32767, 7, 0, 4, -32768]


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (("stuck", 1.5, 3.5, 0.0), [(1, 4), (3.5, 6)]),
        (("wrong", 1.5, 2.5, 1.0), [(1, 4), (1.5, 5), (2, 6), (2.5, 5), (3, 6)]),
        (("delayed", 1.5, 2.5, 0.25), [(1, 4), (2.25, 5), (3, 6)]),
        (("delayed", 1.5, 2.5, 1.5), [(1, 4), (3, 6), (3.5, 5)]),
        (("silent", 1.5, 2.5, 0.0), [(1, 4), (2, 5), (3, 6)]),
    ],
)
def test_phases_are_told_as_the_input_shows_them(fault, told):
    kind, start_s, end_s, value = fault
    changes = [(START_NS + k * S, 3 + k) for k in (1, 2, 3)]
    faults = of(Fault(kind, "x", start_s, end_s, value))
    assert reported_phases(changes, faults) == [(START_NS + round(t * S), code) for t, code in told]
