"""Missing sequence numbers of a channel, as sets of ranges."""

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows

Ranges = NDArray[np.int64]  # (n, 2): first and last number of each, both included

NO_RANGES: Ranges = np.empty((0, 2), np.int64)


def union(ranges: Ranges) -> Ranges:
    """The numbers of ``ranges`` (n, 2) as ascending, disjoint, non-adjacent ranges."""
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    if not len(ranges):
        return NO_RANGES
    reach = np.maximum.accumulate(ranges[:, 1])
    opens = np.concatenate([[True], ranges[1:, 0] > reach[:-1] + 1])
    return np.stack([ranges[opens, 0], reach[np.concatenate([opens[1:], [True]])]], axis=1)


def count(ranges: Ranges) -> int:
    """Count of numbers in disjoint ``ranges`` (n, 2)."""
    return int((ranges[:, 1] - ranges[:, 0] + 1).sum())


def common(a: Ranges, b: Ranges) -> int:
    """Count of numbers in both of two sets."""
    return count(union(a)) + count(union(b)) - count(union(np.concatenate([a, b])))


class Continuity:
    """Tracks the sequence numbers of one channel: call ``add`` with its rows in order."""

    def __init__(self) -> None:
        self.rows = 0
        self.repeated = 0  # rows whose number is not above the previous one: duplicate, or restart
        self.first_sequence = self.last_sequence = 0
        self.first_ns = self.last_ns = 0
        self._missing: list[Ranges] = []

    def add(self, rows: Rows) -> None:
        """Add the next rows (n,), n > 0."""
        sequence = rows["sequence"].astype(np.int64)
        if not self.rows:
            self.first_sequence, self.first_ns = int(sequence[0]), int(rows["host_ns"][0])
        else:
            sequence = np.concatenate([[self.last_sequence], sequence])
        step = np.diff(sequence)
        jumps = np.flatnonzero(step > 1)
        if len(jumps):
            self._missing.append(np.stack([sequence[jumps] + 1, sequence[jumps + 1] - 1], axis=1))
        self.repeated += int(np.count_nonzero(step <= 0))
        self.rows += len(rows)
        self.last_sequence, self.last_ns = int(sequence[-1]), int(rows["host_ns"][-1])

    @property
    def missing(self) -> Ranges:
        """Numbers missing between the first and the last row, ranges (n, 2)."""
        return np.concatenate([NO_RANGES, *self._missing])

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of arrival, Hz; None for fewer than two instants."""
        duration_ns = self.last_ns - self.first_ns
        return (self.rows - 1) * 1e9 / duration_ns if duration_ns > 0 else None
