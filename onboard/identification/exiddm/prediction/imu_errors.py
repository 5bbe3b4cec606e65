"""IMU error model: biases and their drift, scale, misalignment, cross-axis sensitivity, delay, clock rate error (ours).

With u the rate or specific force in the IMU's nominal axes at the tick's middle t (t = 0 where the drift begins):

    u' = u - (delay + rate_error t) du/dt - n rate_error u,   n = 1 for a rate, 2 for a specific force
    shown = (exp(-hat(misalignment)) + diag(scale) + sym(cross_axis)) u' + bias + drift t

The first line is the Taylor series of a delayed reading on a clock with a rate error, which scales rates (angle by
time) once and specific forces (length by time squared) twice. Second-order terms in the errors are neglected, but for
those of a sensor that is turned: of one turned by 0.08 rad they are as large as a scale error of 0.3 %.

Axes that are not orthogonal: six off-diagonal elements, of which ``hat`` has the antisymmetric part (as a rotation of
the whole sensor has, which is ``exp(-hat)``) and ``sym(c)`` the symmetric one, c_x between y and z: the magnitudes of
``hat(c)``.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from onboard.dynamics.spatial import hat
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.exiddm.prediction.parameters import Block


class ImuPrior(NamedTuple):
    """Prior on instrument errors: standard deviations per axis; zero: exact."""

    gyro_bias_rad_s: float
    gyro_drift_rad_s2: float
    gyro_scale: float
    gyro_misalignment_rad: float
    accelerometer_bias_m_s2: float
    accelerometer_drift_m_s3: float
    accelerometer_scale: float
    accelerometer_misalignment_rad: float
    delay_s: float  # of both, against the joints
    clock_rate_error: float = 0.0  # relative excess of an interval on the IMU's clock over the joints' clock
    gyro_cross_axis: float = 0.0  # symmetric part
    accelerometer_cross_axis: float = 0.0

    def with_cross_axis(self, gyro: float, accelerometer: float) -> "ImuPrior":
        """The same with off-diagonal elements of each triad's matrix of so many sigmas, each independent of the others.

        Half of their variance is in the symmetric part, half is that of a misalignment.
        """
        half = 0.5**0.5
        return self._replace(
            gyro_misalignment_rad=math.hypot(self.gyro_misalignment_rad, half * gyro),
            accelerometer_misalignment_rad=math.hypot(self.accelerometer_misalignment_rad, half * accelerometer),
            gyro_cross_axis=half * gyro,
            accelerometer_cross_axis=half * accelerometer,
        )


CERTAIN = ImuPrior(*[0.0] * 9)
BIASES = ("gyro_bias_rad_s", "accelerometer_bias_m_s2")
DRIFTS = ("gyro_drift_rad_s2", "accelerometer_drift_m_s3")
_OF_BOTH = ("delay_s", "clock_rate_error")
SIZE = 3 * (len(ImuPrior._fields) - len(_OF_BOTH)) + len(_OF_BOTH)
_OF_AXES, _DELAY, _CLOCK, _CROSS = slice(24), 24, 25, slice(26, 32)  # biases to misalignments; the others

_TURNS, _SENSORS = (slice(9, 12), slice(21, 24)), (slice(0, 3), slice(3, 6))  # misalignments, and rows of each sensor
_SMALL = 1e-4  # rad^2, below which series to the square are exact to rounding: the next term is 2e-13
_ROWS = np.arange(6)
_BIAS = 12 * (_ROWS // 3) + _ROWS % 3  # place of each row's bias
_POWERS = np.repeat([1.0, 2.0], 3)  # of time that each row is scaled by


def _gains() -> FloatArray:
    """Map of the errors to the elements of :func:`gain_of`, (SIZE, 36)."""
    gains = np.zeros((SIZE, 6, 6))
    for k in range(2):  # gyro, accelerometer
        scale, cross_axis = (first + 3 * k for first in (6 + 9 * k, _CROSS.start))
        rows = slice(3 * k, 3 * k + 3)
        for axis, unit in enumerate(np.eye(3)):
            gains[scale + axis, rows, rows] = np.diag(unit)
            gains[cross_axis + axis, rows, rows] = _sym(unit)
    return gains.reshape(SIZE, 36)


def imu_blocks(prior: ImuPrior) -> dict[str, Block]:
    """The IMU's errors as blocks of unknowns, in the order that :func:`imu_reading` takes them."""
    blocks = {}
    for kind, sigma in prior._asdict().items():
        names = (kind,) if kind in _OF_BOTH else tuple(f"{kind}_{axis}" for axis in "xyz")
        blocks[kind] = Block(names, np.full(len(names), sigma))
    return blocks


def drift_of(name: str) -> str:
    """The drift of a bias, by their names; empty for what is no bias."""
    for bias, drift in (*zip(BIASES, DRIFTS, strict=True), ("bias_", "drift_")):
        if name.startswith(bias):
            return drift + name.removeprefix(bias)
    return ""


