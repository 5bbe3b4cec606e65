"""Consecutive ticks of a flight: joints, means of the instruments with the noise of each; a prediction of them.

In short gaps of the joints ticks wait until these are known again, and move smoothly in between. A filter carries the
momentum from tick to tick, which needs the joints at each; a window of seconds would have to begin anew at each gap.
The joints are those of the polynomial of fifth degree that has position, rate and acceleration of both ends. What
instruments show there is not used.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import SINGULAR, FloatArray, IndexArray
from onboard.estimation.gates import GateReason, ReasonArray
from onboard.estimation.smoothing import alike_in_products
from onboard.regressor.signals import Signals, noise_of_joints

BATCH_TICKS = 10  # that the filter takes in one step
RESTS_rad_s = 0.01  # joint rate below which the motion carries no information on the payload


class TickPrediction(NamedTuple):
    """Prediction of the ticks 1 .. b of b + 2, from a state at tick 0."""

    values: FloatArray  # (b, m) rate and specific force in the first IMU's axes, then what further instruments show
    jacobian: FloatArray  # (b, m, p)
    state: FloatArray  # (p,) propagated to tick b
    transition: FloatArray  # (c, p) derivative of those of its elements that change: ``ImuPredictor.changing``

    @staticmethod
    def none(ticks: int, lines: int, size: int, changing: int) -> "TickPrediction":
        """No motion follows from the state: NaN."""
        shapes = (ticks, lines), (ticks, lines, size), (size,), (changing, size)
        return TickPrediction(*(np.full(shape, np.nan) for shape in shapes))

    @property
    def moderate(self) -> bool:
        """Whether no square of it overflows; else the joints' signals are nonsense."""
        return all(bool(part.min() > -SINGULAR and part.max() < SINGULAR) for part in self)  # False for NaN


class Ticks(NamedTuple):
    """Consecutive ticks."""

    time_s: FloatArray  # (n,)
    q: FloatArray  # (n, joints) at the middle of each tick; NaN where they are not known
    dq: FloatArray
    ddq: FloatArray
    measured: FloatArray  # (n, m) means of rate and specific force, IMU axes, then of further instruments; NaN: none
    sigma: FloatArray  # (n, m) of these
    joint_sigma: FloatArray  # (n, 2, joints) of dq, inflated for the correlation of neighbouring ticks, and of ddq
    sample_sigma: FloatArray  # (n, 2, joints) of dq and ddq, each tick by itself: what noise of samples makes of it
    cyclic: FloatArray  # (n, 3, m) functions that the joints' cyclic errors are multiples of, and two derivatives
    thrust: FloatArray  # (n, k) of the thrusters, N, means
    alike: FloatArray  # (n,) number of ticks in which the joints' noise is one value, as it counts in a product of two

    def part(self, which: slice | IndexArray) -> "Ticks":
        """A part of the ticks."""
        return Ticks(*(x[which] for x in self))

    @property
    def rest(self) -> bool:
        """Whether the arm rests in all of them."""
        return bool(np.abs(self.dq).max() <= RESTS_rad_s)

    def and_then(self, more: "Ticks") -> "Ticks":
        """These ticks followed by ``more``."""
        return Ticks.joined((self, more))

    @staticmethod
    def joined(parts: "Sequence[Ticks]") -> "Ticks":
        """One part after the other, of one at least."""
        some = [part for part in parts if len(part.time_s)] or parts[:1]
        if len(some) == 1:
            return some[0]
        return Ticks(*(np.concatenate(part) for part in zip(*some, strict=True)))

    @staticmethod
    def none(joints: int, lines: int = 6, thrusters: int = 0) -> "Ticks":
        """No ticks of so many joints, lines of instruments and thrusters."""
        angles, shown, thrust = np.zeros((0, joints)), np.zeros((0, lines)), np.zeros((0, thrusters))
        noise, of_each = np.zeros((0, 2, joints)), np.zeros(0)
        parts = of_each, angles, angles, angles, shown, shown, noise, noise, np.zeros((0, 3, 0)), thrust, of_each
        return Ticks(*parts)

    def flight(self, period_s: float, samples: int, imu: slice = slice(6)) -> FlightSignals:
        """As one flight, every tick with the median noise.

        Args:
            period_s: between ticks.
            samples: of the IMU in each tick.
            imu: its lines.
        """
        spread, (rate, force) = np.nanmedian(self.sigma[:, imu], axis=0), np.hsplit(self.measured[:, imu], 2)
        joints = self.q, self.dq, self.ddq
        return FlightSignals(
            *(period_s, *joints, rate, force, spread[:3], spread[3:6], samples, self.sample_sigma, self.cyclic)
        )


def gated(signals: Signals, excluded: ReasonArray) -> ReasonArray:
    """Reasons for which each line of each tick, (n, lines), is not used."""
    found = np.repeat(np.asarray(excluded, np.int64)[:, None], signals.measured.shape[1], axis=1)
    if signals.refused is not None:
        found |= signals.refused
    joints = np.isfinite(np.concatenate([signals.q, signals.dq, signals.ddq], axis=1)).all(axis=1)
    found[~(np.isfinite(signals.measured + signals.sigma) & joints[:, None])] |= GateReason.GAP
    return found


