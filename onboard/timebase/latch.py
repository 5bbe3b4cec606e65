"""Where between two samples an edge fell, from the count that was latched on it.

An adapter whose clock ticks every 2 ms stamps an edge that coarsely. The count it latches is finer: while the joint
moves, the count says at which fraction of a sample period the joint was just there.
"""

from collections import deque

import numpy as np

from drivers.records import Rows


class LatchedCounts:
    """Positions by tick, and the place of latched counts among them."""

    REACH_TICKS, FEWEST = 10, 4  # on either side of the edge: samples as near as this, or else so many
    BUSY_TICKS = 4  # samples in the ticks just after an edge wait for the line, and come late
    COUNTS = 1.0  # the latched count is whole, and so are those about it, which may all be rounded alike
    HELD = 512

    def __init__(self) -> None:
        self._samples: deque[tuple[int, int]] = deque(maxlen=self.HELD)
        self._spacing = 1  # of samples, ticks

    @property
    def _reach(self) -> int:
        return max(self.REACH_TICKS, self.FEWEST * self._spacing)

    def clear(self) -> None:
        """The ticks began anew."""
        self._samples.clear()

    def append(self, rows: Rows) -> None:
        """Take in positions."""
        self._samples.extend(zip(rows["tick"].tolist(), rows["value_raw"].tolist(), strict=True))
        if len(rows) > 1:
            self._spacing = max(1, round(float(np.median(np.diff(rows["tick"].astype(np.int64))))))

    def complete(self, tick: int) -> bool:
        """Whether all samples have come that the place of an edge at ``tick`` is told by."""
        return bool(self._samples) and self._samples[-1][0] >= tick + self.BUSY_TICKS + self._reach

    def interval(self, tick: int, value: int) -> tuple[float, float]:
        """Ticks (low, high) between which the edge fell, in the time scale of the samples.

        A tick counts from the time of the sample that is stamped with it. Where the joint stands still, or too slowly
        for the count to tell, nothing is known but the stamp, and samples may be taken anywhere within their tick.
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
