"""The MPU-6050 twin with faults: supply, acknowledge, identity, inputs, FSYNC."""

import errno

import numpy as np
import pytest

from hil_sim.faults import Fault, FaultKind
from tests.hil_sim.devices.mpu6050_bench import Bench, plan
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu


def test_a_brown_out_brings_the_reset_values_back():
    bench = Bench(faults=plan(Fault(FaultKind.RESET, "imu", 0.05))).wake()
    bench.write("ACCEL_CONFIG", 0x08)
    bench.start_fifo()
    bench.wait(49)
    assert bench.fill() == 49 * 14
    bench.wait(3)
    assert bench.read("PWR_MGMT_1") == b"\x40"
    assert bench.read("ACCEL_CONFIG") == b"\x00"
    assert bench.fill() == 0
    assert bench.chip.produced in (49, 50)  # made before the supply dipped; nobody can have them


def test_without_supply_nothing_acknowledges():
    bench = Bench(faults=plan(Fault(FaultKind.OFF, "imu", 0.01, 0.02))).wake()
    bench.wait(15)
    with pytest.raises(OSError, match="Remote") as caught:
        bench.read("WHO_AM_I")
    assert caught.value.errno == errno.EREMOTEIO
    bench.wait(10)
    assert bench.read("PWR_MGMT_1") == b"\x40"
    assert max(bench.analog.times_s, default=0) <= 0.010


def test_nack_carries_its_errno():
    bench = Bench(faults=plan(Fault(FaultKind.NACK, "imu", 0.0, 0.01, errno.ETIMEDOUT)))
    with pytest.raises(OSError, match="timed out") as caught:
        bench.read("WHO_AM_I")
    assert caught.value.errno == errno.ETIMEDOUT
    assert bench.wait(10).read("WHO_AM_I") == b"\x68"


def test_wrong_who_am_i():
    bench = Bench(faults=plan(Fault(FaultKind.WHO_AM_I, "imu", 0.0, value=0x98)))
    assert bench.read("WHO_AM_I") == b"\x98"


def test_stuck_and_saturated():
    faults = plan(Fault("stuck", "imu", 0.010, 0.020), Fault("saturated", "imu", 0.030, 0.040, -1))
    bench = Bench(faults=faults).wake()
    bench.start_fifo()
    bench.wait(50)
    words = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, 7)
    steps = words[:, 0]
    assert steps[8] == 9  # sample k is made at k ms
    assert (steps[9:19] == 9).all()
    assert steps[19] == 20
    assert (words[29:39][:, [0, 1, 2, 4, 5, 6]] == -32768).all()
    assert (words[29:39, 3] == 300 + np.arange(30, 40)).all()


def test_stuck_holds_across_batches():
    bench = Bench(faults=plan(Fault("stuck", "imu", 0.010))).wake()
    for _ in range(5):
        bench.wait(7)
        last = bench.words()[0]
    assert last == 9


def test_dropped_and_spurious_fsync():
    faults = plan(Fault("pulse_drop", "imu", 0.0, 0.010), Fault("pulse_spurious", "imu", 0.0152, 0.0252, 0.005))
    bench = Bench(FlatImu([0] * 7), faults=faults).wake()
    bench.write("CONFIG", 0x0A)
    bench.start_fifo(0x80)
    bench.chip.fsync(START_NS + 5 * MS, 300_000)
    bench.wait(30)
    marks = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2")
    assert (np.flatnonzero(marks) + 1).tolist() == [16, 21]
