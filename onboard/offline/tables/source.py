"""A channel of a log, taken a stretch of time at a time."""

import numpy as np

from drivers.records import Rows
from onboard.recording.reader import LogReader


class ChannelRows:
    """The rows of one channel, in the order of the file."""

    def __init__(self, log: LogReader, name: str) -> None:
        self._batches = log.batches([name])
        self._rows: Rows = np.empty(0, log.channels[name])
        self._fill()

    def _fill(self) -> None:
        while not len(self._rows) and (batch := next(self._batches, None)) is not None:
            self._rows = batch.rows

    @property
    def next_ns(self) -> int | None:
        """Stamp of the next row; None at the end."""
        return int(self._rows["host_ns"][0]) if len(self._rows) else None

    def take(self, until_ns: int) -> Rows:
        """Rows before the first that is stamped ``until_ns`` or later."""
        parts = [self._rows[:0]]
        while len(self._rows):
            late = self._rows["host_ns"] >= until_ns
            count = int(np.argmax(late)) if late.any() else len(self._rows)
            parts.append(self._rows[:count])
            self._rows = self._rows[count:]
            if len(self._rows):
                break
            self._fill()
        return np.concatenate(parts)
