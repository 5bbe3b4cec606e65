"""IMU error model: biases and their drift, scale, misalignment, cross-axis sensitivity, delay, clock rate error (ours).

With u the rate or specific force in the IMU's nominal axes at the tick's middle t (t = 0 where the drift begins):

    u' = u - (delay + rate_error t) du/dt - n rate_error u,   n = 1 for a rate, 2 for a specific force
    shown = (exp(-hat(mounting + misalignment)) + diag(scale) + sym(cross_axis)) u' + bias + drift t

The first line is the Taylor series of a delayed reading on a clock with a rate error, which scales rates (angle by
time) once and specific forces (length by time squared) twice. Second-order terms in the errors are neglected, but for
those of a sensor that is turned: of one turned by 0.08 rad they are as large as a scale error of 0.3 %.

The mounting turns the housing, gyro and accelerometer alike; a misalignment is of one of them. With two misalignments
in its place a housing that is off counts twice: where two were 2.3 sigmas off about one axis of the base, the zero of a
joint, which was right, had evidence of 8.6 nats; it has 3.9 with the mounting.

Axes that are not orthogonal: six off-diagonal elements, of which ``hat`` has the antisymmetric part (as a rotation of
the whole sensor has, which is ``exp(-hat)``) and ``sym(c)`` the symmetric one, c_x between y and z: the magnitudes of
``hat(c)``. Computed in ``onboard/native/src/imu.c``.
"""

import ctypes
import math
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.identification.free_flyer.prediction.parameters import Unknowns
from onboard.native import library, structures


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
    mounting_rad: float = 0.0  # of the housing

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


def imu_blocks(prior: ImuPrior) -> dict[str, Unknowns]:
    """The IMU's errors as blocks of unknowns, in the order that :func:`imu_reading` takes them."""
    blocks = {}
    for kind, sigma in prior._asdict().items():
        names = (kind,) if kind in _OF_BOTH else tuple(f"{kind}_{axis}" for axis in "xyz")
        blocks[kind] = Unknowns(names, np.full(len(names), sigma))
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
    given = library.address(errors := library.given(errors, SIZE))
    return library.call("heft_imu_gain", given, out=np.empty(36)).reshape(6, 6)


def imu_reading(true: FloatArray, change: FloatArray, time_s: FloatArray, errors: FloatArray) -> ImuReading:
    """The equations at the head of this module.

    Args:
        true: rate and specific force, IMU axes, (n, 6).
        change: their derivative in time, (n, 6).
        time_s: t, (n,).
        errors: in the order of :func:`imu_blocks`, (SIZE,).
    """
    n = len(true)
    parts = [
        library.given(part, *shape)
        for part, shape in zip((true, change, time_s, errors), ((n, 6), (n, 6), (n,), (SIZE,)), strict=True)
    ]
    out = library.call(
        "heft_imu_reading", n, *(library.address(part) for part in parts), out=np.empty(n * (6 + 6 * SIZE))
    )
    return ImuReading(out[: 6 * n].reshape(n, 6), out[6 * n :].reshape(n, 6, SIZE))


def weight_of(samples: IndexArray | int) -> FloatArray:
    """Of the second difference in a tick's mean of so many samples: see :func:`tick_mean`."""
    return np.asarray((1.0 - 1.0 / samples**2) / 24.0, np.float64)


def tick_mean(x: FloatArray, samples: int) -> FloatArray:
    """Means over ticks of a signal known at the middle of every tick and sampled ``samples`` times D in each.

    The mean is the middle value plus ``(1 - 1/D^2) / 24`` of the second difference (Taylor's series to second order);
    the first and the last tick, which have none, keep their middle values. (n, ...).
    """
    out = x.copy()
    out[1:-1] += weight_of(samples) * (x[2:] - 2.0 * x[1:-1] + x[:-2])
    return out


def whitened(
    shown: ImuReading,
    errors: FloatArray,
    motion: tuple[FloatArray, FloatArray],
    samples: int,
    told: tuple[FloatArray, FloatArray],
    which: tuple[IndexArray, BoolArray],
) -> tuple[FloatArray, FloatArray]:
    """``r = (predicted - measured) / sigma``, (6 u,), and its derivative, (6 u, p): means over u ticks to use.

    Computed in ``onboard/native/src/whitened.c``.

    Args:
        shown: what the IMU shows at the middles of n ticks.
        errors: with which, (SIZE,).
        motion: derivatives of true rate and specific force by the base's motion, (n, 6, 9), and of that, (n, 9, c).
        samples: of each tick, as of :func:`tick_mean`.
        told: measured, and sigma of that, (n, 6) each.
        which: of the c + SIZE unknowns, (p,), and which ticks, (n,).

    Raises:
        ArrayError: shapes that do not fit.
    """
    E, (gain, along), (places, use) = gain_of(errors), motion, which
    n, total = len(shown.values), along.shape[-1]
    ticks = library.indices(use.nonzero()[0], n)
    arrays = (np.stack([E[:3, :3], E[3:, 3:]]), gain, along, *shown, *told)
    shapes = (2, 3, 3), (n, 6, 9), (n, 9, total), (n, 6), (n, 6, SIZE), (n, 6), (n, 6)
    given = [library.given(part, *shape) for part, shape in zip(arrays, shapes, strict=True)]
    u, p = 6 * len(ticks), len(places)
    read = structures.ReadTicks(n, total, p, len(ticks), *given, library.indices(places, total + SIZE), ticks)
    out = library.call("heft_whitened", ctypes.byref(read), float(weight_of(samples)), out=np.empty(u * (1 + p)))
    return out[:u], out[u:].reshape(u, p)
