"""Whitened residuals of an identification at its final estimate, on an even grid of ticks.

A model that is right leaves them with unit variance: by rows correlated over the smoothing kernel only, by maximum
likelihood not at all.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray

MOST = 60_000  # rows that are kept: the first
Residuals = dict[str, FloatArray]  # by series, (ticks,) in sigmas; NaN where none was used


class LeftOver(NamedTuple):
    """Of an instrument, in its unit: N m of a torque."""

    rms: float  # of what is left over
    of_rms: float  # of what it read, both sides smoothed


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))


class KeptRows:
    """Rows of an identifier.

    Args:
        instruments: that make them, by name.
    """

    def __init__(self, instruments: Sequence[str]) -> None:
        self._instruments = instruments
        self._kept: list[tuple[FloatArray, NDArray[np.intp], FloatArray, FloatArray]] = []
        self._count = 0

    def keep(self, times_s: FloatArray, instrument: NDArray[np.intp], rows: FloatArray, sigma: FloatArray) -> None:
        """Rows ``[Y, y]`` (m, p + 1), whitened by ``sigma``, with their times and instruments, (m,) each."""
        if self._count < MOST:
            self._count += len(rows)
            self._kept.append((times_s, instrument, rows, sigma))

    def left_over(self, mean: FloatArray) -> dict[str, "LeftOver"]:
        """What base parameters ``mean`` (p,) leave of each instrument's readings, every row alike."""
        if not self._kept:
            return {}
        _, instrument, rows, sigma = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        left, read = (part * sigma for part in (rows @ np.append(-mean, 1.0), rows[:, -1]))
        each = {name: instrument == number for number, name in enumerate(self._instruments)}
        return {name: LeftOver(_rms(left[mine]), _rms(read[mine])) for name, mine in each.items() if mine.any()}

    def residuals(self, mean: FloatArray, period_s: float) -> Residuals:
        """Of base parameters ``mean`` (p,), ticks ``period_s`` apart; rows of one instrument at a tick by number."""
        if not self._kept:
            return {}
        times_s, instrument, rows, _ = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        left = rows @ np.append(-mean, 1.0)
        tick = np.round((times_s - times_s[0]) / period_s).astype(np.int64)
        tick -= tick.min()
        found: Residuals = {}
        for number, name in enumerate(self._instruments):
            at, values = tick[instrument == number], left[instrument == number]
            order = np.argsort(at, kind="stable")
            at, values = at[order], values[order]
            rank = np.arange(len(at)) - np.searchsorted(at, at)  # of several rows at a tick
            for k in range(int(rank.max(initial=-1)) + 1):
                series = _series(at[rank == k], values[rank == k], int(tick.max()) + 1)
                found[name if not rank.any() else f"{name} {k + 1}"] = series
        return found


def _series(tick: NDArray[np.int64], values: FloatArray, size: int) -> FloatArray:
    """Values at their ticks, (size,); NaN at the others."""
    series = np.full(size, np.nan)
    series[tick] = values
    return series


def by_axis(time_s: FloatArray, left: FloatArray, period_s: float, further: Sequence[str] = ()) -> Residuals:
    """Series of the base IMU's six axes, and of the lines of further instruments; none of what is not used at all.

    Args:
        time_s: of the ticks, (n,).
        left: their whitened residuals, (n, lines), gyro and accelerometer first; NaN where none was used.
        period_s: between ticks.
        further: names of the lines after the sixth.
    """
    tick = np.round((time_s - time_s[0]) / period_s).astype(np.int64)
    names = [*(f"{one} {axis}" for one in ("gyro", "accelerometer") for axis in "xyz"), *further]
    used = ((name, values) for name, values in zip(names, left.T, strict=True) if not np.isnan(values).all())
    return {name: _series(tick, values, int(tick[-1]) + 1) for name, values in used}


def autocorrelation(series: FloatArray, lags: int) -> FloatArray:
    """Normalised autocorrelation at lags 0 to ``lags``, over the pairs that are known; NaN where there are none."""
    known = np.isfinite(series)
    centred = np.where(known, series - series[known].mean() if known.any() else 0.0, 0.0)
    found = np.full(lags + 1, np.nan)
    for lag in range(min(lags, len(series) - 1) + 1):
        pairs = int(np.count_nonzero(known[lag:] & known[: len(series) - lag]))
        if pairs:
            found[lag] = float(centred[lag:] @ centred[: len(series) - lag]) / pairs
    return np.asarray(found / found[0] if found[0] > 0.0 else np.full(lags + 1, np.nan), np.float64)
