"""Reads one ring for the recorder and accounts for recorded and lost sequence numbers."""

from typing import NamedTuple

import numpy as np

from drivers.records import Rows
from onboard.recording.recorded import ChannelProgress
from onboard.ring import RingReader

OVERRUN = "ring_overrun"


class Missing(NamedTuple):
    """Sequence numbers lost to the log: ``first`` to ``last``, both included."""

    first: int
    last: int
    from_ns: int  # host time of the row before
    to_ns: int  # of the row after; of the last missing one while there is none
    cause: str


class RingSource:
    """Reads or drops the rows of a ring and accounts for each.

    Args:
        ring: its reading end.
        recorded: last recorded row; None if there is none.
    """

    def __init__(self, ring: RingReader, recorded: ChannelProgress | None = None) -> None:
        self.ring, self.name = ring, ring.name
        self.missing: list[Missing] = []  # not yet in a gap record
        self.unplaced = 0  # lost rows without a jump of the sequence numbers
        self._last = recorded
        self._waiting = 0  # lost rows without a later row so far
        self._rejoining = recorded is not None and not ring.seek_after(recorded.sequence)

    def take(self) -> tuple[Rows, int]:
        """Rows to record, and the number lost by the ring."""
        rows, lost = self.ring.read()
        self._account(rows, lost)
        return rows, lost

    def drop(self, keep: int, cause: str) -> int:
        """Drop the oldest rows until at most ``keep`` remain; returns the number, including those lost by the ring."""
        excess = self.ring.backlog - keep
        if excess <= 0:
            return 0
        rows, lost = self.ring.read(excess)
        before = self._last
        self._account(rows, lost)
        if len(rows):
            sequence = rows["sequence"].astype(np.int64)
            host_ns = rows["host_ns"].astype(np.int64)
            starts = np.flatnonzero(np.concatenate([[True], np.diff(sequence) != 1]))
            ends = np.concatenate([starts[1:], [len(rows)]]) - 1
            before_ns = np.concatenate([[before.host_ns if before else host_ns[0]], host_ns[:-1]])
            for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
                span_ns = int(before_ns[start]), int(host_ns[end])
                self._miss(Missing(int(sequence[start]), int(sequence[end]), *span_ns, cause))
        return len(rows) + lost

    def _miss(self, missing: Missing) -> None:
        if self.missing and self.missing[-1].cause == missing.cause and self.missing[-1].last + 1 == missing.first:
            missing = missing._replace(first=self.missing[-1].first, from_ns=self.missing.pop().from_ns)
        self.missing.append(missing)

    def _account(self, rows: Rows, lost: int) -> None:
        """Locate ``lost`` rows at jumps of the sequence numbers before or among ``rows``."""
        self._waiting += lost
        if not len(rows):
            return
        if not (self._waiting or self._rejoining or self.missing):
            self._last = ChannelProgress(int(rows["sequence"][-1]), int(rows["host_ns"][-1]))
            return
        sequence, host_ns = rows["sequence"].astype(np.int64), rows["host_ns"].astype(np.int64)
        first_ns = int(host_ns[0])
        if self.missing and self.missing[-1].last + 1 == sequence[0]:
            self.missing[-1] = self.missing[-1]._replace(to_ns=first_ns)
        last = self._last or ChannelProgress(-1, first_ns)
        if self._rejoining:  # all rows between the log and the ring are lost, whatever the ring has counted
            self._waiting, self._rejoining = max(0, int(sequence[0]) - last.sequence - 1), False
        if self._waiting:
            before = np.concatenate([[last.sequence], sequence[:-1]])
            before_ns = np.concatenate([[last.host_ns], host_ns[:-1]])
            for jump in np.flatnonzero(sequence - before > 1):
                first, end = int(before[jump]) + 1, int(sequence[jump])
                self._miss(Missing(first, end - 1, int(before_ns[jump]), int(host_ns[jump]), OVERRUN))
                self._waiting -= end - first
                if self._waiting <= 0:  # further jumps are losses already reported by the device
                    break
            self.unplaced += max(0, self._waiting)
            self._waiting = 0
        self._last = ChannelProgress(int(sequence[-1]), int(host_ns[-1]))
