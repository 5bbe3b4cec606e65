"""SI values of rows, by the scale that each row carries."""

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard.estimation.arrays import FloatArray

UNUSABLE = int(SampleStatus.SATURATED | SampleStatus.NOT_VALID)


def imu(rows: Rows) -> FloatArray:
    """Angular rate [rad/s] and specific force [m/s^2] in sensor axes, (n, 6)."""
    gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"].astype(np.float64)[:, None]
    accel = rows["accel_raw"] * rows["accel_scale_m_s2"].astype(np.float64)[:, None]
    return np.hstack([gyro, accel])


def scalar(rows: Rows, zero_count: int = 0) -> FloatArray:
    """Values (n,) in the rows' unit."""
    values: FloatArray = (rows["value_raw"] - zero_count) * rows["scale"]
    return values


def usable(rows: Rows) -> NDArray[np.bool_]:
    """Which rows (n,) of an IMU or a scalar channel are usable samples."""
    return np.asarray((rows["status"] & UNUSABLE) == 0)
