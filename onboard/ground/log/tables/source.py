"""Channels of a log, taken a stretch of time at a time."""

from collections.abc import Iterable, Iterator

import numpy as np

from drivers.records import Batch, Rows
from onboard.recording.reader import LogReader

_MOST_LATE_NS = 5_000_000_000  # of rows that wait in memory for those that the file has later


class Interleaved:
    """Rows of several channels by their stamps, whatever the order of the channels in the file.

    A first pass finds by how much rows stand later in the file than rows stamped after them. A flight's log keeps
    nearly the order of the stamps, and one pass more serves all channels; a log whose channels lie one after the other
    is read by a pass for each channel. Memory is constant in the length of the log.

    Args:
        log: to read.
        channels: of these, those that it has.

    Attributes:
        start_ns: the least stamp that a channel begins with; None where there are no rows.
        first_ns: the least stamp of any row of the log, of whatever channel; None likewise.
    """

    def __init__(self, log: LogReader, channels: Iterable[str]) -> None:
        names = [name for name in channels if name in log.channels]
        self.start_ns: int | None = None
        self.first_ns: int | None = None
        newest_ns, late_ns, begun = np.iinfo(np.int64).min, 0, set()
        for name, rows in log.batches():
            first, least, most = (int(ns) for ns in (rows["host_ns"][0], rows["host_ns"].min(), rows["host_ns"].max()))
            self.first_ns = least if self.first_ns is None else min(self.first_ns, least)
            if name not in names:
                continue
            if name not in begun:
                begun.add(name)
                self.start_ns = first if self.start_ns is None else min(self.start_ns, first)
            late_ns, newest_ns = max(late_ns, newest_ns - least), max(newest_ns, most)
        groups = [names] if late_ns <= _MOST_LATE_NS else [[name] for name in names]
        self._passes = [_Pass(log, group, min(late_ns, _MOST_LATE_NS)) for group in groups]

    @property
    def done(self) -> bool:
        """Whether every row has been taken."""
        return all(one.done for one in self._passes)

    @property
    def next_ns(self) -> int | None:
        """Least stamp of the rows that wait, exact to how late rows stand in the file; None where none is left."""
        stamps = [stamp for one in self._passes if not one.done for stamp in one.first_ns()]
        return min(stamps, default=None)

    def take(self, until_ns: int) -> dict[str, Rows]:
        """By channel the rows before its first that is stamped ``until_ns`` or later."""
        return {name: rows for one in self._passes for name, rows in one.take(until_ns).items()}


class _Pass:
    """One pass: rows wait from when they are come across until they are taken."""

    def __init__(self, log: LogReader, names: list[str], late_ns: int) -> None:
        self._late_ns, self._newest_ns = late_ns, np.iinfo(np.int64).min
        self._waiting: dict[str, list[Rows]] = {name: [np.empty(0, log.channels[name])] for name in names}
        self._batches: Iterator[Batch] = log.batches(names)
        self._ended = False

    @property
    def done(self) -> bool:
        while not self._ended and not any(len(part) for parts in self._waiting.values() for part in parts):
            self._read_on()
        return self._ended and not any(len(part) for parts in self._waiting.values() for part in parts)

    def first_ns(self) -> list[int]:
        """Stamp of the first waiting row of each channel."""
        return [int(part["host_ns"][0]) for parts in self._waiting.values() for part in parts if len(part)]

    def _read_on(self) -> None:
        batch = next(self._batches, None)
        if batch is None:
            self._ended = True
            return
        self._waiting[batch.channel].append(batch.rows)
        self._newest_ns = max(self._newest_ns, int(batch.rows["host_ns"].max()))

    def take(self, until_ns: int) -> dict[str, Rows]:
        while not self._ended and self._newest_ns - self._late_ns < until_ns:
            self._read_on()
        taken = {}
        for name, parts in self._waiting.items():
            rows = np.concatenate(parts) if len(parts) > 1 else parts[0]
            late = rows["host_ns"] >= until_ns
            count = int(np.argmax(late)) if late.any() else len(rows)
            taken[name] = rows[:count]
            self._waiting[name] = [rows[count:]]
        return taken
