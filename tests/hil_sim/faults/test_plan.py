"""Faults as data: what is refused, windows, plans by device, power cycles, edges, lines of text.

Faults of inputs: scalars and IMUs that stick, saturate, are wrong or late; phases as reported.

Faults of connectors and clocks.
"""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.faults import (
    EFFECTS,
    NEVER,
    NO_FAULTS,
    Fault,
    FaultError,
    FaultKind,
    FaultPlan,
    FaultyClock,
    FaultyImu,
    FaultyScalar,
    PowerCycle,
    parse,
    reported_phases,
)
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, FlatImu, RateClock, StairImu
from tests.hil_sim.faults.fault_bench import S, of


def test_a_loose_connector_is_open_for_half_of_each_period():
    faults = of(Fault("intermittent", "x", 1.0, 1.25, 0.1), Fault("silent", "x", 2.0, 3.0))
    away = [(1.0, 1.05), (1.1, 1.15), (1.2, 1.25), (2.0, 3.0)]
    assert faults.absences() == [(START_NS + round(a * S), START_NS + round(b * S)) for a, b in away]


@given(st.integers(0, 400))
def test_is_away_says_what_absences_say(at):
    faults = of(Fault("intermittent", "x", 0.1, 0.25, 0.07), Fault("silent", "x", 0.3, 0.35))
    now_ns = START_NS + at * MS
    assert faults.is_away(now_ns) == any(a <= now_ns < b for a, b in faults.absences())


def clock_with(*faults):
    return FaultyClock(RateClock(0.0), of(*faults))


def test_a_clock_stands_still_or_is_put_forward():
    still = clock_with(Fault("clock_jump", "x", 1.0, 2.0, -0.25))
    assert [still.chip_ns(START_NS + t) for t in (S, 5 * S // 4, 2 * S)] == [S, S, 7 * S // 4]
    assert still.time_ns(S + 1) == START_NS + 5 * S // 4 + 1
    ahead = clock_with(Fault("clock_jump", "x", 1.0, 2.0, 0.25))
    assert [ahead.chip_ns(START_NS + t) for t in (S - 1, S, 2 * S)] == [S - 1, 5 * S // 4, 9 * S // 4]
    assert {ahead.time_ns(t) for t in (S, S + 1, 5 * S // 4)} == {START_NS + S}


def test_a_slow_clock_loses_its_share():
    slow = clock_with(Fault("slow", "x", 1.0, 2.0, 0.2))
    assert [slow.chip_ns(START_NS + t) for t in (S, 2 * S, 3 * S)] == [S, 18 * S // 10, 28 * S // 10]
    np.testing.assert_allclose(slow.times_s(np.array([0.5e9, 1.4e9, 2.8e9])), [0.5, 1.5, 3.0])


@given(st.lists(st.integers(0, 4000), min_size=1, max_size=20))
def test_a_faulty_clock_is_monotone_and_its_inverse_is_one(at_ms):
    clock = clock_with(
        Fault("clock_jump", "x", 0.5, 9, 0.1), Fault("slow", "x", 1.0, 2.0, 0.3), Fault("clock_jump", "x", 2.5, 9, -0.2)
    )
    shown = [clock.chip_ns(START_NS + t * MS) for t in sorted(at_ms)]
    assert shown == sorted(shown)
    for value in shown:
        assert abs(clock.chip_ns(clock.time_ns(value)) - value) <= 2
    times = clock.times_s(np.array(shown, np.float64))
    np.testing.assert_allclose(times, [(clock.time_ns(v) - START_NS) * 1e-9 for v in shown], atol=1e-8)


@pytest.mark.parametrize(
    "faults",
    [
        [Fault("slow", "x", 1.0, 2.0, 1.5)],
        [Fault("slow", "x", 1.0, 2.0, 0.5), Fault("clock_jump", "x", 1.5, 9.0, 0.1)],
    ],
)
def test_a_clock_that_cannot_be_is_refused(faults):
    with pytest.raises(FaultError):
        clock_with(*faults)


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


class ManyAnalog(Analog):
    """One that can be asked for many instants at once."""

    def values(self, times_s):
        return np.array([self.value(time_s) for time_s in times_s.tolist()])


@given(
    st.lists(
        st.tuples(st.sampled_from(["wrong", "delayed", "slipped", "saturated", "stuck"]), st.integers(0, 40)),
        min_size=1,
        max_size=4,
        unique_by=lambda one: one[0],
    ),
    st.lists(st.integers(1, 20), min_size=1, max_size=8),
)
def test_scalar_reads_the_same_however_the_times_are_batched(drawn, batches):
    faults = of(*(Fault(kind, "x", 0.01 * start, 0.01 * start + 0.11, 0.02) for kind, start in drawn))
    many, each = (FaultyScalar(ManyAnalog(math.cos), faults, START_NS) for _ in range(2))
    k = 0
    for n in batches:
        times_s = 0.005 * np.arange(k, k + n)
        assert many.values(times_s).tolist() == [each.value(time_s) for time_s in times_s.tolist()]
        k += n


@pytest.mark.parametrize(
    ("now_s", "until_s"), [(0.0, 1.0), (0.999, 1.0), (1.0, 1.0), (1.5, 1.5), (2.0, 4.0), (3.0, 4.0), (5.0, math.inf)]
)
def test_it_is_quiet_until_the_next_fault_of_another_kind(now_s, until_s):
    faults = of(Fault("stuck", "x", 1.0, 2.0), Fault("wrong", "x", 2.5, 9.0, 0.1), Fault("silent", "x", 4.0, 5.0))
    until_ns = NEVER if until_s == math.inf else START_NS + round(1e9 * until_s)
    assert faults.quiet_until(START_NS + round(1e9 * now_s), FaultKind.WRONG) == until_ns


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


def test_an_angle_has_slipped_by_so_many_degrees():
    slipped = FaultyScalar(Analog(lambda t: t), of(Fault("slipped", "x", 1.0, 2.0, -90.0)), START_NS)
    assert [slipped.value(t) for t in (0.5, 1.0, 1.5, 2.0)] == [0.5, 1.0 - np.pi / 2, 1.5 - np.pi / 2, 2.0]


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
        (("intermittent", "x", 0.0, 1.0), "seconds from interruption"),
        (("intermittent", "x", 0.0, math.inf, 0.1), "not loose for ever"),
        (("slow", "x", 0.0), "late"),
        (("delayed", "x", 0.0, 1.0, -0.1), "delay in seconds, of 0.0001 or more"),
        (("wrong", "x", 0.0), "how wrong it is, other than 0"),
        (("slipped", "x", 0.0), "the degrees it slips by, other than 0"),
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
