"""Bias, scale and misalignment of an IMU: six positions for the accelerometer, turns by known angles for the gyro.

A triad reads ``E true + bias``. E has the scales on its diagonal; the other elements are small angles: of the triad's
axes against the reference, and of the axes among themselves.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import CalibrationError

LARGEST_SCALE = 0.2  # beyond, a unit or a range is wrong and not a calibration
CONTRADICTION = 5.0  # stated sigmas of a residual


class TriadCalibration(NamedTuple):
    """Of one triad of axes."""

    matrix: FloatArray  # (3, 3) E
    matrix_sigma: FloatArray  # (3, 3)
    bias: FloatArray  # (3,) unit of the readings
    bias_sigma: FloatArray  # (3,)
    residual: float  # rms, unit of the readings

    @property
    def scale_error(self) -> FloatArray:
        """Relative, (3,)."""
        return np.asarray(np.diag(self.matrix) - 1.0, np.float64)

    @property
    def misalignment_rad(self) -> FloatArray:
        """Small rotation of the triad against the reference, (3,): the antisymmetric part of E."""
        E = self.matrix
        return 0.5 * np.array([E[1, 2] - E[2, 1], E[2, 0] - E[0, 2], E[0, 1] - E[1, 0]])


def six_positions(
    specific_force_m_s2: FloatArray,
    up: FloatArray,
    gravity_m_s2: float,
    fixture_sigma_rad: float = 1e-3,
    reading_sigma_m_s2: float = 0.0,
) -> TriadCalibration:
    """Accelerometer from its mean readings at rest; at rest the specific force is g upwards.

    Args:
        specific_force_m_s2: mean reading of each position, (k, 3).
        up: the upward direction in sensor axes as the fixture has it, (k, 3); each of +-x, +-y, +-z at least.
        gravity_m_s2: of the place.
        fixture_sigma_rad: how well a position is held.
        reading_sigma_m_s2: of a mean reading.

    Raises:
        CalibrationError: positions that do not determine bias and scale, or readings that contradict them.
    """
    u = np.asarray(up, np.float64)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    sigma = float(np.hypot(fixture_sigma_rad * gravity_m_s2, reading_sigma_m_s2))
    return _triad(gravity_m_s2 * u, np.asarray(specific_force_m_s2, np.float64), sigma, "position", "six positions")


def turns(
    angle_rad: FloatArray, axis: FloatArray, integral_rad: FloatArray, duration_s: FloatArray, sigma_rad: float = 1e-3
) -> TriadCalibration:
    """Gyro from turns by known angles, whole turns on a table say; the bias is read from runs at rest among them.

    Args:
        angle_rad: of each turn, (k,); zero for a run at rest.
        axis: of each turn in sensor axes, (k, 3).
        integral_rad: of the readings over each run, (k, 3).
        duration_s: of each run, (k,).
        sigma_rad: of a known angle and of an integral together.

    Raises:
        CalibrationError: turns that do not determine bias and scale, or integrals that contradict them.
    """
    a = np.asarray(axis, np.float64)
    size = np.linalg.norm(a, axis=1, keepdims=True)
    true = np.asarray(angle_rad, np.float64)[:, None] * np.divide(a, size, out=np.zeros_like(a), where=size > 0.0)
    found = _triad(true, np.asarray(integral_rad, np.float64), sigma_rad, "run", "turns", np.asarray(duration_s))
    return found


def _triad(
    true: FloatArray, read: FloatArray, sigma: float, one: str, kind: str, weight: FloatArray | None = None
) -> TriadCalibration:
    """``read = true E' + weight bias``, least squares by axis; (k, 3) each."""
    if true.shape != read.shape or true.ndim != 2 or true.shape[1] != 3 or not np.isfinite(read).all():
        raise CalibrationError(f"{kind}: give finite readings (k, 3) and as many references")
    rows = np.column_stack([true, np.ones(len(true)) if weight is None else weight])
    scaled = rows / np.abs(rows).max(axis=0).clip(1e-300)
    if len(rows) < 4 or np.linalg.matrix_rank(scaled, 1e-2) < 4:
        raise CalibrationError(f"{kind}: bias and scale are not determined; measure each axis both ways up or round")
    inverse = np.linalg.inv(rows.T @ rows)
    x = inverse @ rows.T @ read  # (4, 3)
    residual = read - rows @ x
    freedom = max(len(rows) - 4, 1)
    rms = float(np.sqrt((residual**2).sum() / (3 * freedom)))
    worst = int(np.abs(residual).max(axis=1).argmax())
    scale = np.diag(x[:3])
    if (np.abs(scale - 1.0) > LARGEST_SCALE).any():
        raise CalibrationError(
            f"{kind}: a scale of {scale[np.abs(scale - 1.0).argmax()]:.3g}; check axes, signs, units and ranges"
        )
    if np.abs(residual[worst]).max() > CONTRADICTION * sigma:
        raise CalibrationError(
            f"{kind}: {one} {worst + 1} is {np.abs(residual[worst]).max() / sigma:.0f} sigmas off the others; repeat it"
        )
    spread = np.sqrt(np.diag(inverse)) * max(sigma, rms)
    return TriadCalibration(
        np.asarray(x[:3].T, np.float64),
        np.repeat(spread[None, :3], 3, axis=0),
        np.asarray(x[3], np.float64),
        np.full(3, spread[3]),
        rms,
    )
