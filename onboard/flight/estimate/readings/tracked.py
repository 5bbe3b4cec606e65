"""Poses of a tracker at the estimator's ticks: every few of them, from a straight line through the samples about it."""

import math

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import TrackerRole
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.timebase.timebase import Timebase

_SAMPLES = 4  # under a line: no two lines share one, so their noise is independent


class TrackedTicks:
    """The ticks at which a tracker is read.

    Args:
        role: of the tracker.
        period_ns: between ticks.
    """

    def __init__(self, role: TrackerRole, period_ns: int) -> None:
        self._channel, self._period_ns = role.channel, period_ns
        self._every = max(1, math.ceil(_SAMPLES * role.signal.period_s * 1e9 / period_ns - 0.1))

    def at(self, signals: SignalSmoother, timebase: Timebase, at_ns: NDArray[np.int64]) -> ChannelAtTicks:
        """Attitude and position, (n, 7), their noise; NaN at ticks that are not read.

        Args:
            signals: of the vehicle.
            timebase: of the vehicle.
            at_ns: the ticks, (n,).
        """
        values, sigma = np.full((2, len(at_ns), 7), np.nan)
        refused = np.full(len(at_ns), int(GateReason.OK))
        read = np.flatnonzero(at_ns // self._period_ns % self._every == self._every // 2)
        if read.size:
            found = signals.means([self._channel], timebase, at_ns[read], self._every * self._period_ns)
            values[read], sigma[read], refused[read] = found.derivatives[0], found.sigma[0], found.refused
        return ChannelAtTicks((values,), (sigma,), refused)
