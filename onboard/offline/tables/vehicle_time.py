"""Every sample of a log on vehicle time, by the timebase that flies: fed with the log as the flight was.

A sample is timed when its clock has heard what came up to ``_LAG_NS`` after it, as the estimator does; samples from
before a clock's first solution wait for it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard import config
from onboard.flight.clocks import timebase_of
from onboard.flight.roles import roles_of
from onboard.offline.tables.source import ChannelRows
from onboard.recording.reader import LogReader

_STEP_NS = 100_000_000
_LAG_NS = 300_000_000


class Timed(NamedTuple):
    """Samples of a channel and when they were taken; filter delays are not removed."""

    channel: str
    time_ns: NDArray[np.int64]  # (n,) vehicle time
    rows: Rows  # (n,)


class Step(NamedTuple):
    """What a step has timed; every sample before ``until_ns`` has come."""

    until_ns: int
    samples: list[Timed]


def timed(log: LogReader, vehicle: config.Vehicle) -> Iterator[Step]:
    """The signals of ``log`` in steps of time; the last one carries whatever was never synchronised not at all.

    Raises:
        OSError: the medium refused.
    """
    timebase = timebase_of(vehicle)
    sources = {name: ChannelRows(log, name) for name in vehicle.channels if name in log.channels}
    signals = [name for name in roles_of(vehicle).signals if name in sources]
    waiting: dict[str, list[Rows]] = {name: [] for name in signals}
    starts = [source.next_ns for source in sources.values() if source.next_ns is not None]
    now_ns, done = min(starts, default=0), not starts
    while not done:
        now_ns += _STEP_NS
        batches = {name: source.take(now_ns) for name, source in sources.items()}
        timebase.update(now_ns, batches)
        done = all(source.next_ns is None for source in sources.values())
        until_ns = now_ns if done else now_ns - _LAG_NS
        samples: list[Timed] = []
        for name in signals:
            waiting[name].append(batches[name])
            rows = np.concatenate(waiting[name])
            ready = int(np.searchsorted(rows["host_ns"], until_ns))
            times = timebase.time_ns(name, rows[:ready]) if ready else None
            waiting[name] = [rows if times is None else rows[ready:]]
            if times is not None:
                samples.append(Timed(name, times, rows[:ready]))
        yield Step(until_ns, samples)
