"""Free fall in the readings of an inertial sensor: nothing but its noise, and what changes slowly.

A body that nothing touches shows a small specific force that changes as slowly as its own parts move. Hands and straps
pass on the unrest of what they are tied to, so that besides the size of the specific force its roughness tells whether
a body is held: the residual of a short cubic about each tick, against the sensor's noise. A rate tells less: a
light body turns as fast as its arm starts.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import MISFIT_DOUBTED, READING

CUBIC_s = 0.4  # width of the cubic: what is slower than some 4 Hz follows it
WINDOW_s = 0.3  # in which size and roughness are judged


def is_free(force: ArrayLike, sigma: ArrayLike, period_s: float, largest_m_s2: float) -> BoolArray:
    """Whether a body is in free fall at each tick, (n,); False where there is no reading within the window.

    Args:
        force: specific force, (n, 3), m/s^2; NaN where missing.
        sigma: of its white noise, (n, 3).
        period_s: between ticks.
        largest_m_s2: of the specific force, its mean over the window.
    """
    x, noise = np.asarray(force, np.float64), np.asarray(sigma, np.float64)
    rough = roughness(x, noise, period_s)
    width = 2 * round(0.5 * WINDOW_s / period_s) + 1
    freedom = width * x.shape[1]
    size = np.linalg.norm(_means(x, width), axis=1)
    limit = MISFIT_DOUBTED * float(chdtri(freedom, READING)) / freedom
    with np.errstate(invalid="ignore"):
        return np.asarray((size <= largest_m_s2) & (_means(rough[:, None], width)[:, 0] <= limit), np.bool_)


def _cubic(width: int) -> FloatArray:
    """Weights, (width,), of the value at the middle of the cubic that fits so many readings (Savitzky and Golay)."""
    at = np.linspace(-1.0, 1.0, width)
    return np.asarray(np.linalg.pinv(np.vander(at, 4, increasing=True))[0], np.float64)


def roughness(readings: FloatArray, sigma: FloatArray, period_s: float) -> FloatArray:
    """Mean square of the residuals of a cubic about each tick over that of white noise, (n,); NaN beside a gap.

    Args:
        readings: (n, m); NaN where missing.
        sigma: (n, m).
        period_s: between ticks.
    """
    width = 2 * round(0.5 * CUBIC_s / period_s) + 1
    if len(readings) < width:
        return np.full(len(readings), np.nan)
    kernel = -_cubic(width)
    kernel[width // 2] += 1.0
    residual = np.column_stack([np.convolve(column, kernel, "same") for column in readings.T])
    residual[: width // 2] = residual[len(residual) - width // 2 :] = np.nan
    return np.asarray(((residual / sigma) ** 2).mean(axis=1) / float(kernel @ kernel), np.float64)


def _means(values: FloatArray, width: int) -> FloatArray:
    """Running means, (n, m); NaN where a value within is, and at the ends."""
    out = np.full_like(values, np.nan)
    if len(values) >= width:
        windows = np.lib.stride_tricks.sliding_window_view(values, width, axis=0)
        out[width // 2 : len(values) - width // 2] = windows.mean(axis=-1)
    return out
