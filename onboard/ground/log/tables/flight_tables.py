"""A log's channels as rows with times, meanings and columns, for dumps and the Python interface."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.records import Batch, Rows
from onboard import config
from onboard.ground.log.tables.columns import TableColumn, Times, columns, time_columns, timed_dtype, with_times
from onboard.ground.log.tables.meaning import ChannelMeaning, meanings
from onboard.ground.log.tables.selection import Selection, inside, span_of
from onboard.ground.log.tables.vehicle_file import attached_vehicle, require_kinds
from onboard.ground.log.tables.vehicle_time import UNKNOWN, clocked, timed
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.wall_clock import utc_offset_ns
from onboard.recording.reader import LogReader


class FlightTables:
    """A log read with the vehicle that flew it.

    Args:
        log: the log, or its path.
        vehicle: that flew; the one that the log carries where not given.

    Attributes:
        log: the log.
        vehicle: that flew; None where the log carries none that can be used.
        why_none: the reason then.
        meanings: of each channel.
        times: where ``time_s`` begins: at the log's first record.

    Raises:
        LogFormatError: ``log`` is no log of ours.
        OSError: it cannot be read.
    """

    def __init__(self, log: LogReader | str | Path, vehicle: config.Vehicle | None = None) -> None:
        self.log = log if isinstance(log, LogReader) else LogReader(log)
        start_ns = span_of(self.log)[0]  # first: this pass surveys the log as well
        self.vehicle, self.why_none = vehicle, ""
        if vehicle is None:
            try:
                self.vehicle = attached_vehicle(self.log)
            except config.ConfigError as error:
                self.why_none = str(error)
        if self.vehicle is not None:
            try:
                require_kinds(self.log, self.vehicle)
            except ChannelError as error:
                self.vehicle, self.why_none = None, str(error)
        self.meanings: dict[str, ChannelMeaning] = meanings(self.log, self.vehicle)
        self.times = Times(start_ns, utc_offset_ns(self.log.metadata))
        self.clocked = clocked(self.log, self.vehicle) if self.vehicle else []

    def columns(self, channel: str, sample: Rows) -> list[TableColumn]:
        """Every column of a channel's rows with times; ``sample`` gives the units that rows name themselves."""
        dtype = self.log.channels[channel]
        made = columns(dtype, self.log.units[channel], sample, self.meanings[channel])
        return [*time_columns(self.times), *made]

    def empty(self, channel: str) -> Rows:
        """No rows of a channel, with times."""
        return np.empty(0, timed_dtype(self.log.channels[channel]))

    def windows(self, selection: Selection) -> list[tuple[int, int]] | None:
        """The stretches of host time that are asked for; None for all of the log."""
        return selection.windows(self.log, self.vehicle)

    def batches(self, channels: Collection[str], windows: Sequence[tuple[int, int]] | None = None) -> Iterator[Batch]:
        """The rows of ``channels`` with times (:func:`timed_dtype`), each channel's in the order of the file.

        Raises:
            ChannelError: the log has no such channel.
            OSError: the medium refused.
        """
        if missing := sorted(set(channels) - set(self.log.channels)):
            raise ChannelError(f"{self.log.path} has no channel {missing}; it has {sorted(self.log.channels)}")
        by_clock = [name for name in self.clocked if name in channels]
        others = [name for name in channels if name not in by_clock]
        return self._batches(by_clock, others, windows)

    def _batches(
        self, by_clock: list[str], others: list[str], windows: Sequence[tuple[int, int]] | None
    ) -> Iterator[Batch]:
        if others:
            for name, rows in self.log.batches(others):
                field = self.meanings[name].time_field
                yield from _chosen(name, rows, rows[field] if field else np.full(len(rows), UNKNOWN), windows)
        if by_clock and self.vehicle is not None:
            for step in timed(self.log, self.vehicle, by_clock):
                for name, time_ns, rows in step.samples:
                    yield from _chosen(name, rows, time_ns, windows)

    def times_of(self, channels: Collection[str]) -> Iterator[tuple[str, NDArray[np.int64]]]:
        """Vehicle time of the rows of ``channels``, all of which have clocks, a part of a channel at a time."""
        if channels and self.vehicle is not None:
            for step in timed(self.log, self.vehicle, channels):
                yield from ((name, time_ns) for name, time_ns, _ in step.samples)

    def read(self, channel: str) -> Rows:
        """All rows (n,) of a channel with times.

        Raises:
            ChannelError: the log has no such channel.
        """
        return np.concatenate([self.empty(channel), *(rows for _, rows in self.batches([channel]))])


def _chosen(
    name: str, rows: Rows, time_ns: NDArray[np.int64], windows: Sequence[tuple[int, int]] | None
) -> Iterator[Batch]:
    if windows is None:
        yield Batch(name, with_times(rows, time_ns))
        return
    chosen = inside(rows["host_ns"], windows)
    if chosen.any():
        yield Batch(name, with_times(rows[chosen], time_ns[chosen]))
