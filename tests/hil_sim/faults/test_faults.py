"""Faults as data."""

import errno
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.buses.media import CanBus, I2cBus
from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.can_wire import Babbler, CanWire
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.devices.sync.sync_line import EdgeCapture
from hil_sim.faults import (
    EFFECTS,
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
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig, FlatImu, RateClock, StairImu

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


# Inputs


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


# Connectors and clocks


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


# Twins


def imu_with(*faults):
    return Mpu6050Twin(FlatImu([1, 2, 3, 4, 5, 6, 7]), RateClock(), START_NS, faults=of(*faults))


def errno_of(device, now_ns):
    with pytest.raises(OSError) as caught:  # noqa: PT011 - the errno is what is looked at
        device.transfer(0x68, b"\x75", 1, now_ns)
    return caught.value.errno


def test_imu_faults_on_its_bus():
    assert errno_of(imu_with(Fault("timeout", "x", 0.0, 1.0)), START_NS) == errno.ETIMEDOUT
    loose = imu_with(Fault("intermittent", "x", 0.0, 1.0, 0.2))
    assert errno_of(loose, START_NS + 50 * MS) == errno.EREMOTEIO
    assert loose.transfer(0x68, b"\x75", 1, START_NS + 150 * MS) == b"\x68"
    reads = [
        [twin.transfer(0x68, b"\x75", 1, START_NS + k * MS)[0] for k in range(20)]
        for twin in (imu_with(Fault("garbage", "x", 0.0, 0.01)) for _ in range(2))
    ]
    assert reads[0] == reads[1]  # the same garbage in every run
    assert len(set(reads[0][:10])) > 5
    assert reads[0][10:] == [0x68] * 10


def test_a_timeout_makes_the_transfer_all_the_same():
    imu = imu_with(Fault("timeout", "x", 0.0, 1.0))
    with pytest.raises(TimeoutError):
        imu.transfer(0x68, b"\x19\x07", 0, START_NS)
    assert imu.transfer(0x68, b"\x19", 1, START_NS + S) == b"\x07"


def test_an_imu_that_stands_still_makes_no_samples():
    imu = imu_with(Fault("clock_jump", "x", 1.0, 2.0, -0.3))
    for register, value in ((0x6B, 0x01), (0x1A, 0x02), (0x23, 0xF8), (0x6A, 0x40)):
        imu.transfer(0x68, bytes([register, value]), 0, START_NS)
    made = []
    for ms in (1000, 1299, 2000):
        imu.advance(START_NS + ms * MS)
        made.append(imu.produced)
    assert made == [1000, 1000, 1700]
    with pytest.raises(FaultError, match="counts samples"):
        imu_with(Fault("clock_jump", "x", 1.0, 2.0, 0.3))


def test_samples_of_a_chip_that_was_reset_are_counted_at_the_rate_of_the_flight():
    imu = imu_with(Fault("reset", "x", 1.0))
    for start_ms in (0, 1100):
        for register, value in ((0x6B, 0x01), (0x1A, 0x02), (0x23, 0xF8), (0x6A, 0x40)):
            imu.transfer(0x68, bytes([register, value]), 0, START_NS + start_ms * MS)
        imu.advance(START_NS + (start_ms + 900) * MS)
    assert abs(imu.sampled - 2000) <= 1


def operational(node):
    rig = CanRig(node)
    rig.run(200)
    rig.send(0x000, 1, 0)
    rig.run(1)
    return rig


def answers(rig, cob_id, syncs=4):
    found = []
    for _ in range(syncs):
        rig.send(0x080, 1)
        found.append([f for f in rig.run(5) if f.identifier == cob_id])
    return found


def test_a_node_that_is_slow_answers_late():
    slow = operational(LoadCell404(2, Analog(lambda t: 1.0), START_NS, faults=of(Fault("slow", "x", 0.0, 9.0, 0.003))))
    well = operational(LoadCell404(2, Analog(lambda t: 1.0), START_NS))
    for late, in_time in zip(answers(slow, 0x182), answers(well, 0x182), strict=True):
        assert [f.data for f in late] == [f.data for f in in_time]
        assert late[0].end_ns - in_time[0].end_ns == 3 * MS


def test_a_node_full_of_garbage_keeps_the_form():
    faults = of(Fault("garbage", "x", 0.0, 9.0))
    frames = [
        f
        for fs in answers(operational(LoadCell404(2, Analog(lambda t: 1.0), START_NS, faults=faults)), 0x182)
        for f in fs
    ]
    assert [len(f.data) for f in frames] == [5] * 4
    assert len({f.data for f in frames}) == 4


def test_encoder_and_load_cell_take_input_faults_and_the_encoder_has_no_end():
    faults = of(Fault("wrong", "x", 0.0, 9.0, 1.0))
    assert Encoder406(1, Analog(lambda t: math.tau), START_NS, faults=faults).position(START_NS) == 1_000_000
    assert LoadCell404(2, Analog(lambda t: 1.5), START_NS, faults=faults).process_value(START_NS) == 30_000
    with pytest.raises(FaultError, match="cannot have the fault saturated"):
        Encoder406(1, Analog(lambda t: 0.0), START_NS, faults=of(Fault("saturated", "x", 0.0)))


def test_arm_controller_tells_the_phase_that_its_input_shows():
    arm = ArmController(3, [(0.5, 4), (0.6, 5)], START_NS, faults=of(Fault("wrong", "x", 0.5, 9.0, 2.0)))
    told = [f.data[0] for f in operational(arm).run(800) if f.identifier == 0x183]
    assert told == [6, 7]


def box_with(*faults):
    rig = CanRig(SyncBox(RateClock(), START_NS, faults=of(*faults)))
    return [(f.end_ns, f.data) for f in rig.run(100)]


def test_sync_box_faults():
    healthy = box_with()
    counters = [data[0] for _, data in healthy]
    assert counters == list(range(1, 21))
    ahead = [data[0] for _, data in box_with(Fault("clock_jump", "x", 0.05, 9.0, 0.025))]
    assert ahead == [*range(1, 11), *range(16, 26)]
    still = [data[0] for _, data in box_with(Fault("clock_jump", "x", 0.05, 9.0, -0.025))]
    assert still == list(range(1, 16))
    assert len(box_with(Fault("slow", "x", 0.0, 9.0, 0.5))) == 10
    assert [data[0] for _, data in box_with(Fault("wrong", "x", 0.05, 9.0, 7.0))] == [*range(1, 11), *range(18, 28)]
    assert len({data for _, data in box_with(Fault("garbage", "x", 0.0, 9.0))}) > 15
    assert len(box_with(Fault("intermittent", "x", 0.0, 0.1, 0.02))) == 10


def test_sync_line_faults():
    def stamps(*faults):
        line = EdgeCapture(1, jitter_ns=0)
        line.inject(of(*faults))
        for ms in range(0, 100, 10):
            line.edge(START_NS + ms * MS, 300_000)
        line.advance(START_NS)
        return [stamp - START_NS for stamp, _ in line.advance(START_NS + S)]

    assert stamps() == [3_000 + ms * MS for ms in range(0, 100, 10)]
    assert stamps(Fault("delayed", "x", 0.05, 0.06, 0.002))[5] == 3_000 + 52 * MS
    assert len(stamps(Fault("intermittent", "x", 0.0, 0.1, 0.04))) == 4
    assert 12 < len(stamps(Fault("garbage", "x", 0.1, 0.6, 50.0))) - 10 < 40


# Wires


class Link:
    """The flight computer's CAN interface as two lists."""

    listening = True

    def __init__(self):
        self.sent, self.frames, self.errors = [], [], []

    def take(self):
        sent, self.sent = self.sent, []
        return sent

    def give(self, frames):
        self.frames += frames

    def give_error(self, end_ns, classes):
        self.errors.append((end_ns, classes))


def can_with(*faults, until_ms=100):
    link = Link()
    bus = CanBus(link, latency_ns=0, jitter_ns=0)
    bus.add(SyncBox(RateClock(), START_NS))
    bus.inject(of(*faults))
    for ms in range(1, until_ms + 1):
        bus.advance(START_NS + ms * MS)
    return bus, link


def test_bus_off_cuts_both_ways_and_says_so():
    bus, link = can_with(Fault("bus_off", "x", 0.02, 0.06))
    assert len(link.frames) == 12
    assert bus.dropped == 8
    assert bus.heard[0x080] == 20
    assert link.errors == [(START_NS + 20 * MS, 0x040), (START_NS + 60 * MS, 0x100)]
    cut, well = (can_with(*faults)[0] for faults in ((Fault("bus_off", "x", 0.0, 9.0),), ()))
    for bus in cut, well:
        bus._link.sent.append((0x000, b"\x01\x00"))
        bus.advance(START_NS + 110 * MS)
    assert well.due_ns == cut.due_ns


def test_error_frames_lose_nothing():
    bus, link = can_with(Fault("error_frames", "x", 0.02, 0.06, 0.01))
    assert link.errors == [(START_NS + ms * MS, 0x088) for ms in (20, 30, 40, 50)]
    assert len(link.frames) == 20
    assert bus.errors == 4


def test_a_bus_that_delays_keeps_the_order():
    _, link = can_with(Fault("delayed", "x", 0.02, 0.04, 0.012))
    assert [frame.data[0] for frame in link.frames] == list(range(1, 21))
    times = [frame.end_ns - START_NS - 5 * MS * k for k, frame in enumerate(link.frames)]
    assert [time // MS for time in times] == [0] * 4 + [12] * 4 + [7, 2] + [0] * 10


def test_a_loose_connector_of_the_flight_computer_loses_half():
    bus, link = can_with(Fault("intermittent", "x", 0.0, 0.1, 0.02))
    assert len(link.frames) == bus.dropped == 10


@pytest.mark.parametrize(("identifier", "heard"), [(0x001, 12), (0x7F0, 20)])
def test_a_flood_starves_what_has_less_priority_and_nothing_else(identifier, heard):
    bus, link = can_with(Fault("flood", "x", 0.019, 0.059, identifier))
    assert bus.heard[0x080] == heard + (identifier == 0x001)  # the newest of those that waited comes in the end
    assert bus.heard[identifier] > 0.85 * 40e6 / 250e3
    assert [f.identifier for f in link.frames if f.identifier == identifier and f.end_ns > START_NS + 61 * MS] == []


def test_a_babbler_leaves_no_room():
    wire = CanWire()
    wire.add(Babbler(0x123, START_NS, START_NS + S), lambda identifier: True)
    frames = wire.advance(START_NS + 100 * MS)
    steps = np.diff([frame.end_ns for frame in frames])
    assert set(steps.tolist()) == {steps[0]}
    assert wire.overwritten[0x123] <= 1


def test_i2c_bus_faults():
    bus = I2cBus()
    bus.add(imu_with())
    bus.inject(
        of(
            Fault("stuck_bus", "x", 0.0, 1.0),
            Fault("timeout", "x", 1.0, 2.0),
            Fault("intermittent", "x", 2.0, 3.0, 0.2),
        )
    )
    found = [errno_of(bus, START_NS + t * MS) for t in (500, 1500, 2050)]
    assert found == [errno.EBUSY, errno.ETIMEDOUT, errno.EREMOTEIO]
    assert bus.transfer(0x68, b"\x75", 1, START_NS + 2150 * MS) == b"\x68"
    assert bus.refused == 3


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
