"""Smoothed signals, input of the rows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.regressor.rows import BaseMotion

_AT_REST = 1e-7  # rad/s, rad/s^2 or m: beyond rounding of a kernel over equal samples


class OfSamples(NamedTuple):
    """The part of the signals' noise that is of independent samples, sources in the order of :class:`SignalNoise`."""

    share: FloatArray  # (n, 3 joints + 9) of the variance
    order: NDArray[np.intp]  # (3 joints + 9,) how often the samples were differentiated


class SignalNoise(NamedTuple):
    """Standard deviation of the smoothed signals: sample noise times the kernel's noise gain, each axis alone."""

    q: FloatArray  # (n, joints)
    dq: FloatArray  # (n, joints)
    ddq: FloatArray  # (n, joints)
    rate: FloatArray  # (n, 3) IMU axes, as the three below
    acceleration: FloatArray  # (n, 3)
    specific_force: FloatArray  # (n, 3)
    inflation: float = 1.0  # for the correlation of neighbouring rows
    of_samples: OfSamples | None = None  # none of it is, where not given


def noise_of_joints(sigma: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stated noise of smoothed angles, rates and accelerations without that of joints at rest.

    An encoder at rest repeats its count, so rates and accelerations there are exactly zero. With the noise stated of
    it the rows of rest would count for little, and more regressor noise would be taken off than there is.

    Args:
        sigma: stated, (3, n, joints).
        dq: smoothed rates, (n, joints).
        ddq: smoothed accelerations.

    Returns:
        Of angles, rates and accelerations, (n, joints) each.
    """
    at_rest = (np.abs(dq) < _AT_REST) & (np.abs(ddq) < _AT_REST)
    return sigma[0], np.where(at_rest, 0.0, sigma[1]), np.where(at_rest, 0.0, sigma[2])


def orders_of(rate_sensors: Sequence[bool]) -> NDArray[np.intp]:
    """How often the samples of each source of noise were differentiated, (3 joints + 9,): :class:`OfSamples`.

    Args:
        rate_sensors: of each joint, whether its sensor reads rates.
    """
    lowest = np.array(rate_sensors, np.intp)
    joints = [np.maximum(order - lowest, 0) for order in range(3)]
    return np.concatenate([*joints, np.repeat([0, 1, 0], 3)])


class EncoderJump(NamedTuple):
    """An encoder that is another one from some time on, read so that its angle goes on smoothly."""

    vehicle_ns: int  # the first sample after it
    size: float  # rad or m, as the others
    angle: float  # as it was read then
    rate: float  # rad/s


class Signals(NamedTuple):
    """Smoothed signals at n ticks; every one through the same kernel. NaN where a window was not valid."""

    time_s: FloatArray  # (n,)
    q: FloatArray  # (n, joints)
    dq: FloatArray  # (n, joints)
    ddq: FloatArray  # (n, joints)
    motion: BaseMotion  # (n, 3) each, of the base frame
    measured: FloatArray  # (n, rows) left-hand sides; zero for a wrench known to be zero
    sigma: FloatArray  # (n, rows) of `measured`, correlation inflation included; zero if exact
    measured_rate: FloatArray | None = None  # (n, rows) time derivative of `measured`; for delays considered
    noise: SignalNoise | None = None  # of the motion; None: the regressor is exact
    friction: FloatArray | None = None  # (n, motors) Coulomb friction over its level; the rate's sign where not given
    refused: NDArray[np.int64] | None = None  # (n, rows) reasons to leave a row out, besides those of its whole tick
    cyclic: FloatArray | None = None  # (n, 3, m) functions of the joints' cyclic errors, and their two derivatives
    thrust: FloatArray | None = None  # (n, k) forces of thrusters, N, means over the ticks
    jumps: tuple[tuple[str, EncoderJump], ...] = ()  # of the encoders of joints by name, in these ticks
