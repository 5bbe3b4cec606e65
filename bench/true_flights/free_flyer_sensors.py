"""Samples of the free-flyer's encoders and base IMU, with errors drawn once per flight."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from bench.true_flights.free_flyer import COUNTS_PER_TURN
from hil_sim.arrays import FloatArray
from hil_sim.plants.motions.motion import STANDARD_GRAVITY

GYRO_DENSITY_rad_s = np.deg2rad(0.005)  # per root Hz; MPU-6050 product specification 3.4, section 6.1
ACCELEROMETER_DENSITY_m_s2 = 400e-6 * STANDARD_GRAVITY  # per root Hz; section 6.2
GYRO_STEP_rad_s = np.deg2rad(1.0 / 131.0)  # of a count at 250 deg/s
ACCELEROMETER_STEP_m_s2 = STANDARD_GRAVITY / 16384.0  # at 2 g


class Moved(Protocol):
    """True signals on the grid of the samples, of a free flight or any other."""

    @property
    def time_s(self) -> FloatArray:
        """Of the samples, (n,)."""

    @property
    def q_rad(self) -> FloatArray:
        """Joint angles, (n, 5)."""

    @property
    def rate_rad_s(self) -> FloatArray:
        """Rate of the base, (n, 3), IMU axes."""

    @property
    def specific_force_m_s2(self) -> FloatArray:
        """At the IMU, (n, 3), its axes."""


@dataclass(frozen=True)
class ImuErrors:
    """Standard deviations per axis of an IMU's errors besides noise."""

    gyro_bias_rad_s: float = 0.0
    gyro_drift_rad_s2: float = 0.0
    accelerometer_bias_m_s2: float = 0.0
    accelerometer_drift_m_s3: float = 0.0
    scale: float = 0.0
    turn_rad: float = 0.0  # small rotation of each triad
    delay_s: float = 0.0  # IMU samples carry times this much too late


class SampledSignals(NamedTuple):
    """Sampled signals on one grid."""

    time_s: FloatArray  # (n,)
    angle_rad: FloatArray  # (n, 5), in whole counts, the middle of each
    rate_rad_s: FloatArray  # (n, 3)
    specific_force_m_s2: FloatArray  # (n, 3)
    rate_sigma_rad_s: float  # white noise of a sample
    specific_force_sigma_m_s2: float


def sample(flight: Moved, errors: ImuErrors, rng: np.random.Generator) -> SampledSignals:
    """Samples a flight at its own grid; noise at the datasheet's density, white up to half the sample rate."""
    t, n = flight.time_s, len(flight.time_s)
    period_s = float(t[1] - t[0])
    half_band = np.sqrt(0.5 / period_s)
    delay_s = errors.delay_s * rng.standard_normal()
    middle = t - 0.5 * (t[0] + t[-1])
    readings = []
    for truth, density, step, bias, drift in (
        (flight.rate_rad_s, GYRO_DENSITY_rad_s, GYRO_STEP_rad_s, errors.gyro_bias_rad_s, errors.gyro_drift_rad_s2),
        (
            flight.specific_force_m_s2,
            ACCELEROMETER_DENSITY_m_s2,
            ACCELEROMETER_STEP_m_s2,
            errors.accelerometer_bias_m_s2,
            errors.accelerometer_drift_m_s3,
        ),
    ):
        x, y, z = errors.turn_rad * rng.standard_normal(3)
        E = np.eye(3) + np.diag(errors.scale * rng.standard_normal(3)) - np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        late = truth - delay_s * np.gradient(truth, period_s, axis=0, edge_order=2)
        zero = bias * rng.standard_normal(3) + middle[:, None] * drift * rng.standard_normal(3)
        noise = density * half_band * rng.standard_normal((n, 3))
        readings.append(np.rint((late @ E.T + zero + noise) / step) * step)
    count = 2.0 * np.pi / COUNTS_PER_TURN
    angle = (np.floor(flight.q_rad / count) + 0.5) * count
    sigma = [
        np.hypot(d * half_band, s / np.sqrt(12.0))
        for d, s in ((GYRO_DENSITY_rad_s, GYRO_STEP_rad_s), (ACCELEROMETER_DENSITY_m_s2, ACCELEROMETER_STEP_m_s2))
    ]
    return SampledSignals(t, angle, readings[0], readings[1], float(sigma[0]), float(sigma[1]))
