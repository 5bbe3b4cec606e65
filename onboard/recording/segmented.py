"""Writes a flight's log in segments, each a complete log; the next one is opened in advance.

A full segment is closed with its summary after its last row is on the medium; meanwhile rows go to the next one.
Metadata ``recorded`` at a segment's head gives the last recorded row of each channel, so that a recorder that takes
over a log of any length reads one segment only.
"""

import contextlib
import errno
import json
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from drivers.records import Rows
from onboard.recording.decode import Decoder, MessageRun, rows_of
from onboard.recording.errors import LogFormatError
from onboard.recording.mcap_format import Attachment, Chunk
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress, marks_of, note
from onboard.recording.scan import Damage, Scan
from onboard.recording.seal import seal
from onboard.recording.segments import (
    END,
    METADATA,
    RECORDED,
    flight_or_none,
    number_of,
    segment_path,
    segments,
    with_crc,
)
from onboard.recording.sink import FileSink, Sink, sync_directory
from onboard.recording.writer import HEADER_BYTES, SYNC_INTERVAL_NS, LogWriter

_UNSEALED_AT_MOST = 3  # one that was being ended, one in use, one opened ahead
_LOOKED_AT = 16  # segments before: a recorder may have died again before it sealed what others left
_OPEN_AGAIN_NS = 1_000_000_000
SEAL_AFTER_NS = 3_000_000_000  # a segment of 40 MB takes 0.3 s of CPU time, and first the rings are to be read


class Preamble(NamedTuple):
    """Common content of every segment's head."""

    flight: str  # unique id of the flight
    attachments: tuple[Attachment, ...] = ()
    metadata: Mapping[str, Mapping[str, str]] = {}


class Limits(NamedTuple):
    """Size limits of a segment."""

    span_ns: int = 60_000_000_000
    size: int = 64 << 20


LIMITS = Limits()


class Progress(NamedTuple):
    """How far a log is written: what a recorder leaves to the next one, so that this one need not read the log.

    The last recorded row of each channel at ``offset`` of segment ``number``.
    """

    number: int
    offset: int
    recorded: dict[str, ChannelProgress]

    def to_bytes(self) -> bytes:
        """As JSON."""
        return json.dumps(self).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self | None:
        """What :meth:`to_bytes` gave; None where it is none."""
        try:
            number, offset, recorded = json.loads(data)
            return cls(int(number), int(offset), {str(k): ChannelProgress(*map(int, v)) for k, v in recorded.items()})
        except (ValueError, TypeError, AttributeError):
            return None


