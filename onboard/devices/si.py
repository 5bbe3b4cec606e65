"""SI values of rows, by the scale that each row carries and the calibration in the vehicle file."""

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import FloatArray

AFTER_RESET = int(SampleStatus.AFTER_RESET)  # as a number: NumPy takes four times as long for a flag
UNUSABLE = int(SampleStatus.SATURATED | SampleStatus.NOT_VALID)


def imu(rows: Rows, signal: SmoothedChannel | None = None) -> FloatArray:
    """Angular rate [rad/s] and specific force [m/s^2] in sensor axes, (n, 6); calibrated where ``signal`` is."""
    gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"].astype(np.float64)[:, None]
    accel = rows["accel_raw"] * rows["accel_scale_m_s2"].astype(np.float64)[:, None]
    readings = np.hstack([gyro, accel])
    return readings if signal is None else signal.corrected(readings)


def pose(rows: Rows) -> FloatArray:
    """Attitude w, x, y, z and position x, y, z, m, of a tracker's rows, (n, 7)."""
    return np.hstack([rows["quaternion"], rows["position_m"]]).astype(np.float64)


def factors(rows: Rows, signal: SmoothedChannel) -> FloatArray:
    """SI units in the unit of each row, (n,); NaN where that is none that the channel may have."""
    units = rows["unit"]
    if len(units) and (units == units[0]).all():
        return np.full(len(units), signal.si.get(units[0], np.nan))
    return np.array([signal.si.get(unit, np.nan) for unit in units.tolist()], np.float64)


def scalar(rows: Rows, signal: SmoothedChannel | None = None) -> FloatArray:
    """Values (n,) in the rows' unit; zero count taken off and calibrated where ``signal`` is."""
    values: FloatArray = (rows["value_raw"] - (signal.zero_count if signal else 0)) * rows["scale"]
    if signal is None or not signal.corrections:
        return values
    factor = factors(rows, signal)
    return np.asarray(signal.corrected((values * factor)[:, None])[:, 0] / factor, np.float64)


def usable(rows: Rows) -> NDArray[np.bool_]:
    """Which rows (n,) of an IMU or a scalar channel are usable samples."""
    return np.asarray((rows["status"] & UNUSABLE) == 0)
