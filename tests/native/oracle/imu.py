"""The IMU error model in NumPy."""

import math

import numpy as np

from onboard.estimation.arrays import hat
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, tick_mean

_OF_AXES, _DELAY, _CLOCK, _CROSS = slice(24), 24, 25, slice(26, 32)  # biases to misalignments; the others
_MOUNTING = slice(32, 35)

_TURNS, _SENSORS = (slice(9, 12), slice(21, 24)), (slice(0, 3), slice(3, 6))  # misalignments, and rows of each sensor
_SMALL = 1e-4  # rad^2, below which series to the square are exact to rounding: the next term is 2e-13
_ROWS = np.arange(6)
_BIAS = 12 * (_ROWS // 3) + _ROWS % 3  # place of each row's bias
_POWERS = np.repeat([1.0, 2.0], 3)  # of time that each row is scaled by


def _gains():
    """Map of the errors to the elements of :func:`gain_of`, (SIZE, 36)."""
    gains = np.zeros((SIZE, 6, 6))
    for k in range(2):  # gyro, accelerometer
        scale, cross_axis = (first + 3 * k for first in (6 + 9 * k, _CROSS.start))
        rows = slice(3 * k, 3 * k + 3)
        for axis, unit in enumerate(np.eye(3)):
            gains[scale + axis, rows, rows] = np.diag(unit)
            gains[cross_axis + axis, rows, rows] = _sym(unit)
    return gains.reshape(SIZE, 36)


def gain_of(errors):
    """Gain of rate and specific force at this module's head, (6, 6): the reading per true motion.

    The effect of delay and clock rate error on this derivative is left out: it is of second order.

    Args:
        errors: in the order of :func:`imu_blocks`, (SIZE,).
    """
    E = (errors @ _GAIN).reshape(6, 6)
    for turn, rows in zip(_TURNS, _SENSORS, strict=True):
        E[rows, rows] += _turned(errors[turn] + errors[_MOUNTING])[0]
    return E


def imu_reading(true, change, time_s, errors):
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
        R, along = _turned(errors[turn] + errors[_MOUNTING])
        d_errors[:, rows, turn] = d_errors[:, rows, _MOUNTING] = hat(own[:, rows] @ R.T) @ along
    d_errors[:, :3, 26:29], d_errors[:, 3:, 29:32] = _sym(own[:, :3]), _sym(own[:, 3:])
    d_errors[:, :, _DELAY] = -change @ E.T
    d_errors[:, :, _CLOCK] = -(t * change + _POWERS * true) @ E.T
    return own @ E.T + bias + t * drift, d_errors


def whitened(shown, errors, motion, samples, told, which):
    """Predicted less measured over sigma, (6 u,), and its derivative, (6 u, p), as of the product's."""
    (gain, along), (measured, sigma), (places, use) = motion, told, which
    jacobian = np.concatenate([gain_of(errors) @ (gain @ along), shown.d_errors], axis=2)[:, :, places]
    residual = ((tick_mean(shown.values, samples) - measured) / sigma)[use].ravel()
    return residual, (tick_mean(jacobian, samples) / sigma[..., None])[use].reshape(residual.size, len(places))


def _turned(m):
    """``R = exp(-hat(m))`` and ``J``, (3, 3) each, of which ``d(R u) = hat(R u) J dm`` (the left Jacobian at -m).

    Rodrigues' formula; Sola, Deray, Atchuthan: A micro Lie theory for state estimation in robotics, 2018, equation 145.
    """
    return _turned_by(*m.tolist())


def _turned_by(x, y, z):
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


def _sym(c):
    """``[[0, z, y], [z, 0, x], [y, x, 0]]`` of each c, (..., 3); ``sym(c) u == sym(u) c``."""
    out = np.zeros((*c.shape, 3))
    out[..., 1, 2] = out[..., 2, 1] = c[..., 0]
    out[..., 0, 2] = out[..., 2, 0] = c[..., 1]
    out[..., 0, 1] = out[..., 1, 0] = c[..., 2]
    return out


_GAIN = _gains()


def imu_along(sensor, along, errors, samples, period_s):
    """Values, derivatives by errors and by place of means over ticks; those at instants by the motion."""
    true, gain, by_place = sensor
    E, time_s = gain_of(errors), period_s * np.arange(len(true))[1:-1]
    change = (true[2:] - true[:-2]) / (2.0 * period_s)
    mean, d_place = (tick_mean(part, samples)[1:-1] for part in (true, E @ by_place))
    return *imu_reading(mean, change, time_s, errors), d_place, E @ gain @ along
