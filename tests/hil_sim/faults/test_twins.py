"""Faults in the twins: IMU, CANopen nodes, arm controller, sync box and sync line."""

import errno
import math

import pytest

from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.devices.sync.sync_line import EdgeCapture
from hil_sim.faults import Fault, FaultError
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig, RateClock
from tests.hil_sim.faults.fault_bench import S, errno_of, imu_with, of


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
