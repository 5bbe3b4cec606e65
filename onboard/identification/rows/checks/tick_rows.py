"""Rows of kept ticks about a state of all errors: what they tell of it, and what it leaves over.

Noise of the motion is in the derivatives J of the readings and in what is left over, r; by as much as
:attr:`.SmoothedTicks.noisier` changes both. What it adds to the normal equations is taken off, and off the information
what that leaves in doubt (:mod:`onboard.identification.rows.stated_errors.regressor_noise`). Of encoders of 12 bits,
whose accelerations are half noise, scales and delays would else be found that make less of it.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import DOUBT, MOST_SHARE, READING, sigmas
from onboard.identification.rows.checks.remade import RowsRemade, SmoothedTicks
from onboard.identification.rows.stated_errors.regressor_noise import told

_HUBER, _FAR = sigmas(DOUBT), sigmas(READING)  # rows beyond weigh less (Huber 1964); contradict
_TINY = float(np.finfo(np.float64).tiny)


class TickRows:
    """Kept ticks of one arm.

    Args:
        remade: their rows, about errors of instruments.
        half: root of the prior of the base parameters, (p, n).
        centre: base parameters as drawn, (p,).
        sigma: of each error as stated, (e,).
        ticks: with the weights of independent rows.
        lag: between how many of them nothing is alike.
    """

    def __init__(
        self,
        remade: RowsRemade,
        half: FloatArray,
        centre: FloatArray,
        sigma: FloatArray,
        ticks: SmoothedTicks,
        lag: int,
    ) -> None:
        self.ticks, self.half = ticks, half
        self._remade, self._centre, self._sigma, self._lag = remade, centre, sigma, lag
        self._noise: tuple[FloatArray, FloatArray] | None = (
            None  # of derivatives and targets, one sigma; (t m, s), (t m)
        )

    def parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Base parameters, (p,), and errors of instruments, (e,), by the state, (n + e,)."""
        n = self.half.shape[1]
        return self._centre + self.half @ x[:n], self._sigma * x[n:]

    def about(self, x: FloatArray, ticks: SmoothedTicks | None = None) -> tuple[FloatArray, FloatArray]:
        """Readings of these ticks or others, (t, m), and derivatives, (t, m, n + e), about a state."""
        reading, slope = self._remade.at(self.ticks if ticks is None else ticks, *self.parts(x))
        p = len(self._centre)
        return reading, np.concatenate([slope[..., :p] @ self.half, slope[..., p:] * self._sigma], axis=2)

    def left(self, x: FloatArray) -> "Left":
        """What a state leaves over, to be held against another."""
        reading, J = self.about(x)
        return Left(J, self.ticks.measured - reading + J @ x, self.ticks, self._lag)

    def equations(self, x: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, "Left"]:
        """Information and right-hand side of the state about a value of it, and what another leaves over.

        The noise of derivatives is that about the first value of which this is asked.

        Args:
            x: the state, (n + e,).
            noise: variance of each row over that stated, (m,).
        """
        left = self.left(x)
        J, target = left.slope.reshape(-1, len(x)), left.target.ravel()
        if self._noise is None:
            reading, slope = self.about(x, self.ticks.noisier)
            dJ = slope.reshape(J.shape) - J
            self._noise = dJ, (self.ticks.measured - reading).ravel() - target + slope.reshape(J.shape) @ x
        weight = self.ticks.weight / noise
        far = np.abs((target - J @ x).reshape(weight.shape)) * np.sqrt(weight)
        w = (weight * np.minimum(1.0, _HUBER / np.maximum(far, _HUBER))).ravel()
        dJ, moved = self._noise
        dr, weighted, A = moved - dJ @ x, dJ.T * w, (J.T * w) @ J
        off, by_motion = weighted * dr, (J.T * w) * dr  # the gradient; the second is common to the rows of a tick
        both = [part.reshape(len(x), *weight.shape).sum(axis=2) for part in (off, by_motion)]
        own = (J.T * (w * (1.0 - np.minimum(w * dr**2, 1.0)))) @ J  # of the readings by themselves
        scatter, size = own + sum(part @ part.T for part in both), np.sqrt(np.diag(A))
        A, gain = told(A - weighted @ dJ, scatter, off.sum(axis=1), size)
        return A, gain @ ((J.T * w) @ target - weighted @ moved), left


class Left(NamedTuple):
    """Rows about an estimate, to be held against another."""

    slope: FloatArray  # (t, m, n)
    target: FloatArray  # (t, m)
    ticks: SmoothedTicks
    lag: int  # ticks, between which the smoothing makes nothing alike

    def noise(self, z: FloatArray, before: FloatArray) -> FloatArray:
        """Mean square of what is left over of each row, over its variance, (m,); none below one.

        What is alike for longer than the smoothing makes it, as a process of first order with the correlation r at
        the first lag that shares no samples, counts ``(1 + r) / (1 - r)`` times (Priestley, Spectral Analysis, 1981).

        Args:
            z: the estimate.
            before: what it was held for, (m,): what is far off by that counts as Huber has it.
        """
        left = self.target - self.slope @ z
        squares = np.minimum(left**2 * self.ticks.weight, _HUBER**2 * before)
        count = (self.ticks.weight > 0.0).sum(axis=0)
        each = np.sign(left) * np.sqrt(squares)
        alike = (each[self.lag :] * each[: -self.lag]).sum(axis=0)
        alike = alike / np.maximum(squares[self.lag :].sum(axis=0), _TINY)
        alike = np.clip(alike - 2.0 / np.sqrt(np.maximum(count, 1)), 0.0, MOST_SHARE)
        loud = squares.sum(axis=0) / np.maximum(count, 1) * (1.0 + alike) / (1.0 - alike)
        return np.asarray(np.maximum(1.0, loud), np.float64)

    def shares(self, z: FloatArray, noise: FloatArray) -> "Shares":
        """What is left over, as shares."""
        weight = self.ticks.weight
        squares = (self.target - self.slope @ z) ** 2 * weight
        mean = (self.ticks.measured * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), _TINY)
        read = ((self.ticks.measured - mean) ** 2 * weight).sum(axis=0)
        far = float((squares > _FAR**2 * noise).sum() / max((weight > 0.0).sum(), 1))
        return Shares(np.sqrt(squares.sum(axis=0) / np.maximum(read, _TINY)), noise, far)


class Shares(NamedTuple):
    """What the likeliest hypothesis leaves over."""

    of_read: FloatArray  # (m,) of what is read of each row, its changes alone
    noise: FloatArray  # (m,) variance of each row over that stated
    far: float  # of all rows, those farther off than any noise
