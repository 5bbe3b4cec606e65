"""A second IMU on the base: it turns with the first, so their rates differ by biases and noise and nothing else.

The IMU that the estimator does not use is asked, second by second, whether the first one's rate still follows its own:
the slope of one on the other, both about their means. Two that have agreed and do so no longer for some seconds of
motion contradict each other; which of them lies they cannot say, so no answer is used from then on.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import ImuRole
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.signals import SignalSmoother
from onboard.timebase.timebase import Timebase

_BLOCK_S = 1.0
_TOLD = 3  # blocks of motion in a row that contradict
_LEAST = 0.05  # of the rate, that they may always differ by
_SIGMAS = 6.0
_MOVING = 30.0  # times the noise, the motion in a block that is judged


class _Block(NamedTuple):
    first: FloatArray  # (n, 3) rate by the IMU that is used, base axes
    second: FloatArray  # (n, 3) by the other


class RateWitness:
    """Compares the rates of two IMUs.

    Args:
        model: of the vehicle, for the axes of both.
        imus: the one that is used, and the witness.
        scale_sigma: of either one's gyro, relative.
    """

    def __init__(self, model: VehicleModel, imus: tuple[ImuRole, ImuRole], scale_sigma: float) -> None:
        self._imus = imus
        self._axes = tuple(model.pose_in_base(imu.frame)[0] for imu in imus)
        self._allowed = max(_LEAST, _SIGMAS * np.sqrt(2.0) * scale_sigma)
        self._pending: list[_Block] = []
        self._noise = 0.0
        self._bad = 0
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
        whole = np.isfinite(np.hstack(rates)).all(axis=1)
        self._pending.append(_Block(rates[0][whole], rates[1][whole]))
        self._noise = max(self._noise, noise)
        if sum(len(block.first) for block in self._pending) * period_ns * 1e-9 < _BLOCK_S:
            return False
        first, second = (np.concatenate(part) for part in zip(*self._pending, strict=True))
        self._pending = []
        return self._judge(first - first.mean(axis=0), second - second.mean(axis=0))

    def _judge(self, first: FloatArray, second: FloatArray) -> bool:
        moved = float((second * second).sum())
        if moved < (_MOVING * self._noise) ** 2 * len(second) or self._noise == 0.0:
            return False
        slope = float((first * second).sum()) / moved
        left = float(np.sqrt(((first - slope * second) ** 2).sum() / moved))
        bad = abs(slope - 1.0) > self._allowed or left > self._allowed + 2.0 / _MOVING
        self._bad = self._bad + 1 if bad else 0
        if self._bad < _TOLD:
            return False
        used, other = (imu.channels[0] for imu in self._imus)
        self.contradiction = f"{used} and {other} contradict each other: {used} turns by {slope:.0%} of {other}"
        return True
