"""Coherent lines in a filter's innovations: slosh, a flexible joint, or a disturbance that the model does not have.

Whitened innovations of a consistent filter are white with unit variance, so the periodogram of a block is exponential
with mean 1 at every frequency (Brockwell and Davis, Time Series: Theory and Methods, section 10.3). A chi-squared over
all frequencies hardly shows a line: 0.2 sigma of a tick are 4 % of it, and 20 times the mean in its own bin.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray

_BLOCK_s = 8.0
_CHANCE = 1e-6  # of the largest of all bins of a block: what is exceeded more rarely is a line
_CHANNELS = 6


class Line(NamedTuple):
    """The strongest line so far."""

    power: float  # of its bin, 1 for white noise
    beyond: float  # the same, of the power that the largest of all bins of a block is expected to have
    frequency_Hz: float  # noqa: N815
    instrument: str


class InnovationLines:
    """Periodograms of whitened innovations, block by block.

    Args:
        period_s: between ticks.

    Attributes:
        strongest: None while there is none.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._block = np.zeros((round(_BLOCK_s / period_s), _CHANNELS))
        self._filled = self._used = 0
        self.strongest: Line | None = None

    def forget(self) -> None:
        """Begin a new block after a reset of the filter; what was found stays."""
        self._filled = self._used = 0

    def add(self, innovation: FloatArray, use: BoolArray) -> None:
        """Takes in a batch.

        Args:
            innovation: whitened, of the ticks that were used, gyro then accelerometer, (6 u,).
            use: which ticks of the batch these are, (b,).
        """
        ticks = np.zeros((len(use), _CHANNELS))
        ticks[use] = innovation.reshape(-1, _CHANNELS)
        end = self._filled + len(ticks)
        if end > len(self._block):
            self._look()
            end = len(ticks)
        self._block[end - len(ticks) : end] = ticks
        self._filled, self._used = end, self._used + int(use.sum())

    def _look(self) -> None:
        power = np.abs(np.fft.rfft(self._block[: self._filled], axis=0)[1:]) ** 2 / max(self._used, 1)
        place, channel = divmod(int(power.argmax()), _CHANNELS)
        largest, expected = float(power[place, channel]), float(np.log(power.size))
        known = 0.0 if self.strongest is None else self.strongest.power
        if largest > expected - np.log(_CHANCE) and largest > known:
            frequency = (place + 1) / (self._filled * self._period_s)
            name = "gyro" if channel < _CHANNELS // 2 else "accelerometer"
            self.strongest = Line(largest, largest / expected, frequency, name)
        self.forget()
