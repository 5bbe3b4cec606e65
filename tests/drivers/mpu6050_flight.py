"""A simulated MPU-6050, its driver, and the settings that the driver writes."""

import numpy as np

from drivers.mpu6050 import Mpu6050
from tests.drivers.batches import whole
from tests.drivers.mpu6050_model import MS, Mpu6050Model

NAME = "imu_base"


def numbers(rows: np.ndarray) -> np.ndarray:
    """The sample numbers that the model wrote into the rows."""
    return rows["accel_raw"][:, 0].astype(int) | rows["accel_raw"][:, 1].astype(int) << 14


class Flight:
    """A chip, its driver, and all batches so far, stepped on a grid of polls."""

    def __init__(self, clock, config=None, **chip) -> None:
        self.clock = clock
        self.chip = Mpu6050Model(clock, **chip)
        self.device = Mpu6050(NAME, self.chip, config)
        self.batches = []
        self.rng = np.random.default_rng(5)

    def start(self):
        self.batches += self.device.start(self.clock())
        return self.fly(30)

    def fly(self, polls, period_ns=10 * MS, jitter_ns=0):
        """Poll on a grid, each poll late by up to ``jitter_ns``."""
        made = []
        for _ in range(polls):
            late = int(self.rng.integers(0, jitter_ns + 1))
            due = self.clock.now_ns // period_ns * period_ns + period_ns
            self.clock.advance(due + late - self.clock.now_ns)
            made += self.device.pump(self.clock())
        self.batches += made
        return made

    def stop(self):
        self.batches += self.device.stop(self.clock())

    def check(self, tolerance=0):
        """Sequence and gaps add up; tick is the chip's own number of the sample; returns the rows."""
        rows = whole(self.batches, NAME)
        assert len(rows) > 0
        np.testing.assert_array_equal(rows["tick"], rows["sequence"])
        np.testing.assert_allclose(numbers(rows), rows["tick"], rtol=0, atol=tolerance)
        return rows


SETTINGS = [  # register, value for 4 g, 250 deg/s, DLPF 2, 1 kHz
    (0x6B, 0x01),
    (0x6C, 0x00),
    (0x19, 0x00),
    (0x1A, 0x0A),
    (0x1B, 0x00),
    (0x1C, 0x08),
    (0x37, 0x00),
    (0x38, 0x10),
]
