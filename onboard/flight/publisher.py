"""Pushes batches into rings; numbers the rows of shared channels (events, gaps).

A process that takes over the rings of a dead one continues their sequence numbers: its devices count from 0 again, so
their numbers are shifted past those estimated to be lost meanwhile, which a GAP row records.
"""

import threading
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from drivers.records import Batch, Rows, SampleStatus, gap
from onboard.ring import RingWriter

SHARED_CHANNELS = ("event", "gap")
RESTART = "worker_restart"


class _Left(NamedTuple):
    """Last rows of the previous process in a channel."""

    sequence: int
    host_ns: int
    period_ns: float


class Publisher:
    """The one writer of a process's rings.

    Args:
        rings: by channel name. Those that hold rows are taken over from a process that died.
        suffix: appended to the names of shared channels, so that every process has its own (``event_estimation``).
        renumber: devices start their numbers at 0 in this process.
    """

    def __init__(self, rings: Mapping[str, RingWriter], suffix: str = "", *, renumber: bool = False) -> None:
        self._rings, self._suffix = rings, suffix
        self._lock = threading.Lock()
        self._shift: dict[str, int] = {}
        self._left: dict[str, _Left] = {}
        if renumber:
            for name, ring in rings.items():
                if name not in SHARED_CHANNELS and len(rows := ring.newest()):
                    self._left[name] = _left(rows)

    def publish(self, batches: Iterable[Batch]) -> None:
        """Push each batch into its channel's ring."""
        for channel, rows in batches:
            if channel in SHARED_CHANNELS:
                self._publish_shared(channel, rows)
            elif len(rows):
                if channel in self._left:
                    self._take_over(channel, int(rows["host_ns"][0]))
                    if "status" in (rows.dtype.names or ()):
                        rows["status"][0] |= SampleStatus.AFTER_RESET
                if channel in self._shift:
                    rows["sequence"] += np.uint64(self._shift[channel])
                self._rings[channel].push(rows)

    def _publish_shared(self, channel: str, rows: Rows) -> None:
        if channel == "gap":
            for row in rows:
                name = row["channel"].decode()
                if name in self._left:
                    self._take_over(name, int(row["host_ns"]))
                for field in ("first_missing", "last_missing"):
                    row[field] += np.uint64(self._shift.get(name, 0))
        self._number(channel, rows)

    def _number(self, channel: str, rows: Rows) -> None:
        with self._lock:
            ring = self._rings[channel + self._suffix]
            first = ring.published
            rows["sequence"] = range(first, first + len(rows))
            ring.push(rows)

    def _take_over(self, channel: str, host_ns: int) -> None:
        """Continue the numbers of ``channel`` and record the rows lost until ``host_ns`` as a gap."""
        sequence, left_ns, period_ns = self._left.pop(channel)
        missed = max(0, round((host_ns - left_ns) / period_ns) - 1) if period_ns else 0
        self._shift[channel] = sequence + 1 + missed
        if missed:
            told = gap(host_ns, channel, sequence + 1, sequence + missed, host_ns - left_ns, RESTART)
            self._number("gap", told.rows)


def _left(rows: Rows) -> _Left:
    """The newest of ``rows`` (n,), and the channel's mean period in them; 0 where they do not tell."""
    numbers = int(rows["sequence"][-1] - rows["sequence"][0])
    span_ns = int(rows["host_ns"][-1] - rows["host_ns"][0])
    return _Left(int(rows["sequence"][-1]), int(rows["host_ns"][-1]), span_ns / numbers if numbers else 0.0)
