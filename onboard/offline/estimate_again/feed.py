"""Feeds a log to the flight's estimator in steps of the vehicle's ``step_ms`` of the log's time.

Memory is constant in the length of the log; the order of the channels in the file does not matter.
"""

from collections.abc import Iterator

from drivers.records import Batch
from onboard import config
from onboard.flight.estimator import Estimator
from onboard.offline.tables.source import Interleaved
from onboard.recording.errors import ChannelError
from onboard.recording.reader import LogReader


def check_channels(vehicle: config.Vehicle, log: LogReader) -> None:
    """Check that a log has every channel of a vehicle's devices, with rows of the right kind.

    Raises:
        ChannelError: a channel is missing or of another kind.
    """
    wanted = vehicle.channels
    missing = [name for name in wanted if name not in log.channels]
    other = [name for name, dtype in wanted.items() if name not in missing and log.channels[name] != dtype]
    if missing or other:
        what = f"no channel {', '.join(missing)}" if missing else f"another kind of rows in {', '.join(other)}"
        raise ChannelError(
            f"{log.path} has {what}, which vehicle {vehicle.file.vehicle.name!r} needs; it has "
            f"{', '.join(log.channels) or 'none'}. Give the vehicle that it was flown with"
        )


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
        yield from estimator.process(now_ns, source.take(now_ns))
    yield from estimator.process(now_ns, {}, 0)
