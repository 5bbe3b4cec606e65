"""What the devices of ``clock_world.py`` measure, each so that a sample says when it was taken, and their clocks.

Clocks of the IMU and of the serial devices warm up and cool down, 100 ppm a minute at their steepest.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows

Floats = NDArray[np.float64]

START_NS = 7_000_000_000
STEEPEST_PER_S = 100e-6 / 60.0
WARMING_S = 600.0
COUNTS_PER_REVOLUTION = 500_000


class WarmingClock:
    """A chip's clock off by ``rate_error``, and by up to 160 ppm more or less as it warms up and cools down."""

    def __init__(self, rng: np.random.Generator, rate_limit: float, steepest_per_s: float = STEEPEST_PER_S) -> None:
        self._rate = 1.0 + rng.uniform(-rate_limit, rate_limit)
        self._turn = 2.0 * math.pi / WARMING_S
        self._swing = steepest_per_s / self._turn
        self._phase = rng.uniform(0.0, 2.0 * math.pi)

    def _chip_s(self, time_s: Floats) -> Floats:
        wave = np.cos(self._phase) - np.cos(self._phase + self._turn * time_s)
        return np.asarray(self._rate * time_s + self._swing / self._turn * wave)

    def chip_ns(self, time_ns: int) -> int:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        return round(1e9 * float(self._chip_s(np.array([(time_ns - START_NS) * 1e-9]))[0]))

    def time_ns(self, chip_ns: int) -> int:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        return START_NS + round(1e9 * float(self.times_s(np.array([float(chip_ns)]))[0]))

    def times_s(self, chip_ns: Floats) -> Floats:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        target_s = 1e-9 * chip_ns
        time_s = target_s / self._rate
        for _ in range(4):
            rate = self._rate + self._swing * np.sin(self._phase + self._turn * time_s)
            time_s = time_s - (self._chip_s(time_s) - target_s) / rate
        return np.asarray(time_s, np.float64)


class CountingImu:
    """Its accelerometer's x and y words count the samples; it remembers when each was taken."""

    def __init__(self) -> None:
        self._times_s = np.zeros(1 << 12)
        self._count = 0

    @property
    def times_s(self) -> Floats:
        """When each sample was taken, (n,), mission time."""
        return self._times_s[: self._count]

    def counts(
        self, times_s: Floats, accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        """See ``hil_sim.sensing.analog.ImuAnalog``."""
        del accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg
        number = self._count + np.arange(len(times_s))
        words = np.zeros((len(times_s), 7), np.int16)
        words[:, 0], words[:, 1] = number % 30_000, number // 30_000
        self._count += len(times_s)
        while self._count > len(self._times_s):
            self._times_s = np.concatenate([self._times_s, np.zeros_like(self._times_s)])
        self._times_s[number] = times_s
        return words

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        number = rows["accel_raw"][:, 0].astype(np.int64) + 30_000 * rows["accel_raw"][:, 1].astype(np.int64)
        return np.asarray(1e9 * self.times_s[number], np.float64)


class Hands:
    """A shaft that turns unevenly; it remembers when it was looked at, and what count it then had.

    The adapter counts from wherever it began. Few counts are ever looked at, so only one beginning fits many rows.
    """

    def __init__(self) -> None:
        self._seen: dict[int, float] = {}
        self._first: int | None = None

    def value(self, time_s: float) -> float:
        """Angle, rad."""
        angle = 0.5 * time_s + 0.3 * math.sin(time_s)
        self._seen.setdefault(round(angle * COUNTS_PER_REVOLUTION / math.tau), time_s)
        return angle

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        values = rows["value_raw"].tolist()
        if self._first is None:
            fits = [n for n in range(200_000) if all(value + n in self._seen for value in values)]
            assert len(fits) == 1, f"{len(fits)} beginnings fit {len(values)} rows"
            self._first = fits[0]
        return 1e9 * np.array([self._seen[value + self._first] for value in values])


class Elapsed:
    """An input that is the time."""

    def value(self, time_s: float) -> float:
        """Mission time, s."""
        return time_s

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        return np.asarray(1e9 * rows["value_raw"] * rows["scale"])
