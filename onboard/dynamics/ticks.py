"""Signals of a flight on an even grid of ticks, input of the batch estimators."""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.smoothing import smooth


class FlightSignals(NamedTuple):
    """One flight on an even grid of ticks: joints smoothed, IMU as means of the samples of each tick."""

    period_s: float
    q: FloatArray  # (n, joints) at the middle of each tick
    dq: FloatArray
    ddq: FloatArray
    rate: FloatArray  # (n, 3) IMU axes, rad/s; NaN for a tick without an IMU
    specific_force: FloatArray  # (n, 3) IMU axes, m/s^2
    rate_sigma: FloatArray  # (3,) of a tick's mean
    specific_force_sigma: FloatArray  # (3,)
    samples: int  # in each tick's mean
    joint_sigma: FloatArray | None = None  # (n, 2, joints) noise of rates and accelerations; None: they are exact
    cyclic: FloatArray | None = None  # (n, 3, m) functions of the joints' cyclic errors, two derivatives; None: m = 0

    def coarser(self, ticks: int) -> "FlightSignals":
        """Means of so many ticks, joints at their middle; NaN where one of them is. A rest at the end is cut off.

        Noise of the joints stays: under the kernel that smooths them neighbouring ticks have the same.
        """
        n, early, late = len(self.q) // ticks, (ticks - 1) // 2, ticks // 2
        blocks = [x[: n * ticks].reshape(n, ticks, -1) for x in self[1:6]]
        q, dq, ddq = (0.5 * (x[:, early] + x[:, late]) for x in blocks[:3])
        rate, force = (x.mean(axis=1) for x in blocks[3:])
        noise = self.rate_sigma / np.sqrt(ticks), self.specific_force_sigma / np.sqrt(ticks)
        at = slice(early, n * ticks, ticks)
        of_joints = [None if x is None else x[at] for x in (self.joint_sigma, self.cyclic)]
        return FlightSignals(self.period_s * ticks, q, dq, ddq, rate, force, *noise, self.samples * ticks, *of_joints)


def tick_signals(
    time_s: FloatArray,
    angle: FloatArray,
    rate: FloatArray,
    specific_force: FloatArray,
    sigma: tuple[float, float],
    samples: int,
    width_s: float,
) -> FlightSignals:
    """Ticks of evenly sampled signals: means of the IMU, joints by :mod:`onboard.estimation.smoothing`.

    The joints by :func:`onboard.estimation.smoothing.smooth`; a mean of D samples has ``1 / sqrt(D)`` of their noise.

    Args:
        time_s: of the samples, (k,), even, vehicle time.
        angle: joint positions, (k, joints), rad.
        rate: IMU axes, (k, 3), rad/s; NaN where there is none.
        specific_force: IMU axes, (k, 3), m/s^2.
        sigma: white noise of a sample of rate and of specific force.
        samples: in each tick, odd.
        width_s: of the kernel that smooths the joints; ticks closer to the ends than half of it are left out.

    Raises:
        SignalError: times that are not even, or too few.
    """
    if samples % 2 == 0 or len(time_s) < 4 * samples:
        raise SignalError(f"{len(time_s)} samples in ticks of {samples}; give an odd number in each and four ticks")
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if np.abs(np.diff(time_s) - period_s).max() > 0.01 * period_s:
        raise SignalError("the samples are not evenly spaced; put them on a grid first")
    n = len(time_s) // samples
    middle = time_s[: n * samples].reshape(n, samples)[:, samples // 2]
    inside = (middle > time_s[0] + 0.5 * width_s) & (middle < time_s[-1] - 0.5 * width_s)
    means = [x[: n * samples].reshape(n, samples, 3).mean(axis=1)[inside] for x in (rate, specific_force)]
    q, dq, ddq = (smooth(time_s, angle, middle[inside], width_s, derivative).values for derivative in range(3))
    spread = [np.full(3, value / np.sqrt(samples)) for value in sigma]
    return FlightSignals(samples * period_s, q, dq, ddq, means[0], means[1], spread[0], spread[1], samples)
