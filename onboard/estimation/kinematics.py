"""Kernel equivalent to a steady-state Kalman smoother.

The signal model is four integrators driven by white noise (snap of a joint). The steady-state Kalman filter is a fixed
linear filter; from its poles D the kernel for :class:`onboard.estimation.smoothing.SmoothingWindow` is made:
``G(s) G(-s) = 1 / (1 + (s/w)^8)`` with ``G(s) = D(0) / D(s)``, the Rauch-Tung-Striebel smoother away from the ends of a
record. Its derivatives are consistent by themselves.

As a window's kernel it accepts samples at any times and rates, detects gaps and gives the noise of every derivative.
The truncated part of the impulse response beyond the window is some 1e-4.
"""

from functools import cache

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm

from onboard.estimation.arrays import ComplexArray, FloatArray
from onboard.estimation.errors import RowError
from onboard.estimation.smoothing import Kernel

ORDER = 4  # integrators
SMOOTHER_BAND = 56.0  # the filter's natural frequency times the window's width
_POLE_STEP = 0.01  # sample period times band at which the discrete filter approximates the continuous one
_TRANSITION = expm(np.eye(ORDER, k=1))  # over one sample period, its length the unit of time
_STEADY = 1e-13  # relative change of the gain taken as converged


def steady_gain(period_s: float, frequency_rad_s: float) -> FloatArray:
    """Steady-state gain of the Kalman filter of position, rate, acceleration and jerk, (4,).

    Args:
        period_s: between samples.
        frequency_rad_s: edge of the band: ``(q / r)^(1/8)``, q the spectral density of the snap, r that of the noise.

    Raises:
        RowError: argument not positive, or a band beyond what the sample rate resolves.
    """
    if not (period_s > 0.0 and 0.0 < frequency_rad_s * period_s < 1.0):
        raise RowError(f"{frequency_rad_s} rad/s by samples every {period_s} s; sample six times a period and more")
    kalman = KalmanFilter(dim_x=ORDER, dim_z=1)
    kalman.F = _TRANSITION  # solved in units of the sample period (well scaled); the gain is scaled back
    kalman.H = np.eye(1, ORDER)
    kalman.Q = Q_continuous_white_noise(ORDER, 1.0, (frequency_rad_s * period_s) ** (2 * ORDER))
    kalman.R = np.eye(1)
    kalman.P = np.eye(ORDER)
    before = np.zeros((ORDER, 1))
    while np.abs(kalman.K - before).max() > _STEADY * np.abs(kalman.K).max() or not kalman.K.any():
        before = kalman.K
        kalman.predict()
        kalman.update(np.zeros(1))
    return np.asarray(kalman.K[:, 0] / period_s ** np.arange(ORDER), np.float64)


class Decay:
    """Sum of oscillations that decay with the distance from the middle of the window, on both sides.

    Args:
        factors: complex, (k,); the real part of the sum is used.
        poles: complex, (k,), per window width.
        derivative: with respect to the place in the window.
    """

    def __init__(self, factors: ComplexArray, poles: ComplexArray, derivative: int = 0) -> None:
        self._factors, self._poles, self._derivative = factors, poles, derivative

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at places -1/2..1/2."""
        factors = self._factors * self._poles**self._derivative
        waves = factors * np.exp(self._poles * np.abs(u)[..., None])
        return np.asarray(waves.sum(axis=-1).real * np.sign(u) ** self._derivative, np.float64)


def _poles(frequency: float) -> tuple[ComplexArray, ComplexArray]:
    """Poles of D, and the factors of their oscillations in the impulse response of ``D(0) / D(s)``; width one."""
    period = _POLE_STEP / frequency
    gain = steady_gain(period, frequency) * period ** np.arange(ORDER)
    poles = np.log(np.linalg.eigvals((np.eye(ORDER) - np.outer(gain, np.eye(1, ORDER))) @ _TRANSITION) + 0j) / period
    apart = poles[:, None] - poles + np.eye(ORDER)
    return poles, np.prod(poles) / np.prod(apart, axis=1)


@cache
def smoother_kernel() -> Kernel:
    """Kernel of the steady-state Rauch-Tung-Striebel smoother."""
    poles, factors = _poles(SMOOTHER_BAND)
    # the autocorrelation of the filter's response
    factors = factors * (factors / -(poles[:, None] + poles)).sum(axis=1)
    u = np.linspace(-0.5, 0.5, 20_001)
    values = Decay(factors, poles)(u)
    total = float(np.trapezoid(values, u))
    parts = [Decay(factors / total, poles, derivative) for derivative in range(3)]
    return Kernel((parts[0], parts[1], parts[2]), float(np.trapezoid(values * u**2, u)) / total)