class SegmentedLog:
    """Log of one flight; same methods as ``LogWriter``.

    Args:
        log: path as for ``onboard.recording.segments``.
        preamble: common content of every segment's head.
        limits: size limits of a segment.
        sync_interval_ns: least time between two fsyncs, on the clock given to ``sync``.
        open_sink: opens a segment.
        number: of the first segment to write.
        recorded: last recorded row of each channel in earlier segments.
        told: given the progress after each sync.

    Raises:
        FileExistsError: the log exists.
        OSError: it cannot be created.
    """

    def __init__(
        self,
        log: Path,
        preamble: Preamble,
        *,
        limits: Limits = LIMITS,
        sync_interval_ns: int = SYNC_INTERVAL_NS,
        open_sink: Callable[[Path], Sink] = FileSink,
        number: int = 0,
        recorded: Mapping[str, ChannelProgress] | None = None,
        told: Callable[[Progress], object] = lambda progress: None,
    ) -> None:
        self._told = told
        self._unsealed: list[Path] = []  # of recorders that died; sealed when rows are recorded again
        self._log, self._preamble, self._limits = log, preamble, limits
        self._sync_interval_ns, self._open_sink = sync_interval_ns, open_sink
        self.recorded: dict[str, ChannelProgress] = dict(recorded or {})
        self._end_said = False
        self._channels: dict[str, tuple[np.dtype[np.void], Mapping[str, str] | None]] = {}
        self._number = number
        self._opened_ns: int | None = None
        self._open_again_ns = self._seal_ns = 0
        segment_path(log, number).parent.mkdir(parents=True, exist_ok=True)
        self._writer = self._open(number)
        self._ending: LogWriter | None = None
        self._next: LogWriter | None = None
        self._say_recorded()

    @classmethod
    def resume(
        cls,
        log: Path,
        preamble: Preamble,
        *,
        limits: Limits = LIMITS,
        sync_interval_ns: int = SYNC_INTERVAL_NS,
        open_sink: Callable[[Path], Sink] = FileSink,
        progress: Progress | None = None,
        told: Callable[[Progress], object] = lambda progress: None,
    ) -> Self:
        """Continue a log whose writer died, or begin a new one; open segments are closed.

        With the dead writer's last ``progress`` only what it wrote later is read, and segments are closed
        :data:`SEAL_AFTER_NS` after the first sync.

        Raises:
            FileExistsError: the log is another flight's.
            OSError: a segment cannot be read, or the next not created.
        """
        begin = partial(
            cls, log, preamble, limits=limits, sync_interval_ns=sync_interval_ns, open_sink=open_sink, told=told
        )
        if progress is not None and (recorded := _recorded_since(log, progress)) is not None:
            number = progress.number + 1
            segment_path(log, number).unlink(missing_ok=True)  # opened ahead
            resumed = begin(number=number, recorded=recorded)
            before = range(max(0, number - _LOOKED_AT), number)
            resumed._unsealed = [path for one in before if (path := segment_path(log, one)).exists()]
            return resumed
        found = [path for path in segments(log) if path.exists()]
        flights = {flight for path in found if (flight := flight_or_none(path))}
        if flights and preamble.flight not in flights:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(found[0]))
        for path in found[-_UNSEALED_AT_MOST:]:
            if Scan(path).truncated:
                if path == found[0] or _may_have_messages(path):
                    seal(path)
                else:
                    path.unlink()  # opened ahead
                    found.remove(path)
        number = number_of(found[-1]) + 1 if found else 0
        if (torn := segment_path(log, number)).exists() and torn.stat().st_size <= HEADER_BYTES:
            torn.unlink()  # opened in advance, before its metadata was written
        return begin(number=number, recorded=_recorded(found))

    @property
    def path(self) -> Path:
        """The current segment."""
        return segment_path(self._log, self._number)

    @property
    def failing(self) -> bool:
        """The disk has refused, and no ``sync`` has succeeded since."""
        return self._writer.failing

    @property
    def ended(self) -> bool:
        """Nothing more can be written; ``close`` was called."""
        return self._writer.ended

    def register(self, channel: str, dtype: np.dtype[np.void], *, units: Mapping[str, str] | None = None) -> None:
        """See ``LogWriter.register``."""
        for writer in (self._writer, self._next):
            if writer is not None:
                writer.register(channel, dtype, units=units)
        self._channels[channel] = dtype, units

    def write(self, channel: str, rows: Rows) -> None:
        """See ``LogWriter.write``."""
        note(self.recorded, channel, rows)
        self._writer.write(channel, rows)

    def sync(self, now_ns: int) -> bool:
        """See ``LogWriter.sync``; a segment that is full is ended here."""
        synced = self._writer.sync(now_ns)
        if self._opened_ns is None:
            self._opened_ns, self._seal_ns = now_ns, now_ns + SEAL_AFTER_NS
        if synced:
            self._end_segment()
            if self._next is None:
                self._open_ahead(now_ns)
            if self._full(now_ns):
                self._change(now_ns)
            self._told(Progress(self._number, self._writer.bytes_written, dict(self.recorded)))
            if self._unsealed and now_ns >= self._seal_ns:
                self._seal(self._unsealed.pop())
        return synced

    def close(self) -> None:
        """See ``LogWriter.close``."""
        self._end_segment()
        while self._unsealed:
            self._seal(self._unsealed.pop())
        if not self._end_said:
            self._end_said = True  # set even if the disk refuses it
            last = {"flight": self._preamble.flight, "segments": str(self._number + 1)}
            self._writer.add_metadata(END, with_crc(END, last))
        self._writer.close()
        if self._next is not None:
            self._next.abandon()
            self._next = None
            unused = segment_path(self._log, self._number + 1)
            unused.unlink()
            sync_directory(unused.parent)

    def abandon(self) -> None:
        """See ``LogWriter.abandon``."""
        for writer in (self._ending, self._writer, self._next):
            if writer is not None:
                writer.abandon()

    def _full(self, now_ns: int) -> bool:
        opened_ns = now_ns if self._opened_ns is None else self._opened_ns
        return now_ns - opened_ns >= self._limits.span_ns or self._writer.bytes_written >= self._limits.size

    def _open(self, number: int) -> LogWriter:
        path = segment_path(self._log, number)
        writer = LogWriter(self._open_sink(path), sync_interval_ns=self._sync_interval_ns)
        try:
            told = {"flight": self._preamble.flight, "number": str(number)}
            writer.add_metadata(METADATA, with_crc(METADATA, told))
            for attachment in self._preamble.attachments:
                writer.attach(attachment.name, attachment.media_type, attachment.data, attachment.log_time_ns)
            for name, items in self._preamble.metadata.items():
                writer.add_metadata(name, items)
            for channel, (dtype, units) in self._channels.items():
                writer.register(channel, dtype, units=units)
            writer.flush()
        except OSError:
            writer.abandon()
            path.unlink()
            raise
        return writer

    def _open_ahead(self, now_ns: int) -> None:
        """Open the next segment and sync its head; retried later if the disk fails."""
        if now_ns < self._open_again_ns:
            return
        self._open_again_ns = now_ns + _OPEN_AGAIN_NS
        with contextlib.suppress(OSError):  # meanwhile the current segment grows beyond its limit
            self._next = self._open(self._number + 1)

    def _change(self, now_ns: int) -> None:
        """Switch to the next segment; all earlier rows are on the medium."""
        if self._next is None or self._ending is not None:
            return
        self._ending, self._writer, self._next = self._writer, self._next, None
        self._number, self._opened_ns = self._number + 1, now_ns
        self._open_again_ns = 0
        self._say_recorded()
        self._end_segment()

    def _end_segment(self) -> None:
        if self._ending is not None:
            self._ending.close()
            self._ending = None

    @staticmethod
    def _seal(path: Path) -> None:
        if Scan(path).truncated:
            seal(path)

    def _say_recorded(self) -> None:
        if self.recorded:
            marks = {name: f"{m.sequence} {m.host_ns}" for name, m in self.recorded.items()}
            self._writer.add_metadata(RECORDED, with_crc(RECORDED, marks))


