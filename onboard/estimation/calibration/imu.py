"""Bias, scale and misalignment of an IMU: six positions for the accelerometer, turns by known angles for the gyro.

A triad reads ``E true + bias``. E has the scales on its diagonal; the other elements are small angles: of the triad's
axes against the reference, and of the axes among themselves. A position or a turn that is held a little askew changes
what is read across its direction in the first order, and along it in the second only; so the scales come out far better
than the angles.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import LARGEST_SIZE, REFUSE, of_each, sigmas

EARTH_RATE_rad_s = 7.292115e-5


class TriadCalibration(NamedTuple):
    """Of one triad of axes."""

    matrix: FloatArray  # (3, 3) E
    matrix_sigma: FloatArray  # (3, 3)
    bias: FloatArray  # (3,) unit of the readings
    bias_sigma: FloatArray  # (3,)
    residual: float  # rms, stated sigmas


def six_positions(
    specific_force_m_s2: FloatArray,
    up: FloatArray,
    gravity_m_s2: float,
    fixture_sigma_rad: float,
    reading_sigma_m_s2: float,
) -> TriadCalibration:
    """Accelerometer from its mean readings at rest; at rest the specific force is g upwards.

    Args:
        specific_force_m_s2: mean reading of each position, (k, 3).
        up: the upward direction in sensor axes as the fixture has it, (k, 3); each of +-x, +-y, +-z at least.
        gravity_m_s2: of the place.
        fixture_sigma_rad: how well a position is held, 1 sigma by axis.
        reading_sigma_m_s2: of a mean reading.

    Raises:
        CalibrationError: positions that do not determine bias and scale, or readings that contradict them.
    """
    u = np.asarray(up, np.float64)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    sigma = _askew(u, fixture_sigma_rad, gravity_m_s2, reading_sigma_m_s2)
    read = np.asarray(specific_force_m_s2, np.float64)
    return _triad(gravity_m_s2 * u, read, sigma, "position", "six positions", np.ones(len(u)))


def turns(
    angle_rad: FloatArray,
    axis: FloatArray,
    integral_rad: FloatArray,
    fixture_sigma_rad: float,
    sigma_rad: float,
) -> TriadCalibration:
    """Gyro from turns by known angles, whole turns on a table say; its bias is zero here, see :func:`rest_bias`.

    Args:
        angle_rad: of each turn, (k,).
        axis: of each turn in sensor axes, (k, 3).
        integral_rad: of the readings over each turn, less the bias that was read at rest before and after, (k, 3).
        fixture_sigma_rad: how well the axis of a turn is held, 1 sigma by axis.
        sigma_rad: of a known angle and of an integral together.

    Raises:
        CalibrationError: turns that do not determine the scales, or integrals that contradict them.
    """
    a = np.asarray(axis, np.float64)
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    angle = np.asarray(angle_rad, np.float64)
    sigma = _askew(a, fixture_sigma_rad, np.abs(angle)[:, None], sigma_rad)
    return _triad(angle[:, None] * a, np.asarray(integral_rad, np.float64), sigma, "turn", "turns", None)


class RestBias(NamedTuple):
    """What a gyro reads at rest."""

    bias_rad_s: FloatArray  # (3,) without specific force
    sigma_rad_s: FloatArray  # (3,)
    per_g_rad_s: FloatArray  # (3, 3) for 1 g along each axis


def rest_bias(rate_rad_s: FloatArray, up: FloatArray, reading_sigma_rad_s: float) -> RestBias:
    """Bias of a gyro from its mean readings at rest in the six positions, separate from the effect of gravity on it.

    The Earth's rotation, whose direction is not known, is part of sigma.

    Args:
        rate_rad_s: mean reading of each position, (k, 3).
        up: the upward direction in sensor axes, (k, 3).
        reading_sigma_rad_s: of a mean reading.

    Raises:
        CalibrationError: positions that do not determine the bias.
    """
    u = np.asarray(up, np.float64)
    rows = np.column_stack([u / np.linalg.norm(u, axis=1, keepdims=True), np.ones(len(u))])
    if np.linalg.matrix_rank(rows, 1e-2) < 4:
        raise CalibrationError("rests: the bias is not determined; rest on each side, both ways up")
    inverse = np.linalg.inv(rows.T @ rows)
    x = inverse @ rows.T @ np.asarray(rate_rad_s, np.float64)
    sigma = np.hypot(reading_sigma_rad_s * np.sqrt(inverse[3, 3]), EARTH_RATE_rad_s / np.sqrt(3.0))
    return RestBias(np.asarray(x[3], np.float64), np.full(3, sigma), np.asarray(x[:3].T, np.float64))


def _askew(direction: FloatArray, angle_rad: float, size: FloatArray | float, sigma: float) -> FloatArray:
    """Sigma of each component, (k, 3), of a vector of that size along a direction that is held within an angle."""
    across = np.sqrt(np.maximum(1.0 - direction**2, 0.0))
    along = np.abs(direction) * angle_rad**2
    return np.asarray(np.hypot(sigma, size * np.hypot(angle_rad * across, along)), np.float64)


def _triad(
    true: FloatArray, read: FloatArray, sigma: FloatArray, one: str, kind: str, bias: FloatArray | None
) -> TriadCalibration:
    """``read = true E' + bias``, weighted least squares by axis; (k, 3) each; without a bias where there is none."""
    if true.shape != read.shape or true.ndim != 2 or true.shape[1] != 3 or not np.isfinite(read).all():
        raise CalibrationError(f"{kind}: give finite readings (k, 3) and as many references")
    rows = true if bias is None else np.column_stack([true, bias])
    n = rows.shape[1]
    scaled = rows / np.abs(rows).max(axis=0).clip(1e-300)
    if len(rows) < n or np.linalg.matrix_rank(scaled, 1e-2) < n:
        raise CalibrationError(f"{kind}: bias and scale are not determined; measure each axis both ways up or round")
    x, spread = np.zeros((4, 3)), np.zeros((4, 3))
    whitened = np.empty_like(read)
    for axis in range(3):
        A, b = rows / sigma[:, axis, None], read[:, axis] / sigma[:, axis]
        inverse = np.linalg.inv(A.T @ A)
        x[:n, axis] = inverse @ A.T @ b
        spread[:n, axis] = np.sqrt(np.diag(inverse))
        whitened[:, axis] = b - A @ x[:n, axis]
    scale = np.diag(x[:3])
    if (np.abs(scale - 1.0) > LARGEST_SIZE).any():
        raise CalibrationError(
            f"{kind}: a scale of {scale[np.abs(scale - 1.0).argmax()]:.3g}; check axes, signs, units and ranges"
        )
    worst = int(np.abs(whitened).max(axis=1).argmax())
    if np.abs(whitened[worst]).max() > sigmas(of_each(REFUSE, whitened.size)):
        raise CalibrationError(
            f"{kind}: {one} {worst + 1} is {np.abs(whitened[worst]).max():.0f} sigmas off the others; repeat it"
        )
    freedom = 3 * max(len(rows) - n, 1)
    rms = float(np.sqrt((whitened**2).sum() / freedom))
    return TriadCalibration(
        np.asarray(x[:3].T, np.float64), np.asarray(spread[:3].T * max(1.0, rms)), x[3], spread[3] * max(1.0, rms), rms
    )
