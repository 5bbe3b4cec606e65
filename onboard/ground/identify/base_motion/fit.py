"""Predicted against measured rate of a base over one interval; momentum and gyro offset fitted to its first part.

What follows the fitted part is prediction: joints and parameters alone move the base on.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from onboard.dynamics.free_flight import rate_of_momentum
from onboard.dynamics.mechanics.momentum_form import MomentumForm
from onboard.estimation.arrays import FloatArray

_FITTED = 1.0 / 3.0
_FIRST, _ROUNDS = 10, 8


class BaseRate(NamedTuple):
    """Rates in base axes over one interval without a gap, rad/s."""

    time_s: FloatArray  # (n,) since the log's start
    measured: FloatArray  # (n, 3)
    predicted: FloatArray  # (n, 3), with the offset
    fitted: int  # first ticks, used to fit momentum and offset
    momentum: FloatArray  # (3,) N m s, at the first tick, base axes
    offset: FloatArray  # (3,) of the gyro, rad/s

    @property
    def error(self) -> FloatArray:
        """Measured less predicted after the fitted part, (m, 3) rad/s."""
        return (self.measured - self.predicted)[self.fitted :]

    @property
    def rms(self) -> FloatArray:
        """Of the error, (3,) rad/s."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def swing(self) -> FloatArray:
        """Of the measured rate after the fitted part, from least to greatest, (3,) rad/s."""
        return np.asarray(np.ptp(self.measured[self.fitted :], axis=0), np.float64)

    def turned(self) -> tuple[FloatArray, FloatArray]:
        """Angle that the base has turned by since the fitted part, and how far the prediction is off, (m,) rad each."""
        measured, predicted = (
            _attitudes(rate[self.fitted :] - self.offset, np.diff(self.time_s[self.fitted :]))
            for rate in (self.measured, self.predicted)
        )
        off = (predicted.inv() * measured).magnitude()
        return np.asarray(measured.magnitude(), np.float64), np.asarray(off, np.float64)


def _attitudes(rate: FloatArray, steps_s: FloatArray) -> Rotation:
    """From the first tick on, by the mean rate of neighbouring ticks."""
    steps = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * steps_s[:, None]).as_matrix()
    R = np.empty((len(rate), 3, 3))
    R[0] = np.eye(3)
    for k, step in enumerate(steps):
        R[k + 1] = R[k] @ step
    return Rotation.from_matrix(R)


def fit(
    form: MomentumForm,
    measured: FloatArray,
    time_s: FloatArray,
    period_s: float,
    *,
    level_bed: bool = False,
    offset_rad_s: float = np.inf,
) -> BaseRate:
    """Fit momentum and gyro offset to the first third of an interval and predict the rest.

    Args:
        form: the base's rate per momentum and joint motion, at n ticks.
        measured: rate of the base, its axes, (n, 3) rad/s.
        time_s: of the ticks, (n,).
        period_s: between them.
        level_bed: the base turns about its z only.
        offset_rad_s: 1 sigma of the gyro's offset as stated: within seconds a momentum may look like one.
    """
    if level_bed:
        form = form.on_a_level_bed()
    axes = np.array([2] if level_bed else [0, 1, 2])
    fitted, n, k = round(_FITTED * len(measured)), len(measured), len(axes)
    momentum, offset = np.zeros(3), np.zeros(3)
    for part, both in ((_FIRST, 1), *[(fitted, 2)] * _ROUNDS):  # over the first few the rate is linear in the momentum
        rate, by_momentum = rate_of_momentum(*form, momentum, period_s)
        gap = (measured - rate - offset)[:part, axes]
        A = np.concatenate([by_momentum[:, axes][:, :, axes], np.broadcast_to(np.eye(k), (n, k, k))], axis=2)
        stated = np.eye(k, 2 * k, k) * np.sqrt(_alike(gap) * np.mean(gap**2)) / offset_rad_s
        rows = np.concatenate([A[:part].reshape(-1, 2 * k), stated])[:, : both * k]
        step = np.linalg.lstsq(rows, np.concatenate([gap.ravel(), -stated[:, k:] @ offset[axes]]))[0]
        momentum[axes] += step[:k]
        if both == 2:
            offset[axes] += step[k:]
    predicted = rate_of_momentum(*form, momentum, period_s)[0] + offset
    return BaseRate(time_s, measured, predicted, fitted, momentum, offset)


def _alike(gap: FloatArray) -> float:
    """How many samples of residuals, (n, k), say the same: by their runs of one sign, half as many as samples of noise.

    Wald and Wolfowitz, On a test whether two samples are from the same population, 1940.
    """
    runs = gap.shape[1] + np.count_nonzero(np.diff(np.signbit(gap), axis=0))
    return float(0.5 * gap.size / runs)
