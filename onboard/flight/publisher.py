"""Batches into rings. Gives the rows of channels that many hands write (events, gaps) their sequence numbers."""

import threading
from collections.abc import Iterable, Mapping

from drivers.records import Batch
from onboard.ring import RingWriter

SHARED_CHANNELS = ("event", "gap")


class Publisher:
    """The one writer of a process's rings.

    Args:
        rings: by channel name.
        suffix: appended to the names of shared channels, so that every process has its own (``event_estimation``).
    """

    def __init__(self, rings: Mapping[str, RingWriter], suffix: str = "") -> None:
        self._rings, self._suffix = rings, suffix
        self._lock = threading.Lock()

    def publish(self, batches: Iterable[Batch]) -> None:
        """Push each batch into its channel's ring."""
        for channel, rows in batches:
            if channel in SHARED_CHANNELS:
                with self._lock:
                    ring = self._rings[channel + self._suffix]
                    first = ring.published
                    rows["sequence"] = range(first, first + len(rows))
                    ring.push(rows)
            else:
                self._rings[channel].push(rows)
