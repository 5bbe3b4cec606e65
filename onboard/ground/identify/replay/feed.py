"""Feeds a log to the flight's estimator in steps of the vehicle's ``step_ms`` of the log's time.

Memory is constant in the length of the log; the order of the channels in the file does not matter.
"""

from collections.abc import Iterator
from math import ceil

import numpy as np

from drivers.records import Batch
from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.tables.source import Interleaved
from onboard.ground.log.tables.vehicle_file import require_kinds
from onboard.identification.rows.identifier import Identifier
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader

AT_ONCE_s = 1.0
"""Of the log's time, in a step, where only its ticks or rows are asked for: a quarter of the time of 50 ms."""
_LONGEST_PAUSE_NS = 10_000_000_000  # of a pause of all channels, at each of its ends, that is gone through step by step
_SPREAD = 50  # samples between those whose times are compared: some arrive in groups
_FEWEST_ROWS = 2 * _SPREAD


def check_channels(vehicle: config.Vehicle, log: LogReader) -> None:
    """Check that a log has every channel of a vehicle's devices, with rows of the right kind.

    Raises:
        ChannelError: a channel is missing or of another kind.
    """
    if missing := [name for name in vehicle.channels if name not in log.channels]:
        raise ChannelError(
            f"{log.path} has no channel {', '.join(missing)}, which vehicle {vehicle.file.vehicle.name!r} needs; it "
            f"has {', '.join(log.channels) or 'none'}. Give the vehicle that it was flown with"
        )
    require_kinds(log, vehicle)


def check_units(vehicle: config.Vehicle, log: LogReader) -> None:
    """Check that the first samples of each channel that a log has are in a unit that the vehicle file takes.

    Raises:
        ChannelError: they are not, so that none of them could be used; or a channel has another kind of rows.
    """
    require_kinds(log, vehicle)
    for name, signal in roles_of(vehicle).signals.items():
        rows = next((rows for _, rows in log.batches([name])), None) if name in log.channels else None
        if rows is None or not signal.si or "unit" not in (rows.dtype.names or ()):
            continue
        if others := {*rows["unit"].tolist()} - {*signal.si}:
            read, taken = (" or ".join(sorted(unit.decode() for unit in some)) for some in (others, signal.si))
            by_gain = "; motors' currents need gain_N_m_A (heft init --gains)" if b"A" in others else ""
            raise ChannelError(
                f"{log.path}: samples of {name} are in {read or 'no unit'} where the vehicle file takes {taken}; "
                f"correct the unit in the mapping, or the device{by_gain}"
            )


def same_unit(ratio: float) -> bool:
    """Whether a time over that stated is nearer to one than to the next unit's, s, ms or us."""
    return 1e-3 < ratio**2 < 1e3


def check_times(vehicle: config.Vehicle, log: LogReader) -> None:
    """Check that the samples of a log are as far apart as the vehicle file says, but for less than a unit of time.

    Raises:
        ChannelError: a channel's times are of another unit.
    """
    for name, signal in roles_of(vehicle).signals.items():
        stamps_ns = _first_stamps(log, name)
        if len(stamps_ns) < _FEWEST_ROWS:
            continue
        spread_ns = np.median(stamps_ns[_SPREAD:] - stamps_ns[:-_SPREAD])
        ratio = 1e-9 * float(spread_ns) / _SPREAD / signal.period_s
        if not same_unit(ratio):
            found, stated = (f"{1e3 * ms:.4g} ms" for ms in (ratio * signal.period_s, signal.period_s))
            raise ChannelError(
                f"{log.path}: samples of {name} are {found} apart where the vehicle file says {stated}; check the unit "
                "of the recording's times, or the device's period"
            )


def _first_stamps(log: LogReader, channel: str) -> FloatArray:
    """Arrival of the first rows of a channel, ns; twice as many as are compared, or all of them."""
    found, count = [np.zeros(0)], 0
    for _, rows in log.batches([channel]):
        found.append(rows["host_ns"].astype(np.float64))
        count += len(rows)
        if count >= 2 * _FEWEST_ROWS:
            break
    return np.concatenate(found)


def feed(estimator: Estimator, log: LogReader, step_s: float | None = None) -> Iterator[Batch]:
    """Outputs of the estimator, step by step; the last step has no lag, as at the end of a flight.

    Args:
        estimator: of the vehicle that the log was flown with.
        log: its rows' ``host_ns`` are the time that passes.
        step_s: of the log's time, instead of the vehicle's ``step_ms``: longer ones take less time.

    Raises:
        ChannelError: the log does not fit the vehicle.
    """
    check_channels(estimator.vehicle, log)
    step_ns = round(estimator.vehicle.file.estimation.step_ms * 1e6 if step_s is None else step_s * 1e9)
    source = Interleaved(log, estimator.inputs)
    if source.start_ns is None:
        return
    now_ns = source.start_ns
    yield from estimator.process(now_ns, {})
    while not source.done:
        now_ns += step_ns
        next_ns = now_ns if source.next_ns is None else source.next_ns
        skipped_ns = max(0, next_ns - now_ns - 2 * _LONGEST_PAUSE_NS)
        now_ns += skipped_ns
        yield from estimator.process(now_ns, source.take(now_ns), None, skipped_ns)
    yield from estimator.process(now_ns, {}, 0)


def fed(estimator: Estimator, log: LogReader, step_s: float | None = None) -> Estimator:
    """The estimator after all of a log: see :func:`feed`."""
    for _ in feed(estimator, log, step_s):
        pass
    return estimator


def feed_rows(estimator: Estimator, log: LogReader) -> Iterator[Batch]:
    """As :func:`feed`, for ``heft identify`` by rows: in steps of :data:`AT_ONCE_s` where all devices are recorded.

    Rows are then still taken in as few at a time as on board, as each is made linear about the estimate before it. Of
    other devices the step is the vehicle's, and so it is of a throw, which lasts about a second.

    Raises:
        ChannelError: the log does not fit the vehicle.
    """
    file, who = estimator.vehicle.file, estimator.online
    if not estimator.vehicle.is_recorded or file.free_body is not None or not isinstance(who, Identifier):
        return feed(estimator, log)
    who.batch_ticks = ceil(1e-3 * file.estimation.step_ms * file.estimation.row_rate_hz)
    return feed(estimator, log, AT_ONCE_s)
