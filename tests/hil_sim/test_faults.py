"""Faults as data."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.faults import NO_FAULTS, Fault, FaultError, FaultKind, FaultPlan, FaultyImu, FaultyScalar, PowerCycle
from tests.hil_sim.twin_bench import START_NS, Analog, StairImu

S = 1_000_000_000


def of(*faults):
    return FaultPlan(faults, START_NS).of("x")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("melted", "x", 0.0), "No fault is called 'melted'"),
        (("off", "x", -1.0), "0 <= start_s"),
        (("off", "x", 2.0, 1.0), "0 <= start_s < end_s"),
        (("off", "x", math.nan), "0 <= start_s"),
        (("off", "x", math.inf), "0 <= start_s"),
        (("pulse_spurious", "x", 0.0), "seconds between"),
        (("who_am_i", "x", 0.0, 1.0, 256), "0 to 255"),
    ],
)
def test_nonsense_is_refused(arguments, message):
    with pytest.raises(FaultError, match=message):
        Fault(*arguments)


def test_a_kind_may_be_written_as_its_name():
    assert Fault("stuck", "x", 1.0).kind is FaultKind.STUCK


def test_window_is_half_open():
    faults = of(Fault("nack", "x", 1.0, 2.0))
    active = [faults.active(FaultKind.NACK, START_NS + t) is not None for t in (S - 1, S, 2 * S - 1, 2 * S)]
    assert active == [False, True, True, False]
    assert faults.active(FaultKind.OFF, START_NS + S) is None


def test_without_end_it_lasts():
    assert of(Fault("nack", "x", 1.0)).active(FaultKind.NACK, START_NS + 10**15) is not None


def test_plan_hands_out_by_name_and_misses_nobody():
    plan = FaultPlan([Fault("off", "imu", 1.0), Fault("off", "arm", 1.0), Fault("nack", "imu", 3.0)], START_NS)
    assert len(plan.of("imu").windows) == 2
    assert not plan.of("load_cell")
    with pytest.raises(FaultError, match="No device is called arm; devices here are: imu, load_cell"):
        plan.check_all_taken()
    assert len(plan.of("arm").windows) == 1
    plan.check_all_taken()


def test_power_cycles_in_order():
    faults = of(Fault("reset", "x", 3.0), Fault("off", "x", 1.0, 2.0), Fault("stuck", "x", 0.0))
    assert faults.power_cycles() == [
        PowerCycle(START_NS + S, START_NS + 2 * S),
        PowerCycle(START_NS + 3 * S, START_NS + 3 * S),
    ]
    with pytest.raises(FaultError, match="overlap"):
        of(Fault("off", "x", 1.0, 5.0), Fault("reset", "x", 3.0)).power_cycles()


@given(
    start=st.integers(0, 50),
    length=st.integers(1, 60),
    step=st.integers(1, 20),
    cuts=st.lists(st.integers(0, 150), max_size=6),
)
def test_spurious_edges_are_the_same_however_time_is_cut(start, length, step, cuts):
    faults = of(Fault("pulse_spurious", "x", start * 1e-3, (start + length) * 1e-3, step * 1e-3))
    expected = [START_NS + ms * 10**6 for ms in range(start, start + length, step)]
    ends = [START_NS - 1, *(START_NS + ms * 10**6 for ms in sorted(cuts)), START_NS + 200 * 10**6]
    found = [t for a, b in itertools.pairwise(ends) for t in faults.spurious_edges(a, b)]
    assert found == expected


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
