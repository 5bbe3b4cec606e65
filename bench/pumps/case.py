"""A measurement, and where its rows and objects go."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers import records
from drivers.records import Batch, Rows
from onboard.ring import RingWriter

MS = 1_000_000
CAPACITY = 4096


def nothing() -> None:
    """Nothing is to be made ready."""


class PumpCase(NamedTuple):
    """One line of the table.

    Attributes:
        name: What is measured.
        bar: us a record, at most.
        records: In a pump.
        rows: That a pump must hand over.
        fill: Have the next pump's bytes wait. Not counted.
        ours: Pump and push; how many rows.
        naive: As many records, one object each.
        samples: Where it keeps them.
        naive_fill: As ``fill``, for it.
    """

    name: str
    bar: float
    records: int
    rows: int
    fill: Callable[[], None]
    ours: Callable[[], int]
    naive: Callable[[], None]
    samples: "deque[NaiveSample]"
    naive_fill: Callable[[], None] = nothing


@dataclass
class NaiveSample:
    """What the naive loop makes of a record."""

    host_ns: int
    number: int
    values: tuple[int, ...]


class Rings:
    """A ring for each channel, made when its first rows come."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rings: dict[str, RingWriter] = {}

    def push(self, channel: str, rows: Rows) -> int:
        """Push; how many rows."""
        ring = self._rings.get(channel)
        if ring is None:
            ring = self._rings[channel] = RingWriter(self._folder / f"{channel}.ring", rows.dtype, CAPACITY)
        ring.push(rows)
        return len(rows)

    def push_all(self, batches: list[Batch]) -> int:
        """Push the batches of one pump; how many rows.

        Raises:
            RuntimeError: There is an event or a gap among them: the stream is not the good one to be measured.
        """
        count = 0
        for channel, rows in batches:
            if channel in {"event", "gap"}:
                raise RuntimeError(f"a good stream made a {channel}: {rows}")
            count += self.push(channel, rows)
        return count


def push_one_by_one(samples: "deque[NaiveSample]", ring: RingWriter) -> None:
    """A row for each object, and a push for each row."""
    while samples:
        sample = samples.popleft()
        row = np.zeros(1, records.SCALAR)
        row[0] = (sample.number, sample.host_ns, sample.number, sum(sample.values), 1.0, "1", 0, 0, 0)
        ring.push(row)
