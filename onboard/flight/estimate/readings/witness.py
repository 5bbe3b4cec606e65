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
        self._allowed = max(_LEAST, _SIGMAS * np.sqrt(2.0) * scale_sigma)  # of the slope, from one
        self._pending: list[FloatArray] = []  # rates of both beside each other, (n, 6), of the present block
        self._noise, self._bad = 0.0, 0  # largest sigma of a rate; blocks in a row that contradict
        self.contradiction = ""

    def check(self, signals: SignalSmoother, timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int) -> bool:
        """Look at new ticks; True when they begin to contradict each other."""
        if self.contradiction:
            return False
        rates = []
        for imu, axes in zip(self._imus, self._axes, strict=True):
            means = signals.means(imu.channels, timebase, at_ns, period_ns)
            rates.append(means.derivatives[0][:, :3] @ axes.T)
            self._noise = max(self._noise, float(np.nan_to_num(means.sigma[0][:, :3]).max(initial=0.0)))
        both = np.hstack(rates)
        self._pending.append(both[np.isfinite(both).all(axis=1)])
        if sum(map(len, self._pending)) < round(_BLOCK_S * 1e9 / period_ns):
            return False
        block, self._pending = np.concatenate(self._pending), []
        first, second = np.hsplit(block - block.mean(axis=0), 2)
        moved = float((second * second).sum())
        if moved < (_MOVING * self._noise) ** 2 * len(second) or self._noise == 0.0:
            return False
        slope = float((first * second).sum()) / moved
        left = float(np.sqrt(((first - slope * second) ** 2).sum() / moved))  # over the motion: it contradicts, too
        spread = left / np.sqrt(len(second) - 1.0)  # standard error of the slope
        bad = abs(slope - 1.0) > self._allowed + _SIGMAS * spread or left > self._allowed + _LEAST
        self._bad = self._bad + 1 if bad else 0
        if self._bad < _CONTRADICTIONS:
            return False
        used, other = (imu.channels[0] for imu in self._imus)
        self.contradiction = f"{used} and {other} contradict each other: {used} turns by {slope:.0%} of {other}"
        return True
