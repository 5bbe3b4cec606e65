"""Time of a sync edge between two samples, from the encoder count latched on it.

An adapter with a 2 ms tick stamps an edge with that resolution. While the joint moves, the latched count gives the
fraction of the sample period at which the joint was at that position.
"""

from collections import deque

import numpy as np

from drivers.records import Rows


class LatchedCounts:
    """Positions by tick, and interpolation of latched counts among them."""

    REACH_TICKS, FEWEST = (10, 4)  # samples used on either side of the edge: within so many ticks, at least so many
    BUSY_TICKS = 4  # samples in the ticks just after an edge are delayed by the busy line
    COUNTS = 1.0  # quantisation of the latched count and its neighbours, which may be rounded alike
    HELD = 512

    def __init__(self) -> None:
        self._samples: deque[tuple[int, int]] = deque(maxlen=self.HELD)
        self._spacing = 1  # sample spacing, ticks

    @property
    def _reach(self) -> int:
        return max(self.REACH_TICKS, self.FEWEST * self._spacing)

    def clear(self) -> None:
        """The ticks restarted."""
        self._samples.clear()

    def append(self, rows: Rows) -> None:
        """Add positions."""
        self._samples.extend(zip(rows["tick"].tolist(), rows["value_raw"].tolist(), strict=True))
        if len(rows) > 1:
            self._spacing = max(1, round(float(np.median(np.diff(rows["tick"].astype(np.int64))))))

    def complete(self, tick: int) -> bool:
        """Whether all samples needed to locate an edge at ``tick`` have arrived."""
        return bool(self._samples) and self._samples[-1][0] >= tick + self.BUSY_TICKS + self._reach

    def interval(self, tick: int, value: int) -> tuple[float, float]:
        """Interval (low, high) of the edge, in ticks on the time scale of the samples.

        A tick begins at the time of the sample stamped with it. If the joint is at rest or too slow for the count to
        resolve, only the stamp is used, and samples may lie anywhere within their tick.
        """
        stamp = float(tick - 1), float(tick + 1)
        first, busy = tick - self._reach, tick + self.BUSY_TICKS
        last = busy + self._reach
        near = [(t - tick, v - value) for t, v in self._samples if first <= t < tick or busy <= t <= last]
        if len(near) < 2 * self.FEWEST:
            return stamp
        since, counts = np.array(near, np.float64).T
        fit = np.polyfit(since, counts, 2)
        scatter = float(np.sqrt(np.mean((np.polyval(fit, since) - counts) ** 2)))
        place, slope = 0.0, float(fit[1])
        for _ in range(4):
            slope = float(2.0 * fit[0] * place + fit[1])
            if slope == 0.0:
                return stamp
            place = float(np.clip(place - np.polyval(fit, place) / slope, -1.0, 2.0))
        half = (self.COUNTS + scatter) / abs(slope)
        return (tick + place - half, tick + place + half) if half < 1.0 else stamp