def ticks_of(signals: Signals, measured: FloatArray) -> Ticks:
    """Signals as ticks, the noise of rates inflated for the correlation of neighbours.

    Errors of accelerations cancel in the sums of a slow motion, by samples' noise as by a gear's ripple: each tick's by
    itself, they count for more than they are. Inflated they made the noise of a load cell three times what it was.

    Args:
        signals: at n ticks; joints without a noise are taken for exact.
        measured: (n, m) rate and specific force, then further instruments, NaN where refused.
    """
    n, joints_count = signals.q.shape
    joint_sigma, alike = (sample_sigma := np.zeros((n, 2, joints_count))), np.ones(n)
    if (noise := signals.noise) is not None:
        joint_sigma = np.stack([noise.inflation * noise.dq, noise.ddq], axis=1)
        alike *= alike_in_products(noise.inflation)
        if noise.of_samples is not None:
            share = noise.of_samples.share[:, joints_count : 3 * joints_count].reshape(n, 2, joints_count)
            own = noise_of_joints(np.stack([noise.q, noise.dq, noise.ddq]), signals.dq, signals.ddq)
            sample_sigma = np.sqrt(share) * np.stack(own[1:], axis=1)
    cyclic = np.zeros((len(signals.time_s), 3, 0)) if signals.cyclic is None else signals.cyclic
    thrust = np.zeros((len(signals.time_s), 0)) if signals.thrust is None else signals.thrust
    joints = signals.q, signals.dq, signals.ddq
    return Ticks(signals.time_s, *joints, measured, signals.sigma, joint_sigma, sample_sigma, cyclic, thrust, alike)


LONGEST_s = 0.8
"""Over which the error of the interpolation turns the momentum by less than a gyro's noise in a tick, for a swing of
0.3 rad at 0.6 Hz; it grows with the fifth power."""


class JointGaps:
    """Of one filter's ticks.

    Args:
        period_s: between ticks.
        none: no ticks, of this vehicle.
    """

    def __init__(self, period_s: float, none: Ticks) -> None:
        self._period_s, self._none = period_s, none
        self._held = none  # the newest tick of known joints, which was given, and those of unknown ones since

    def take(self, ticks: Ticks) -> Ticks:
        """Those of known joints, and those of a gap that is over; of a longer one than :data:`LONGEST_s` nothing."""
        given = len(self._held.time_s) > 0
        ticks = self._held.and_then(ticks)
        at = np.isfinite(np.concatenate([ticks.q, ticks.dq, ticks.ddq], axis=1)).all(axis=1).nonzero()[0]
        if not at.size:
            return self._none
        parts, before = [], None
        for one in [at] if at[-1] - at[0] < len(at) else np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            first, last = int(one[0]), int(one[-1])
            if before is not None:
                gap_s = ticks.time_s[first] - ticks.time_s[before]
                if gap_s <= LONGEST_s and round(gap_s / self._period_s) == first - before:
                    parts.append(_filled(ticks.part(slice(before, first + 1))))
            parts.append(ticks.part(slice(first, last + 1)))
            before = last
        waits = ticks.time_s[-1] - ticks.time_s[at[-1]] <= LONGEST_s
        self._held = ticks.part(slice(at[-1], None if waits else at[-1] + 1))
        return Ticks.joined(parts).part(slice(int(given), None))


def _filled(ticks: Ticks) -> Ticks:
    """The inner ones of some of which the first and the last have known joints."""
    inner = ticks.part(slice(1, -1))
    at_s, whole_s = inner.time_s - ticks.time_s[0], float(ticks.time_s[-1] - ticks.time_s[0])
    ends = np.stack([ticks.q, ticks.dq, ticks.ddq], axis=1)[[0, -1]]
    joints = _between(ends, at_s, whole_s)
    return inner._replace(
        q=joints[:, 0],
        dq=joints[:, 1],
        ddq=joints[:, 2],
        measured=np.full(inner.measured.shape, np.nan),
        joint_sigma=np.repeat(ticks.joint_sigma[[0, -1]].max(axis=0, keepdims=True), len(at_s), axis=0),
        sample_sigma=np.zeros(inner.sample_sigma.shape),  # none of these is used
        cyclic=_between(ticks.cyclic[[0, -1]], at_s, whole_s),
    )


def _between(ends: FloatArray, at_s: FloatArray, whole_s: float) -> FloatArray:
    """Values and two derivatives, (n, 3, m), at times after the first of two ends, (2, 3, m), that are so far apart."""
    scale = np.array([1.0, whole_s, 0.5 * whole_s**2])[:, None]  # of a power series in the share of the time
    (a, b, c), (d, e, f) = ends[0] * scale, ends[1] * scale
    d, e, f = d - a - b - c, e - b - 2.0 * c, f - c
    powers = a, b, c, 10.0 * d - 4.0 * e + f, 7.0 * e - 15.0 * d - 2.0 * f, 6.0 * d - 3.0 * e + f
    x = (at_s / whole_s)[:, None]
    value, rate, bend = (
        sum(math.perm(k, order) * one * x ** (k - order) for k, one in enumerate(powers) if k >= order)
        for order in range(3)
    )
    return np.stack([value, rate / whole_s, bend / whole_s**2], axis=1)
