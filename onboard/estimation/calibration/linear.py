"""Straight lines through known points: load cells by known masses, encoders at known angles, a body's balance."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import OF_STEP, FloatArray
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import REFUSE, of_each


class StraightLine(NamedTuple):
    """``reading = slope x known + offset``."""

    slope: float
    slope_sigma: float
    offset: float
    offset_sigma: float
    residual: float  # rms over the degrees of freedom, unit of the readings; zero for two points


def line(known: FloatArray, reading: FloatArray, known_sigma: FloatArray, reading_sigma: FloatArray) -> StraightLine:
    """Weighted least squares with errors on both sides (York's iteration at a slope that hardly moves).

    Args:
        known: the quantity that was applied, (k,), two different values at least.
        reading: what the instrument read, (k,).
        known_sigma: of each, (k,).
        reading_sigma: of each, (k,); their sum in quadrature is positive.

    Raises:
        CalibrationError: one value only, or points that no straight line passes within their sigmas.
    """
    x, y = np.asarray(known, np.float64), np.asarray(reading, np.float64)
    if x.shape != y.shape or x.ndim != 1 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise CalibrationError("give as many finite readings as known values")
    if len(x) < 2 or np.ptp(x) <= 3.0 * float(np.max(known_sigma)):
        raise CalibrationError("two or more known values that differ are needed; add a larger value")
    slope = float(np.polyfit(x, y, 1)[0])
    for _ in range(5):
        variance = np.asarray(reading_sigma) ** 2 + (slope * np.asarray(known_sigma)) ** 2
        if not (variance > 0.0).all():
            raise CalibrationError("state a sigma for the readings or for the known values")
        rows = np.column_stack([x, np.ones_like(x)]) / np.sqrt(variance)[:, None]
        covariance = np.linalg.inv(rows.T @ rows)
        slope, offset = covariance @ rows.T @ (y / np.sqrt(variance))
    whitened = (y - slope * x - offset) / np.sqrt(variance)
    alone = 1.0 - np.einsum("ki,ij,kj->k", rows, covariance, rows)  # share of its own error that a residual shows
    freedom = len(x) - 2
    squares = float(whitened @ whitened)
    if freedom and chdtrc(freedom, squares) < of_each(REFUSE):
        deleted = np.abs(whitened) / np.sqrt(alone.clip(1e-9))
        worst = int(deleted.argmax())
        raise CalibrationError(
            f"point {worst + 1} ({x[worst]:g}) is {deleted[worst]:.0f} sigmas off the line; check for friction, a "
            "touching cable, or a wrong value, and repeat it"
        )
    sigma = np.sqrt(np.diag(covariance))
    rms = float(np.sqrt(np.sum((y - slope * x - offset) ** 2) / freedom)) if freedom else 0.0
    return StraightLine(float(slope), float(sigma[0]), float(offset), float(sigma[1]), rms)


class EncoderScale(NamedTuple):
    """An encoder's zero, direction and resolution."""

    counts_per_revolution: float  # with its sign: negative where it counts against the joint
    counts_sigma: float
    zero_count: float
    zero_sigma: float


def encoder(angle_rad: FloatArray, counts: FloatArray, angle_sigma_rad: float) -> EncoderScale:
    """From counts at known angles, the two stops say.

    Raises:
        CalibrationError: as :func:`line`.
    """
    n = len(np.asarray(angle_rad))
    found = line(np.asarray(angle_rad), np.asarray(counts), np.full(n, angle_sigma_rad), np.full(n, OF_STEP))
    turn = 2.0 * np.pi
    return EncoderScale(found.slope * turn, found.slope_sigma * turn, found.offset, found.offset_sigma)


class Balanced(NamedTuple):
    """A body's mass and centre of mass."""

    mass_kg: float
    centre_of_mass_m: FloatArray  # (3,) body axes
    covariance: FloatArray  # (4, 4) of mass, then centre of mass


def balance(
    gravity_m_s2: FloatArray,
    pivot_m: FloatArray,
    hinge: FloatArray,
    support_m: FloatArray,
    push: FloatArray,
    force_N: FloatArray,
    sigma_N: float,
) -> Balanced:
    """Mass and centre of mass from a load cell that holds a body off its hinge, in several orientations.

    About the hinge the moments of cell and gravity add to zero: ``F h . ((s - p) x n) + h . ((c - p) x m g) = 0``,
    linear in m and m c. All vectors in the body's axes. A body that hangs on the cell alone is ``F n = -m g``: give a
    hinge of zeros.

    Args:
        gravity_m_s2: in body axes, (k, 3).
        pivot_m: a point of the hinge, (k, 3).
        hinge: its direction, (k, 3); zeros where the body hangs on the cell.
        support_m: where the cell pushes, (k, 3).
        push: the direction in which it pushes, (k, 3).
        force_N: its reading, (k,).
        sigma_N: of a reading.

    Raises:
        CalibrationError: orientations that do not determine all four, no mass, or readings that contradict each other.
    """
    g, p, h, s, n = (np.asarray(v, np.float64) for v in (gravity_m_s2, pivot_m, hinge, support_m, push))
    F = np.asarray(force_N, np.float64)
    hangs = (h == 0.0).all(axis=1)
    across = np.cross(g, h)  # h . (c x g) = c . (g x h)
    rows = np.column_stack([-np.einsum("ka,ka->k", h, np.cross(p, g)), across])
    lever = np.einsum("ka,ka->k", h, np.cross(s - p, n))
    rows[hangs] = 0.0
    rows[hangs, 0] = -np.einsum("ka,ka->k", g, n)[hangs]
    left = np.where(hangs, F, -F * lever)
    weight = 1.0 / (sigma_N * np.where(hangs, 1.0, np.abs(lever).clip(1e-9)))
    A, b = rows * weight[:, None], left * weight
    if len(A) < 4 or np.linalg.matrix_rank(A, 1e-6 * np.abs(A).max()) < 4:
        raise CalibrationError("mass and centre of mass are not determined; turn the body about another axis too")
    covariance = np.linalg.inv(A.T @ A)
    x = covariance @ A.T @ b
    residual = b - A @ x
    if not x[0] > 0.0:
        raise CalibrationError(f"a mass of {x[0]:.3g} kg; check the cell's sign and the direction of gravity")
    freedom = len(A) - 4
    if freedom and chdtrc(freedom, float(residual @ residual)) < of_each(REFUSE):
        worst = int(np.abs(residual).argmax())
        raise CalibrationError(
            f"orientation {worst + 1} is {abs(residual[worst]):.0f} sigmas off the others; repeat it"
        )
    m, c = float(x[0]), np.asarray(x[1:] / x[0], np.float64)
    D = np.zeros((4, 4))
    D[0, 0], D[1:, 0], D[1:, 1:] = 1.0, -c / m, np.eye(3) / m
    return Balanced(m, c, np.asarray(D @ covariance @ D.T, np.float64))
