"""Samples of a log on vehicle time, by the onboard timebase fed from the log.

A sample is timed when its clock has heard what came up to ``_LAG_NS`` after it, as the estimator does; samples from
before a clock's first solution by its marks wait for it, ``_PATIENCE_NS`` at most. A log whose samples were timed by
arrival until the marks took over would step back by up to the host's latency, which on a busy computer is more than a
period.
"""

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard import config
from onboard.flight.clocks import timebase_of
from onboard.ground.log.tables.source import Interleaved
from onboard.recording.reader import LogReader

UNKNOWN = np.iinfo(np.int64).min  # the time of a sample whose clock never was known
_STEP_NS = 100_000_000
_LAG_NS = 300_000_000
_PATIENCE_NS = 60_000_000_000


class Timed(NamedTuple):
    """Samples of a channel and their vehicle times; filter delays are not removed."""

    channel: str
    time_ns: NDArray[np.int64]  # (n,) vehicle time, or UNKNOWN
    rows: Rows  # (n,)


class TimedStep(NamedTuple):
    """Samples timed in a step; no later step has samples before ``until_ns``."""

    until_ns: int
    samples: list[Timed]


def clocked(log: LogReader, vehicle: config.Vehicle) -> list[str]:
    """The channels of ``log`` whose samples have a clock, in the order of the vehicle file."""
    timebase = timebase_of(vehicle)
    return [n for n, dtype in vehicle.channels.items() if n in timebase.channels and log.channels.get(n) == dtype]


def timed(log: LogReader, vehicle: config.Vehicle, channels: Collection[str]) -> Iterator[TimedStep]:
    """The samples of ``channels``, which have clocks, in steps of time; every row of them, in the order of the file.

    Raises:
        OSError: the log cannot be read.
    """
    timebase = timebase_of(vehicle).only(channels)
    source = Interleaved(log, vehicle.channels)
    waiting: dict[str, list[Rows]] = {name: [] for name in channels}
    unmarked = set(channels)  # whose clocks have not been solved by their marks yet
    now_ns, done = source.start_ns or 0, source.start_ns is None
    while not done:
        now_ns += _STEP_NS
        batches = source.take(now_ns)
        timebase.update(now_ns, batches)
        done = source.done
        until_ns = now_ns if done else now_ns - _LAG_NS
        samples: list[Timed] = []
        for name, parts in waiting.items():
            if len(batches[name]):
                parts.append(batches[name])
            if name in unmarked and timebase.trusted(name):
                unmarked.discard(name)
            if not (due := _due(parts, until_ns - (0 if done or name not in unmarked else _PATIENCE_NS))):
                continue
            rows = np.concatenate(due)
            times = timebase.time_ns(name, rows)
            if times is None:
                ready = len(rows) if done else int(np.searchsorted(rows["host_ns"], until_ns - _PATIENCE_NS))
                parts[:0] = [rows[ready:]] if ready < len(rows) else []
                rows, times = rows[:ready], np.full(ready, UNKNOWN)
            if len(rows):
                samples.append(Timed(name, times, rows))
        yield TimedStep(until_ns, samples)


def _due(parts: list[Rows], until_ns: int) -> list[Rows]:
    """Take the rows stamped before a time, which rise, out of the parts that wait."""
    due = []
    while parts and parts[0]["host_ns"][0] < until_ns:
        part = parts.pop(0)
        ready = max(1, int(np.searchsorted(part["host_ns"], until_ns)))
        due.append(part[:ready])
        if ready < len(part):
            parts.insert(0, part[ready:])
    return due
