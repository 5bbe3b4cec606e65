"""Lower bound of the chip's noise, and the longest run of equal samples it allows by chance."""

import math

from drivers.mpu6050.registers import ACCEL_LSB_PER_G, GYRO_LSB_PER_DEG_S, Mpu6050Config
from drivers.repeats import longest_run

ACCEL_NOISE_G, GYRO_NOISE_DEG_S = 100e-6, 0.0025  # density per sqrt(Hz): 1/4 of PS 6.2, 1/2 of PS 6.1
NOISE_BANDWIDTH = math.pi / 2.0  # of a first-order filter, over its bandwidth
ACCEL_BANDWIDTH_HZ = (260.0, 184.0, 94.0, 44.0, 21.0, 10.0, 5.0)  # by DLPF_CFG, RM register 26
GYRO_BANDWIDTH_HZ = (256.0, 188.0, 98.0, 42.0, 20.0, 10.0, 5.0)


def most_repeats(config: Mpu6050Config) -> int:
    """Longest run of equal samples that may occur by chance (``drivers.repeats.longest_run``)."""
    accel_hz, gyro_hz = ACCEL_BANDWIDTH_HZ[config.filter_code], GYRO_BANDWIDTH_HZ[config.filter_code]
    accel = ACCEL_NOISE_G * math.sqrt(NOISE_BANDWIDTH * accel_hz) * ACCEL_LSB_PER_G[config.accel_range_g]
    gyro = GYRO_NOISE_DEG_S * math.sqrt(NOISE_BANDWIDTH * gyro_hz) * GYRO_LSB_PER_DEG_S[config.gyro_range_deg_s]
    return longest_run([accel] * 3 + [gyro] * 3, min(accel_hz, gyro_hz), config.sample_rate_hz)
