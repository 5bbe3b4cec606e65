"""Coherent lines in a filter's innovations: slosh, a flexible joint, or a disturbance that the model does not have.

Whitened innovations of a consistent filter are white with unit variance, so the periodogram of a block is exponential
with mean 1 at every frequency (Brockwell and Davis, Time Series: Theory and Methods, section 10.3). A chi-squared over
all frequencies hardly shows a line: 0.2 sigma of a tick are 4 % of it, and 20 times the mean in its own bin.

A swing as slow as the arm's motion leaves no line: the payload, whose effect has the same frequencies, takes up most of
it, and a window of four seconds has not two of its periods. What is left over is slow all the same. The variance of an
estimate from slow motion follows from the spectral density of the noise at its frequencies, not from all of its power:
what residuals of a window have below 1.5 Hz, and half-second sums of innovations, 1 for white noise, multiplies it.

Where springs keep every window from being explained there are no innovations. What they swing shows in the residuals of
the fit that came nearest, as a peak that holds most of the power of one channel: by a periodogram with Hann's window,
which keeps slow residuals from leaking into it (Percival and Walden, Spectral Analysis for Physical Applications, 6.4).
Below 1.5 Hz the arm's motion leaves peaks as well, whatever is wrong: none is named.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import DOUBT, MOSTLY, of_each
from onboard.identification.online import CONTACT_s

_BLOCK_s = 8.0
_BLOCKS = round(3600.0 / _BLOCK_s)  # of an hour; as many times half-second sums are all new ones
_CHANNELS = 6
RECENT_s = 60.0  # for which a line is remembered
_SLOW_Hz = 1.5  # the arm moves at 0.1 to 0.6 Hz
_SUMMED_s = 0.5  # at once; what is recent is a block of sums. The first wait, which doubles until it is a block
_SENSORS = "gyro", "accelerometer"


class Line(NamedTuple):
    """The strongest line so far."""

    power: float  # of its bin, 1 for white noise
    beyond: float  # the same, of the power that the largest of all bins of a block is expected to have
    frequency_Hz: float  # noqa: N815
    instrument: str


class SlowPower:
    """Power of whitened residuals at the frequencies of the arm's motion, by sensor: chi-squared, if they are white.

    Of the window from which the filter goes on, below 1.5 Hz; and of the innovations since and of the last of them, of
    which half seconds are summed up.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.forget()

    def forget(self) -> None:
        """Clear the sums after a reset of the filter."""
        self._window = self._since = np.zeros(2), 0  # squares by sensor, degrees of freedom of each
        self._recent = deque[FloatArray](maxlen=round(_BLOCK_s / _SUMMED_s))
        self._sum, self._summed, self._ticks = np.zeros(_CHANNELS), 0, 0
        self._ratios: list[tuple[str, float, float]] | None = None  # sensor, mean power, its chance; None: not computed

    def begin(self, residual: FloatArray) -> None:
        """The filter goes on from a window: its whitened residuals, gyro then accelerometer, (n, 6)."""
        self.forget()
        power = np.abs(np.fft.rfft(np.nan_to_num(residual), axis=0)) ** 2 / len(residual)
        bins = int(_SLOW_Hz * len(residual) * self._period_s)
        slow = 2.0 * power[1 : 1 + bins].reshape(-1, 2, 3).sum(axis=(0, 2))
        self._window, self._ratios = (slow, 6 * min(bins, len(power) - 1)), None

    def add(self, innovation: FloatArray, ticks: int) -> None:
        """Take in a batch: the innovations of the ticks that were used, (u, 6), of so many."""
        self._sum = self._sum + innovation.sum(axis=0)
        self._summed, self._ticks = self._summed + len(innovation), self._ticks + ticks
        if self._ticks * self._period_s < _SUMMED_s:
            return
        if self._summed:
            squares = (self._sum**2 / self._summed).reshape(2, 3).sum(axis=1)
            self._since = self._since[0] + squares, self._since[1] + 3
            self._recent.append(squares)
            self._ratios = None
        self._sum, self._summed, self._ticks = np.zeros(_CHANNELS), 0, 0

    def by_sensor(self, budget: float) -> dict[str, float]:
        """Of those whose power is by chance in fewer flights than the budget: its mean, 1 for white noise."""
        if self._ratios is None:
            recent = np.sum([np.zeros(2), *self._recent], axis=0), 3 * len(self._recent)
            self._ratios = [
                (name, total / freedom, float(chdtrc(freedom, total)))
                for squares, freedom in (self._window, self._since, recent)
                for name, total in zip(_SENSORS, squares.tolist(), strict=True)
                if freedom
            ]
        chance, found = of_each(budget, len(_SENSORS) * _BLOCKS), dict[str, float]()
        for name, ratio, chance_of in self._ratios:
            if chance_of < chance:
                found[name] = max(found.get(name, 0.0), ratio)
        return found


