"""A second IMU that the estimator does not use, compared with the first.

The rates of two IMUs on one body must be proportional with slope one. The slope of one on the other, both about their
means (biases drop out), is compared with one in blocks of a second. Three blocks of motion in a row outside what is
allowed are a contradiction: which side is wrong is not known, so no answer is used from then on.
"""

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import ImuRole
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import READING, sigmas
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.timebase.timebase import Timebase

_BLOCK_S, _CONTRADICTIONS = 1.0, 3  # length of a block, blocks of motion in a row that contradict
_LEAST = 0.05  # always allowed, of the slope
_SIGMAS = sigmas(READING)
_MOVING = 2.0 / _LEAST  # times the noise: motion in a block that is judged


class _Slope:
    """Slope of one signal on another, block by block; what it leaves over contradicts too.

    Attributes:
        slope: of the last block that was judged.
    """

    def __init__(self) -> None:
        self._pending: list[tuple[FloatArray, FloatArray]] = []
        self._noise = 0.0
        self._bad = 0
        self.slope = np.nan

    def add(self, first: FloatArray, second: FloatArray, noise: float, allowed: float, ticks: int) -> bool:
        """Add ticks, (n, k) each; True when so many blocks in a row contradict a slope of one.

        Args:
            first: the one that is predicted.
            second: the one that predicts it.
            noise: sigma of ``second``.
            allowed: of the slope, from one.
            ticks: in a block.
        """
        whole = np.isfinite(np.hstack([first, second])).all(axis=1)
        self._pending.append((first[whole], second[whole]))
        self._noise = max(self._noise, noise)
        if sum(len(part) for part, _ in self._pending) < ticks:
            return False
        x, y = (np.concatenate(side) for side in zip(*self._pending, strict=True))
        self._pending = []
        return self._judge(x - x.mean(axis=0), y - y.mean(axis=0), allowed)

    def _judge(self, first: FloatArray, second: FloatArray, allowed: float) -> bool:
        moved = float((second * second).sum())
        if moved < (_MOVING * self._noise) ** 2 * len(second) or self._noise == 0.0:
            return False
        self.slope = float((first * second).sum()) / moved
        left = float(np.sqrt(((first - self.slope * second) ** 2).sum() / moved))  # over the motion
        spread = left / np.sqrt(len(second) - 1.0)  # standard error of the slope
        bad = abs(self.slope - 1.0) > allowed + _SIGMAS * spread or left > allowed + _LEAST
        self._bad = self._bad + 1 if bad else 0
        return self._bad >= _CONTRADICTIONS


class RateWitness:
    """Compares the rates of two IMUs on the base.

    Args:
        model: of the vehicle, for the axes of both.
        imus: the one that is used, and the witness.
        scale_sigma: of either one's gyro, relative.
    """

    def __init__(self, model: VehicleModel, imus: tuple[ImuRole, ImuRole], scale_sigma: float) -> None:
        self._imus = imus
        self._axes = tuple(model.pose_in_base(imu.frame)[0] for imu in imus)
        self._allowed = max(_LEAST, _SIGMAS * np.sqrt(2.0) * scale_sigma)
        self._slope = _Slope()
        self.contradiction = ""

    def check(self, signals: SignalSmoother, timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int) -> bool:
        """Look at new ticks; True when they begin to contradict each other."""
        if self.contradiction:
            return False
        rates, noise = [], 0.0
        for imu, axes in zip(self._imus, self._axes, strict=True):
            means = signals.means(imu.channels, timebase, at_ns, period_ns)
            rates.append(means.derivatives[0][:, :3] @ axes.T)
            noise = max(noise, float(np.nan_to_num(means.sigma[0][:, :3]).max(initial=0.0)))
        if not self._slope.add(rates[0], rates[1], noise, self._allowed, round(_BLOCK_S * 1e9 / period_ns)):
            return False
        used, other = (imu.channels[0] for imu in self._imus)
        share = f"{used} turns by {self._slope.slope:.0%} of {other}"
        self.contradiction = f"{used} and {other} contradict each other: {share}"
        return True
