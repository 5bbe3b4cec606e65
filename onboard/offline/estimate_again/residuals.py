"""Whitened residuals of an identification by rows, at its final estimate, on an even grid of ticks.

A model that is right leaves them with unit variance, correlated over the smoothing kernel only.
"""

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.row_blocks import RowBlocks

MOST = 60_000  # rows that are kept: the first
Residuals = dict[str, FloatArray]  # by series, (ticks,) in sigmas; NaN where none was used


class KeptRows(RowBlocks):
    """The blocks of an identifier, which also keep the rows themselves.

    Args:
        blocks: of the identifier, not filled yet.
    """

    def __init__(self, blocks: RowBlocks) -> None:
        super().__init__(1, 1.0, blocks.instruments)
        self.__dict__.update(blocks.__dict__)
        self._kept: list[tuple[FloatArray, NDArray[np.intp], FloatArray]] = []
        self._count = 0

    def add(
        self,
        times_s: FloatArray,
        held: BoolArray,
        instrument: NDArray[np.intp],
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        noise: FloatArray | None,
    ) -> None:
        """As of the base class."""
        super().add(times_s, held, instrument, Y, y, sigma, noise)
        if self._count < MOST:
            self._count += len(y)
            self._kept.append((times_s, instrument, np.column_stack([Y, y]) / sigma[:, None]))

    def residuals(self, mean: FloatArray, period_s: float) -> Residuals:
        """Of base parameters ``mean`` (p,), ticks ``period_s`` apart; rows of one instrument at a tick by number."""
        if not self._kept:
            return {}
        times_s, instrument, rows = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        left = rows @ np.append(-mean, 1.0)
        tick = np.round((times_s - times_s[0]) / period_s).astype(np.int64)
        tick -= tick.min()
        found: Residuals = {}
        for number, name in enumerate(self.instruments):
            at, values = tick[instrument == number], left[instrument == number]
            order = np.argsort(at, kind="stable")
            at, values = at[order], values[order]
            rank = np.arange(len(at)) - np.searchsorted(at, at)  # of several rows at a tick
            for k in range(int(rank.max(initial=-1)) + 1):
                series = np.full(int(tick.max()) + 1, np.nan)
                series[at[rank == k]] = values[rank == k]
                found[name if not rank.any() else f"{name} {k + 1}"] = series
        return found


def keep_rows(who: Identifier) -> KeptRows:
    """Have ``who``, which has taken in nothing yet, keep its rows."""
    kept = KeptRows(who.seen)
    who.seen = kept
    return kept


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