class InnovationLines:
    """Periodograms of whitened innovations, block by block.

    Args:
        period_s: between ticks.

    Attributes:
        strongest: None while there is none.
        slow: power at the frequencies of the arm's motion.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.slow = SlowPower(period_s)
        self._block = np.zeros((round(_BLOCK_s / period_s), _CHANNELS))
        self._filled = self._used = 0
        self.strongest: Line | None = None

    def forget(self) -> None:
        """Begin a new block after a reset of the filter; the strongest line stays."""
        self._filled = self._used = 0
        self.slow.forget()

    def begin(self, residual: FloatArray) -> None:
        """The filter goes on from a window with these whitened residuals, (n, 6)."""
        self.forget()
        self.slow.begin(residual)

    def add(self, innovation: FloatArray, use: BoolArray) -> None:
        """Takes in a batch.

        Args:
            innovation: whitened, of the ticks that were used, gyro then accelerometer, (6 u,).
            use: which ticks of the batch these are, (b,).
        """
        ticks = np.zeros((len(use), _CHANNELS))
        ticks[use] = innovation.reshape(-1, _CHANNELS)
        self.slow.add(ticks[use], len(use))
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
        if largest > expected - np.log(of_each(DOUBT, _BLOCKS)) and largest > known:
            frequency = (place + 1) / (self._filled * self._period_s)
            self.strongest = Line(largest, largest / expected, frequency, _SENSORS[channel // 3])
        self._filled = self._used = 0


class Unexplained:
    """Windows that no hypothesis explains, of one filter: how long to wait, and the lines in what is left over.

    Args:
        period_s: between ticks.

    Attributes:
        count: since the filter's last steps, windows that contradicted a shorter one or the steps since, that were not
            explained after a wait either, or that left a line.
        between: which instruments contradict each other, where the last window was explained without either.
        wait: ticks to wait before the next window; its length comes on top.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s, self._contact = period_s, round(CONTACT_s / period_s)
        self._first, self._longest = (round(wait_s / period_s) for wait_s in (_SUMMED_s, _BLOCK_s))
        self.settle()
        self._lines: list[tuple[float, float, Line]] = []  # first and last time of the window

    def begin(self, *, change: bool = False) -> None:
        """No window yet; the first one after a change waits until the contact is over."""
        self.wait = self._contact if change else 0

    def add(self, end_s: float, residual: FloatArray | None, *, longer: bool, between: str = "") -> None:
        """Take in a window.

        Args:
            end_s: vehicle time.
            residual: whitened, of the nearest fit, gyro then accelerometer, (n, 6); None if there was no fit.
            longer: a shorter window was explained.
            between: see the attribute.
        """
        self.between = between
        line = None if residual is None else line_of(residual, self._period_s)
        self.count += longer or self.wait > self._contact or line is not None
        waited = self.wait if self.wait > self._contact else 0
        self.wait = min(max(2 * waited, self._first), self._longest)
        self._lines = [one for one in self._lines if one[1] > end_s - RECENT_s]
        if residual is not None and line is not None:
            self._lines.append((end_s - len(residual) * self._period_s, end_s, line))

    @property
    def line(self) -> Line | None:
        """The last one found in the last minute of windows; None if there was none."""
        return self._lines[-1][2] if self._lines else None

    @property
    def swings(self) -> bool:
        """Whether two windows of a minute without a common tick have lines: something does so by itself."""
        return bool(self._lines) and self._lines[0][1] <= self._lines[-1][0]

    def settle(self) -> None:
        """The filter steps again."""
        self.count, self.wait, self.between = 0, 0, ""


def line_of(residual: FloatArray, period_s: float) -> Line | None:
    """The line in whitened residuals, (n, 6); None where no peak holds most of a channel's power."""
    n = len(residual)
    power = np.abs(np.fft.rfft(_detrended(residual) * np.hanning(n)[:, None], axis=0)) ** 2  # (n // 2 + 1, 6)
    lowest = int(np.ceil(_SLOW_Hz * n * period_s)) + 1
    if len(power) < lowest + 2:
        return None
    peaks = power[lowest - 1 : -2] + power[lowest:-1] + power[lowest + 1 :]  # of three bins, Hann's main lobe
    place, channel = divmod(int(peaks.argmax()), power.shape[1])
    if peaks[place, channel] < MOSTLY * power[:, channel].sum():
        return None
    scale = float(3.0 * (np.hanning(n) ** 2).sum())  # of three bins of white noise of unit variance
    beyond = float(peaks[place, channel]) / scale
    return Line(beyond, beyond / np.log(power.size), (place + lowest) / (n * period_s), _SENSORS[channel // 3])


def _detrended(residual: FloatArray) -> FloatArray:
    """Less the straight line that fits each channel, (n, 6)."""
    at = np.linspace(-1.0, 1.0, len(residual))
    return np.asarray(residual - residual.mean(axis=0) - np.outer(at, at @ residual / (at @ at)), np.float64)