def _recorded_since(log: Path, progress: Progress) -> dict[str, ChannelProgress] | None:
    """Last recorded row of each channel, by ``progress`` and the rows after it; None where they do not fit."""
    path, ahead = (segment_path(log, number) for number in (progress.number, progress.number + 1))
    further = segment_path(log, progress.number + 2)
    if further.exists() or not path.exists() or path.stat().st_size < progress.offset:
        return None
    if ahead.exists() and _may_have_messages(ahead):
        return None
    recorded, decoder = dict(progress.recorded), Decoder()
    try:
        for record in Scan(path, progress.offset).records():
            if isinstance(record, Damage):
                if record.end != Scan(path).size:
                    return None
            elif isinstance(record.content, Chunk):
                rows: dict[str, list[MessageRun]] = {}
                for run in decoder.runs(record.content.records):
                    rows.setdefault(run.channel.name, []).append(run)
                for channel, runs in rows.items():
                    note(recorded, channel, rows_of(runs))
    except LogFormatError:
        return None
    return recorded


def _recorded(found: list[Path]) -> dict[str, ChannelProgress]:
    """Last recorded row of each channel at the end of segments ``found``."""
    rows: dict[str, ChannelProgress] = {}
    for segment in reversed(found):
        try:
            log = LogReader([segment])
        except LogFormatError:
            continue  # unreadable
        here: dict[str, ChannelProgress] = {}
        for channel, batch in log.batches():
            note(here, channel, batch)
        rows = here | rows
        if marks := marks_of(log.metadata.get(RECORDED, {})):
            return marks | rows
    return rows


def _may_have_messages(segment: Path) -> bool:
    """False for a segment opened ahead, with a whole or torn head."""
    try:
        return any(True for _ in LogReader([segment]).batches())
    except LogFormatError:
        return True