class ImuReading(NamedTuple):
    """What the IMU shows, rate then specific force in its axes, and how that depends on its errors."""

    values: FloatArray  # (n, 6)
    d_errors: FloatArray  # (n, 6, SIZE)


def gain_of(errors: FloatArray) -> FloatArray:
    """Gain of rate and specific force at this module's head, (6, 6): the reading per true motion.

    The effect of delay and clock rate error on this derivative is left out: it is of second order.

    Args:
        errors: in the order of :func:`imu_blocks`, (SIZE,).
    """
    E: FloatArray = (errors @ _GAIN).reshape(6, 6)
    for turn, rows in zip(_TURNS, _SENSORS, strict=True):
        E[rows, rows] += _turned(errors[turn])[0]
    return E


def imu_reading(true: FloatArray, change: FloatArray, time_s: FloatArray, errors: FloatArray) -> ImuReading:
    """The equations at the head of this module.

    Args:
        true: rate and specific force, IMU axes, (n, 6).
        change: their derivative in time, (n, 6).
        time_s: t, (n,).
        errors: in the order of :func:`imu_blocks`, (SIZE,).
    """
    delay_s, rate_error = errors[_DELAY], errors[_CLOCK]
    bias, drift = errors[_OF_AXES].reshape(2, 4, 3)[:, :2].swapaxes(0, 1).reshape(2, 6)
    t, E = time_s[:, None], gain_of(errors)
    own = true - (delay_s + rate_error * t) * change - rate_error * _POWERS * true
    d_errors = np.zeros((len(true), 6, SIZE))
    d_errors[:, _ROWS, _BIAS] = 1.0
    d_errors[:, _ROWS, _BIAS + 3] = t
    d_errors[:, _ROWS, _BIAS + 6] = own
    for turn, rows in zip(_TURNS, _SENSORS, strict=True):
        R, along = _turned(errors[turn])
        d_errors[:, rows, turn] = hat(own[:, rows] @ R.T) @ along
    d_errors[:, :3, 26:29], d_errors[:, 3:, 29:32] = _sym(own[:, :3]), _sym(own[:, 3:])
    d_errors[:, :, _DELAY] = -change @ E.T
    d_errors[:, :, _CLOCK] = -(t * change + _POWERS * true) @ E.T
    return ImuReading(own @ E.T + bias + t * drift, d_errors)


def _turned(m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``R = exp(-hat(m))`` and ``J``, (3, 3) each, of which ``d(R u) = hat(R u) J dm`` (the left Jacobian at -m).

    Rodrigues' formula; Sola, Deray, Atchuthan: A micro Lie theory for state estimation in robotics, 2018, equation 145.
    """
    return _turned_by(*m.tolist())


@lru_cache(maxsize=16)  # a gain and its derivatives are asked for one after the other
def _turned_by(x: float, y: float, z: float) -> tuple[FloatArray, FloatArray]:
    H, square = hat(np.array([x, y, z])), x * x + y * y + z * z
    angle = math.sqrt(square)
    if square < _SMALL:
        a, b, c = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        sine = math.sin(angle)
        a, b, c = sine / angle, (1.0 - math.cos(angle)) / square, (angle - sine) / (angle * square)
    HH = H @ H
    R, J = np.eye(3) - a * H + b * HH, np.eye(3) - b * H + c * HH
    R.setflags(write=False)
    J.setflags(write=False)
    return R, J


def _sym(c: FloatArray) -> FloatArray:
    """``[[0, z, y], [z, 0, x], [y, x, 0]]`` of each c, (..., 3); ``sym(c) u == sym(u) c``."""
    out = np.zeros((*c.shape, 3))
    out[..., 1, 2] = out[..., 2, 1] = c[..., 0]
    out[..., 0, 2] = out[..., 2, 0] = c[..., 1]
    out[..., 0, 1] = out[..., 1, 0] = c[..., 2]
    return out


def tick_mean(x: FloatArray, samples: int) -> FloatArray:
    """Means over ticks of a signal known at the middle of every tick and sampled ``samples`` times D in each.

    The mean is the middle value plus ``(1 - 1/D^2) / 24`` of the second difference (Taylor's series to second order);
    the first and the last tick, which have none, keep their middle values. (n, ...).
    """
    c = (1.0 - 1.0 / samples**2) / 24.0
    out = x.copy()
    out[1:-1] += c * (x[2:] - 2.0 * x[1:-1] + x[:-2])
    return out


def whitened(
    values: FloatArray, jacobian: FloatArray, measured: FloatArray, sigma: FloatArray, use: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """``r = (predicted - measured) / sigma``, (u,), and its derivative, (u, p), of the u lines to use.

    Args:
        values: predicted, (n, m).
        jacobian: of these, (n, m, p).
        measured: (n, m).
        sigma: of the measured, (n, m) or (m,).
        use: which ticks, (n,), or which lines of each, (n, m).
    """
    residual = ((values - measured) / sigma)[use].ravel()
    return residual, (jacobian / sigma[..., None])[use].reshape(residual.size, -1)


_GAIN = _gains()
