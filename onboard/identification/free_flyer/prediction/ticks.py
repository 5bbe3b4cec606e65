"""Consecutive ticks of a flight: joints, means of the instruments with the noise of each; a prediction of them."""

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
