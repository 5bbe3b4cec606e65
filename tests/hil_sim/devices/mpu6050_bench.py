"""An MPU-6050 twin and a master that names its registers."""

import numpy as np

from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.faults import FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, RateClock, StairImu

AD = 0x68
REGISTER = {
    "SMPLRT_DIV": 0x19,
    "CONFIG": 0x1A,
    "GYRO_CONFIG": 0x1B,
    "ACCEL_CONFIG": 0x1C,
    "FIFO_EN": 0x23,
    "INT_PIN_CFG": 0x37,
    "INT_STATUS": 0x3A,
    "ACCEL_XOUT_H": 0x3B,
    "USER_CTRL": 0x6A,
    "PWR_MGMT_1": 0x6B,
    "PWR_MGMT_2": 0x6C,
    "FIFO_COUNT_H": 0x72,
    "FIFO_COUNT_L": 0x73,
    "FIFO_R_W": 0x74,
    "WHO_AM_I": 0x75,
}


class Bench:
    """A chip and a master that names registers."""

    def __init__(self, analog=None, rate_error=0.0, **options):
        self.analog = analog or StairImu()
        self.clock = RateClock(rate_error)
        self.chip = Mpu6050Twin(self.analog, self.clock, START_NS, **options)
        self.now_ns = START_NS

    def wait(self, ms):
        self.now_ns += round(ms * MS)
        return self

    def write(self, name, *values):
        self.chip.transfer(AD, bytes([REGISTER.get(name, name), *values]), 0, self.now_ns)

    def read(self, name, count=1):
        return self.chip.transfer(AD, bytes([REGISTER.get(name, name)]), count, self.now_ns)

    def wake(self):
        self.write("PWR_MGMT_1", 0x01)
        self.write("CONFIG", 0x02)  # 1 kHz
        return self

    def start_fifo(self, sensors=0xF8):
        self.write("FIFO_EN", sensors)
        self.write("USER_CTRL", 0x00)
        self.write("USER_CTRL", 0x04)
        self.write("USER_CTRL", 0x40)

    def fill(self):
        return int.from_bytes(self.read("FIFO_COUNT_H", 2), "big")

    def words(self):
        return np.frombuffer(self.read("ACCEL_XOUT_H", 14), ">i2")


def plan(*faults):
    return FaultPlan(faults, START_NS).of("imu")
