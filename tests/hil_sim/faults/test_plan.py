"""Faults as data: what is refused, windows, plans by device, power cycles, edges, lines of text."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.faults import EFFECTS, Fault, FaultError, FaultKind, FaultPlan, PowerCycle, parse
from tests.hil_sim.devices.twin_bench import START_NS
from tests.hil_sim.faults.fault_bench import S, of


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("melted", "x", 0.0), "No fault is called 'melted'"),
        (("off", "x", -1.0), "0 <= start_s"),
        (("off", "x", 2.0, 1.0), "0 <= start_s < end_s"),
        (("off", "x", math.nan), "0 <= start_s"),
        (("off", "x", math.inf), "0 <= start_s"),
        (("pulse_spurious", "x", 0.0), "seconds between"),
        (("error_frames", "x", 0.0), "seconds between"),
        (("intermittent", "x", 0.0, 1.0), "seconds from one"),
        (("intermittent", "x", 0.0, math.inf, 0.1), "not loose for ever"),
        (("slow", "x", 0.0), "late"),
        (("delayed", "x", 0.0, 1.0, -0.1), "delay in seconds, of 0.0001 or more"),
        (("wrong", "x", 0.0), "how wrong it is, other than 0"),
        (("clock_jump", "x", 0.0), "the jump in seconds"),
        (("flood", "x", 0.0, 1.0, 0x800), "COB-ID"),
        (("byte_loss", "x", 0.0, 1.0, 1.5), "probability"),
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


def test_a_fault_is_read_from_a_line() -> None:
    assert parse("off:imu_base:10:12") == Fault(FaultKind.OFF, "imu_base", 10.0, 12.0)
    assert parse("wrong:joint_1:3::-0.5") == Fault(FaultKind.WRONG, "joint_1", 3.0, math.inf, -0.5)
    assert parse("reset:load_cell:3") == Fault(FaultKind.RESET, "load_cell", 3.0)
    assert set(EFFECTS) == set(FaultKind)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stick:imu_base:1:2", "did you mean stuck"),
        ("off", "KIND:DEVICE:START:END"),
        ("off:imu_base", "KIND:DEVICE:START:END"),
        ("off::1:2", "KIND:DEVICE:START:END"),
        ("off:imu_base:soon:2", "KIND:DEVICE:START:END"),
        ("off:imu_base:1:2:3:4", "KIND:DEVICE:START:END"),
        ("off:imu_base:nan:2", "KIND:DEVICE:START:END"),
        ("off:imu_base:2:1", "0 <= start_s < end_s"),
        ("off:imu_base:1:nan", "0 <= start_s < end_s"),
        ("wrong:imu_base:1:2:inf", "a `value` between"),
        ("frame_drop:can_0:1:2:nan", "a `value` between"),
        ("intermittent:can_0:1:2:1e-9", "0.0001 or more"),
    ],
)
def test_a_line_that_is_no_fault_is_refused_with_the_remedy(text: str, said: str) -> None:
    with pytest.raises(FaultError, match=said):
        parse(text)
