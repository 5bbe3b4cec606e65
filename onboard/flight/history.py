"""The last few seconds of a channel as arrays, with amortised shifts."""

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows

STAMPS = np.dtype([("tick", "<i8"), ("host_ns", "<i8")])


class History:
    """Stamps (n,), values (n, columns) and validity (n,) of the newest samples, at least ``capacity`` of them.

    Args:
        capacity: samples that are kept for certain; memory for twice as many is held.
        columns: values of one sample.
    """

    def __init__(self, capacity: int, columns: int) -> None:
        self._capacity = capacity
        self._stamps = np.zeros(2 * capacity, STAMPS)
        self._values = np.zeros((2 * capacity, columns))
        self._valid = np.zeros(2 * capacity, np.bool_)
        self._end = 0

    def append(self, rows: Rows, values: NDArray[np.float64], valid: NDArray[np.bool_]) -> None:
        """Add samples: rows with ``tick`` and ``host_ns`` (n,), values (n, columns), valid (n,)."""
        rows, values, valid = rows[-self._capacity :], values[-self._capacity :], valid[-self._capacity :]
        count = len(rows)
        if count == self._capacity:
            self._end = 0  # older samples lie before a gap
        if self._end + count > len(self._stamps):
            keep = slice(self._end - min(self._end, self._capacity), self._end)
            kept = keep.stop - keep.start
            for array in (self._stamps, self._values, self._valid):
                array[:kept] = array[keep].copy()
            self._end = kept
        here = slice(self._end, self._end + count)
        for field in STAMPS.names or ():
            self._stamps[field][here] = rows[field]
        self._values[here], self._valid[here] = values, valid
        self._end += count

    def clear(self) -> None:
        """Clear: the device's ticks restarted."""
        self._end = 0

    @property
    def stamps(self) -> Rows:
        """Device ticks and arrival stamps (n,), oldest first; dtype :data:`STAMPS`."""
        return self._stamps[: self._end]

    @property
    def values(self) -> NDArray[np.float64]:
        """Values (n, columns)."""
        return self._values[: self._end]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Whether each sample may be used (n,)."""
        return self._valid[: self._end]
