"""Reads a log sequentially, chunk by chunk, in constant memory; damage is skipped and reported."""

from collections.abc import Collection, Generator, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import Batch, Rows
from onboard.recording.format.decode import Decoder, KnownChannel, MessageRun, RowTimes, rows_of
from onboard.recording.format.errors import ChannelError, LogFormatError
from onboard.recording.format.mcap_format import LIBRARY, Attachment, Chunk, Header, Metadata
from onboard.recording.format.scan import Damage, Scan
from onboard.recording.format.segments import is_part, number_of, segments, without_crc, written_as
from onboard.recording.missing import SegmentsSeen

EXIT_COMPLETE = 0
EXIT_DAMAGED = 3
KEPT_BYTES = 64 << 20  # of logs that are kept


class _Survey(NamedTuple):
    """Result of a pass over a log."""

    channels: dict[str, KnownChannel]
    attachments: dict[str, Attachment]
    metadata: dict[str, dict[str, str]]
    damage: list[Damage]
    truncated: bool


class LogReader:
    """A log on disk, in one file or in segments.

    The properties need a whole pass over the log; the first use of one makes it, and so does a loop over
    ``batches`` that comes to its end.

    Args:
        path: a log (layout: ``onboard.recording.format.segments``), or the segments to read, in order. Of a log,
            segments missing at its beginning or end are reported too.
        kept: share of :data:`KEPT_BYTES` that it has: a log no longer than that is read once; passes after the first
            whole one are over what it found.

    Attributes:
        path: as given; the first where segments were given.
        segments: the files, in the order they are read.
        is_flight: whether ``path`` is a whole flight, not some of its segments.

    Raises:
        LogFormatError: a file is not a heft log, or no part of it can be read.
        OSError: none of its files can be opened.
    """

    def __init__(self, path: str | Path | Sequence[Path], *, kept: float = 0.0) -> None:
        if isinstance(path, str | Path):
            self.path = Path(path)
            self.segments = segments(self.path)
        else:
            self.path, self.segments = path[0], tuple(path)
        self.size = sum(map(_size, self.segments))
        alone = self.segments == (self.path,) and is_part(self.path)
        self.is_flight = isinstance(path, str | Path) and not alone
        self._before = 0
        self._keeps = self.size <= kept * KEPT_BYTES
        self._kept: list[tuple[int, list[MessageRun]]] | None = None  # position after a chunk, its runs
        self._scan: Scan | None = None
        self._found: _Survey | None = None
        self._require_one_of_ours()

    def _require_one_of_ours(self) -> None:
        """Raises LogFormatError unless one of the segments at least is a log of ours."""
        refused: list[LogFormatError | OSError] = []
        for segment in self.segments:
            try:
                self._require_ours(segment)
            except (LogFormatError, OSError) as error:
                refused.append(error)
            else:
                return
        raise refused[0]

    def _require_ours(self, segment: Path) -> None:
        """Accept a file with heft's name in the header, or with a chunk in heft's layout."""
        writer = ""
        for record in Scan(segment).records():
            if isinstance(record, Damage):
                continue
            if isinstance(record.content, Header):
                writer = record.content.library
                if writer == LIBRARY:
                    return
            elif isinstance(record.content, Chunk) and _decodes(record.content):
                return
        if writer:
            raise LogFormatError(f"{segment} was written by {writer!r}, not by heft; read it with a ROS 2 tool")

    @property
    def position(self) -> int:
        """Bytes of the log read in the current pass."""
        return self._before + (self._scan.position if self._scan else 0)

    @property
    def channels(self) -> dict[str, np.dtype[np.void]]:
        """Channels defined in the readable part of the log, with their dtypes, in order of registration."""
        return {name: channel.dtype for name, channel in self._survey().channels.items()}

    @property
    def units(self) -> dict[str, dict[str, str]]:
        """Channel to field to unit, from the definitions."""
        return {name: channel.units for name, channel in self._survey().channels.items()}

    @property
    def attachments(self) -> dict[str, Attachment]:
        """Attached files by name; the last one of a name."""
        return self._survey().attachments

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; the last one of a name."""
        return self._survey().metadata

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Unreadable parts, in the order of the file; empty for an intact log."""
        return tuple(self._survey().damage)

    @property
    def truncated(self) -> bool:
        """Whether the log was not closed, or the end of a segment is missing."""
        return self._survey().truncated

    @property
    def complete(self) -> bool:
        """Whether the log is closed and undamaged."""
        return not self.damage

    @property
    def exit_code(self) -> int:
        """Exit code of a command that read the log: 0, or 3 if it is truncated or damaged."""
        return EXIT_COMPLETE if self.complete else EXIT_DAMAGED

    def batches(
        self, channels: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Batch]:
        """The rows of the log: one batch per channel and chunk, in the order of the file.

        Args:
            channels: only these.
            start_ns: only rows with ``host_ns`` >= this.
            end_ns: only rows with ``host_ns`` < this.

        Raises:
            ChannelError: the log has no such channel.
            OSError: the log cannot be read.
        """
        if channels is not None:
            self._require(channels)
        return self._batches(channels, start_ns, end_ns)

    def read(self, channel: str) -> Rows:
        """All rows (n,) of ``channel``, in the order of the file.

        Raises:
            ChannelError: the log has no such channel.
            OSError: the log cannot be read.
        """
        joined = bytearray().join(batch.rows.tobytes() for batch in self._batches([channel], None, None))
        self._require([channel])  # known after that pass without one of its own
        return np.frombuffer(joined, self.channels[channel])

    def _require(self, channels: Collection[str]) -> None:
        if missing := sorted(set(channels) - set(self.channels)):
            raise ChannelError(f"{self.path} has no channel {missing}; it has {sorted(self.channels)}")

    def _batches(self, channels: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Batch]:
        for chunk in self._chunks():
            runs: dict[str, list[MessageRun]] = {}
            for run in chunk:
                if channels is None or run.channel.name in channels:
                    runs.setdefault(run.channel.name, []).append(run)
            for name, group in runs.items():
                rows = _between(rows_of(group), start_ns, end_ns)
                if len(rows):
                    yield Batch(name, rows)

    def _chunks(self) -> Iterator[list[MessageRun]]:
        """One pass, over the file or what was kept of it: yields the runs of each chunk."""
        if self._kept is not None:
            for read, runs in self._kept:
                self._before = read
                yield runs
            return
        kept = list[tuple[int, list[MessageRun]]]()
        for runs in self._in_file():
            if self._keeps:
                kept.append((self.position, runs))
            yield runs
        self._kept = kept if self._keeps else None

    def _in_file(self) -> Iterator[list[MessageRun]]:
        """One pass over the file; stores the other results at its end."""
        found = _Survey({}, {}, {}, [], False)
        self._before, times = 0, RowTimes()
        alone = len(self.segments) == 1
        seen = SegmentsSeen(0 if self.is_flight else None, to_the_end=self.is_flight, alone=alone)
        for number, segment in enumerate(self.segments):
            last = number == len(self.segments) - 1
            size = _size(segment)
            try:
                found = yield from self._segment(segment, found, seen, times, last=last and number > 0)
            except LogFormatError as error:
                seen.unreadable(number_of(segment), segment.name, str(error))
            except OSError as error:
                if alone:
                    raise
                seen.unreadable(number_of(segment), segment.name, (error.strerror or str(error)).lower())
            self._before, self._scan = self._before + size, None
        self._found = found._replace(damage=[*found.damage, *seen.finish()])

    def _segment(
        self, segment: Path, found: _Survey, seen: SegmentsSeen, times: RowTimes, *, last: bool
    ) -> Generator[list[MessageRun], None, _Survey]:
        """One pass over a segment; returns ``found`` with its findings added.

        Args:
            segment: the file.
            found: findings of the segments before.
            seen: receives this segment's metadata.
            times: of the rows before.
            last: whether it may be an unused segment opened ahead, which is no damage.

        Raises:
            LogFormatError: nothing of it can be read.
        """
        self._scan = scan = Scan(segment)
        decoder = Decoder(found.channels)
        damage: list[Damage] = []
        used = False
        name = segment.name if len(self.segments) > 1 else ""
        for record in scan.records():
            if isinstance(record, Damage):
                damage.append(record._replace(file=name))
            elif isinstance(record.content, Attachment):
                found.attachments[record.content.name] = record.content
            elif isinstance(record.content, Metadata):
                found.metadata[written_as(*record.content)] = without_crc(record.content.items)
                seen.metadata(record.content.name, record.content.items)
            elif isinstance(record.content, Chunk):
                used = True
                try:
                    runs = decoder.runs(record.content.records)
                    times.check(runs)
                except LogFormatError as error:
                    damage.append(Damage(record.start, record.end, str(error), name))
                else:
                    for run in runs:
                        seen.run(run)
                    yield runs
        unused = last and not used and scan.truncated and len(damage) == 1
        missing = seen.end(number_of(segment), segment.name, closed=not scan.truncated, unused=unused)
        found = found._replace(damage=[*found.damage, *missing])
        if unused:
            return found
        truncated = found.truncated or scan.truncated
        return found._replace(channels=decoder.channels, damage=[*found.damage, *damage], truncated=truncated)

    def _survey(self) -> _Survey:
        if self._found is None:
            for _ in self._chunks():
                pass
        assert self._found is not None
        return self._found


def _size(path: Path) -> int:
    """Bytes of a file; 0 for one that cannot be reached, which reading it reports."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _decodes(chunk: Chunk) -> bool:
    try:
        Decoder().runs(chunk.records)
    except LogFormatError:
        return False
    return True


def _between(rows: Rows, start_ns: int | None, end_ns: int | None) -> Rows:
    if start_ns is None and end_ns is None:
        return rows
    chosen = np.ones(len(rows), bool)
    if start_ns is not None:
        chosen &= rows["host_ns"] >= start_ns
    if end_ns is not None:
        chosen &= rows["host_ns"] < end_ns
    return rows[chosen]
