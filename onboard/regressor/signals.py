"""Smoothed signals, input of the rows."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.regressor.rows import BaseMotion


class SignalNoise(NamedTuple):
    """Standard deviation of the smoothed signals: sample noise times the kernel's noise gain, each axis alone."""

    q: FloatArray  # (n, joints)
    dq: FloatArray  # (n, joints)
    ddq: FloatArray  # (n, joints)
    rate: FloatArray  # (n, 3) IMU axes, as the three below
    acceleration: FloatArray  # (n, 3)
    specific_force: FloatArray  # (n, 3)
    inflation: float = 1.0  # for the correlation of neighbouring rows


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
