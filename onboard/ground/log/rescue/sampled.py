"""When the samples of a channel were taken, on the clock of the computer that recorded them.

A log that carries its vehicle has that vehicle's clocks. In any other, arrival stamps that rise are the times, as they
are in an imported recording; where rows share them (a FIFO that is drained), the device's tick count is put on the
line through the least delayed arrivals.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.devices import si
from onboard.estimation.arrays import FloatArray
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.vehicle_time import UNKNOWN
from onboard.recording.reader import LogReader
from onboard.timebase.specs import FreeChannel
from onboard.timebase.timebase import Timebase

_BLOCK_NS = 100_000_000


def sampled(log: LogReader, channel: str) -> tuple[Rows, FloatArray]:
    """The usable rows (n,) of ``channel`` and the times (n,) of their samples [s], rising."""
    tables = FlightTables(log)
    if channel in tables.clocked:
        rows = tables.read(channel)
        time_ns = rows["time_ns"]
    else:
        rows = log.read(channel)
        rises = (np.diff(rows["host_ns"]) > 0).all()
        time_ns = rows["host_ns"] if rises else _by_tick(channel, rows)
    good = si.usable(rows) & (time_ns != UNKNOWN)
    rows, time_ns = rows[good], time_ns[good]
    rising = np.ones(len(rows), np.bool_)
    rising[1:] = time_ns[1:] > np.maximum.accumulate(time_ns)[:-1]
    return rows[rising], time_ns[rising] * 1e-9


def _by_tick(channel: str, rows: Rows) -> NDArray[np.int64]:
    ticks = int(rows["tick"][-1]) - int(rows["tick"][0])
    if ticks <= 0:
        return np.full(len(rows), UNKNOWN)
    period_ns = float(rows["host_ns"][-1] - rows["host_ns"][0]) / ticks
    timebase = Timebase({channel: FreeChannel(period_ns)}, None)
    edges = np.arange(rows["host_ns"][0], rows["host_ns"][-1] + _BLOCK_NS, _BLOCK_NS) + _BLOCK_NS
    cuts = [0, *np.searchsorted(rows["host_ns"], edges).tolist()]
    found = np.full(len(rows), UNKNOWN)
    first = 0  # row without a time
    for now_ns, start, end in zip(edges.tolist(), cuts[:-1], cuts[1:], strict=True):
        timebase.update(now_ns, {channel: rows[start:end]})
        times = timebase.time_ns(channel, rows[first:end]) if end > first else None
        if times is not None:
            found[first:end], first = times, end
    return found
