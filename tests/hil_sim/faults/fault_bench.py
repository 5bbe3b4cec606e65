"""Faults of one device, an IMU twin that has them, and the errno of a transfer that fails."""

import pytest

from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.faults import FaultPlan
from tests.hil_sim.devices.twin_bench import START_NS, FlatImu, RateClock

S = 1_000_000_000


def of(*faults):
    return FaultPlan(faults, START_NS).of("x")


def imu_with(*faults):
    return Mpu6050Twin(FlatImu([1, 2, 3, 4, 5, 6, 7]), RateClock(), START_NS, faults=of(*faults))


def errno_of(device, now_ns):
    with pytest.raises(OSError) as caught:  # noqa: PT011 - the errno is what is looked at
        device.transfer(0x68, b"\x75", 1, now_ns)
    return caught.value.errno
