"""The joints at the estimator's ticks: angles, rates and accelerations of all of them, and their noise."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import Roles
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.regressor.signals import EncoderJump, orders_of
from onboard.timebase.timebase import Timebase


class JointsAtTicks(NamedTuple):
    """Of n ticks."""

    values: FloatArray  # (3, n, joints) angles, rates, accelerations
    sigma: FloatArray  # (3, n, joints)
    refused: NDArray[np.int64]  # (n,) GateReason
    cyclic: FloatArray  # (n, 3, m) functions of cyclic errors
    of_samples: FloatArray  # (3, n, joints) share of the sigmas' squares that is of independent samples


class JointSignals:
    """Which channel measures which joint.

    Args:
        roles: of the devices; each joint has one.
        model: gives the order of the joints.

    Attributes:
        orders: how often the samples of each source of noise are differentiated, as of :class:`OfSamples`.
    """

    def __init__(self, roles: Roles, model: VehicleModel) -> None:
        joints, self._names = {joint.joint: joint for joint in roles.joints}, [joint.name for joint in model.joints]
        self._sensors = [joints[joint.name] for joint in model.joints]
        self._functions = [2 * len(roles.signals[one.channel].ripple) for one in self._sensors]
        self.orders = orders_of([one.is_rate for one in self._sensors])

    def at(self, signals: SignalSmoother, timebase: Timebase, at_ns: NDArray[np.int64]) -> JointsAtTicks:
        """The joints at vehicle times ``at_ns``, (n,), evenly spaced; what no sensor measures is zero."""
        values, sigma, share = np.zeros((3, 3, len(at_ns), len(self._sensors)))
        refused = np.zeros(len(at_ns), np.int64)
        cyclic = [np.full((len(at_ns), 3, count), np.nan) for count in self._functions]
        for lowest in (0, 1):
            columns = [column for column, sensor in enumerate(self._sensors) if sensor.is_rate == bool(lowest)]
            names = [self._sensors[column].channel for column in columns]
            parts = signals.each(names, timebase, at_ns, 2 - lowest)
            for column, smoothed in zip(columns, parts, strict=True):
                told = zip(smoothed.derivatives, smoothed.sigma, smoothed.of_samples, strict=True)
                for order, (value, spread, own) in enumerate(told, lowest):
                    values[order, :, column], sigma[order, :, column] = value[:, 0], spread[:, 0]
                    share[order, :, column] = own[:, 0]
                refused |= smoothed.refused
                if smoothed.cyclic is not None:
                    cyclic[column][:] = smoothed.cyclic
        return JointsAtTicks(values, sigma, refused, np.concatenate(cyclic, axis=2), share)

    def jumps(self, signals: SignalSmoother, at_ns: NDArray[np.int64]) -> tuple[tuple[str, EncoderJump], ...]:
        """Of encoders of angles, by joint, up to the last of some ticks, that were not taken before."""
        each = zip(self._names, self._sensors, strict=True)
        return tuple((name, one) for name, sensor in each for one in signals.jumps(sensor.channel, int(at_ns[-1])))
