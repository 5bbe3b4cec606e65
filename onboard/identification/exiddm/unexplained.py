"""Windows that no hypothesis explains: how long to wait, what to say of the answer, and a line in what is left over.

A spring between the joints and the base (a flexible joint, slosh) leaves a swing that no payload makes. It shows in the
residuals of the fit that came nearest, as a peak that holds most of the power of one channel: by a periodogram with
Hann's window, which keeps slow residuals from leaking into it (Percival and Walden, Spectral Analysis for Physical
Applications, section 6.4). Up to 1 Hz the arm's own motion leaves peaks as well, whatever is wrong: none is named.
"""

import numpy as np
from scipy.signal import detrend

from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.lines import Line

_WAITS_s = 0.5, 8.0  # the first, which doubles, and the longest
_RECENT_s = 60.0  # for which a line is remembered
_LOWEST_Hz, _FEWEST_CYCLES = 1.0, 2  # of a line: above the one, no fewer than the other
_MOST = 0.5  # of its channel's power: what a line holds at least


class Unexplained:
    """Of one filter.

    Args:
        period_s: between ticks.

    Attributes:
        count: since the filter's last steps, windows that contradicted a shorter one, or that were not explained after
            a wait either.
        wait: ticks to wait before the next window; its length comes on top.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._first, self._longest = (round(wait_s / period_s) for wait_s in _WAITS_s)
        self.count = self.wait = 0
        self._lines: list[tuple[float, Line]] = []

    def add(self, end_s: float, residual: FloatArray | None, *, longer: bool) -> None:
        """Take in a window.

        Args:
            end_s: vehicle time.
            residual: whitened, of the nearest fit, gyro then accelerometer, (n, 6); None if there was no fit.
            longer: a shorter window was explained.
        """
        self.count += longer or self.wait > 0
        self.wait = min(max(2 * self.wait, self._first), self._longest)
        line = None if residual is None else line_of(residual, self._period_s)
        self._lines = [one for one in self._lines if one[0] > end_s - _RECENT_s] + ([(end_s, line)] if line else [])

    @property
    def line(self) -> Line | None:
        """The last one found in the last minute of windows; None if there was none."""
        return self._lines[-1][1] if self._lines else None

    @property
    def swings(self) -> bool:
        """Whether lines were found in two windows of a minute or more: something does so by itself."""
        return len(self._lines) > 1

    def settle(self) -> None:
        """The filter steps again."""
        self.count = self.wait = 0


def line_of(residual: FloatArray, period_s: float) -> Line | None:
    """The line in whitened residuals, (n, 6); None where no peak holds most of a channel's power."""
    n = len(residual)
    power = np.abs(np.fft.rfft(detrend(residual, axis=0) * np.hanning(n)[:, None], axis=0)) ** 2  # (n // 2 + 1, 6)
    lowest = max(_FEWEST_CYCLES, int(np.ceil(_LOWEST_Hz * n * period_s)) + 1)
    if len(power) < lowest + 2:
        return None
    peaks = power[lowest - 1 : -2] + power[lowest:-1] + power[lowest + 1 :]  # of three bins, Hann's main lobe
    place, channel = divmod(int(peaks.argmax()), power.shape[1])
    if peaks[place, channel] < _MOST * power[:, channel].sum():
        return None
    name = "gyro" if channel < power.shape[1] // 2 else "accelerometer"
    scale = float(3.0 * (np.hanning(n) ** 2).sum())  # of three bins of white noise of unit variance
    beyond = float(peaks[place, channel]) / scale
    return Line(beyond, beyond / np.log(power.size), (place + lowest) / (n * period_s), name)
