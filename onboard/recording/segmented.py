"""Writes a flight's log in segments, each a complete log; the next one is opened in advance.

A full segment is closed with its summary after its last row is on the medium; meanwhile rows go to the next one. Where
its name is taken by a file of another origin, the next free one is used: the segment's own number, which its metadata
says, continues without a gap.
Metadata ``recorded`` at a segment's head gives the last recorded row of each channel, so that a recorder that takes
over a log of any length reads one segment only.
"""

import contextlib
import errno
import os
import resource
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from drivers.records import Rows
from onboard.recording.format.mcap_format import Attachment
from onboard.recording.format.scan import Scan
from onboard.recording.format.segments import (
    END,
    METADATA,
    RECORDED,
    flight_or_none,
    free_place,
    number_of,
    ordinal,
    segment_path,
    segments,
    with_crc,
)
from onboard.recording.left import (
    Progress,
    is_torn,
    may_be_of,
    may_have_messages,
    recorded_at_end,
    recorded_since,
)
from onboard.recording.recorded import ChannelProgress, note
from onboard.recording.seal import seal
from onboard.recording.sink import FileSink, sync_directory
from onboard.recording.writer import SYNC_INTERVAL_NS, LogWriter

_UNSEALED_AT_MOST = 3  # one that was being ended, one in use, one opened ahead
_LOOKED_AT = 16  # segments before: a recorder may have died again before it sealed what others left
_OPEN_AGAIN_NS = 1_000_000_000
SEAL_AFTER_NS = 3_000_000_000  # a segment of 40 MB takes 0.3 s of CPU time, and first the rings are to be read


class Preamble(NamedTuple):
    """Common content of every segment's head."""

    flight: str  # unique id of the flight; empty: a log in one file, another is begun only where somebody takes it
    attachments: tuple[Attachment, ...] = ()
    metadata: Mapping[str, Mapping[str, str]] = {}


class SegmentLimits(NamedTuple):
    """Size limits of a segment."""

    span_ns: int = 60_000_000_000
    size: int = 64 << 20


LIMITS = SegmentLimits()


class Loss(NamedTuple):
    """A segment that somebody removed, renamed or cut off while it was written."""

    text: str
    is_lost: bool  # False: its rows are in the renamed file
    rows: dict[str, tuple[ChannelProgress, ChannelProgress]]  # by channel: the last row before those lost, their last


class SegmentedLog:
    """Log of one flight; same methods as ``LogWriter``.

    Args:
        log: path as for ``onboard.recording.format.segments``.
        preamble: common content of every segment's head.
        limits: size limits of a segment.
        sync_interval_ns: least time between two fsyncs, on the clock given to ``sync``.
        open_sink: opens a segment.
        number: of the first segment to write.
        place: least number in its file's name; of the first segment of a log it is 0.
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
        limits: SegmentLimits = LIMITS,
        sync_interval_ns: int = SYNC_INTERVAL_NS,
        open_sink: Callable[[Path], FileSink] = FileSink,
        number: int = 0,
        place: int = 0,
        recorded: Mapping[str, ChannelProgress] | None = None,
        told: Callable[[Progress], object] = lambda progress: None,
    ) -> None:
        self._told = told
        self._unsealed: list[Path] = []  # of recorders that died; sealed when rows are recorded again
        self._log, self._preamble, self._limits = log, preamble, limits
        self._sync_interval_ns, self._open_sink = sync_interval_ns, open_sink
        self.recorded: dict[str, ChannelProgress] = dict(recorded or {})
        self._end_said = False
        self._channels: dict[str, np.dtype[np.void]] = {}
        self._number = number
        self._place = free_place(log, place) if number else 0
        self._ahead = self._place + 1  # place of the next segment
        self._opened_ns: int | None = None
        self._open_again_ns = self._seal_ns = 0
        self._at_head = dict(self.recorded)  # of the segment in use
        self._losses: list[Loss] = []  # for the recorder to tell
        self._astray, self._why_not_ahead = False, ""  # nobody finds the file in use; why the next could not be opened
        self._writer = self._open(number, self._place)
        self._ending: LogWriter | None = None
        self._next: LogWriter | None = None
        self._say_recorded()

    @classmethod
    def resume(
        cls,
        log: Path,
        preamble: Preamble,
        *,
        limits: SegmentLimits = LIMITS,
        sync_interval_ns: int = SYNC_INTERVAL_NS,
        open_sink: Callable[[Path], FileSink] = FileSink,
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
        flight = preamble.flight
        if progress is not None and (recorded := recorded_since(log, progress, flight)) is not None:
            place = progress.place + 1
            segment_path(log, place).unlink(missing_ok=True)  # opened ahead
            resumed = begin(number=progress.number + 1, place=place, recorded=recorded)
            before = (segment_path(log, one) for one in range(max(0, place - _LOOKED_AT), place))
            resumed._unsealed = [path for path in before if path.exists() and may_be_of(path, flight)]
            return resumed
        found = [path for path in segments(log) if path.exists()]
        flights = {one for path in found if (one := flight_or_none(path))}
        if flights and flight not in flights:
            if log.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(found[0]))
            found = []  # the log's own name is free: its segments go on past those of another flight
        for path in found[-_UNSEALED_AT_MOST:]:
            if Scan(path).truncated:
                if path == found[0] or may_have_messages(path):
                    seal(path)
                else:
                    path.unlink()  # opened ahead
                    found.remove(path)
        number = ordinal(found[-1]) + 1 if found else 0
        place = max(map(number_of, found)) + 1 if found else 0
        if is_torn(torn := segment_path(log, place)):
            torn.unlink()  # opened in advance, before its metadata was written
        return begin(number=number, place=place, recorded=recorded_at_end(found))

    @property
    def path(self) -> Path:
        """The current segment."""
        return segment_path(self._log, self._place)

    @property
    def failing(self) -> bool:
        """The disk has refused, and no ``sync`` has succeeded since; or the file is gone, and no other can be made."""
        return self._writer.failing or self._astray

    @property
    def ended(self) -> bool:
        """Nothing more can be written; ``close`` was called."""
        return self._writer.ended

    def register(self, channel: str, dtype: np.dtype[np.void]) -> None:
        """See ``LogWriter.register``."""
        for writer in (self._writer, self._next):
            if writer is not None:
                writer.register(channel, dtype)
        self._channels[channel] = dtype

    def write(self, channel: str, rows: Rows) -> None:
        """See ``LogWriter.write``."""
        note(self.recorded, channel, rows)
        self._writer.write(channel, rows)

    def sync(self, now_ns: int) -> bool:
        """See ``LogWriter.sync``; a segment that is full is ended here."""
        synced = self._writer.sync(now_ns)
        if self._opened_ns is None:
            self._opened_ns, self._seal_ns = now_ns, now_ns + SEAL_AFTER_NS
        if synced or (self._astray and not self._writer.failing):
            self._end_segment()
            if self._next is None and self._preamble.flight:
                self._open_ahead(now_ns)
            if self._full(now_ns):
                self._change(now_ns)
            self._look_after_files(now_ns)
            self._told(Progress(self._number, self._place, self._writer.bytes_written, dict(self.recorded)))
            if self._unsealed and now_ns >= self._seal_ns:
                self._seal(self._unsealed.pop())
        return synced

    def take_losses(self) -> list[Loss]:
        """What has befallen segments since the last call."""
        losses, self._losses = self._losses, []
        return losses

    def close(self) -> None:
        """See ``LogWriter.close``."""
        self._end_segment()
        if self._astray:
            self._look_after_files(self._open_again_ns)
        while self._unsealed:
            self._seal(self._unsealed.pop())
        if self._preamble.flight and not self._end_said:
            self._end_said = True  # set even if the disk refuses it
            last = {"flight": self._preamble.flight, "segments": str(self._number + 1)}
            self._writer.add_metadata(END, with_crc(END, last))
        self._writer.close()
        if self._next is not None:
            self._next.abandon()
            self._next = None
            unused = segment_path(self._log, self._ahead)
            with contextlib.suppress(FileNotFoundError):  # somebody has removed it
                unused.unlink()
                sync_directory(unused.parent)

    def abandon(self) -> None:
        """See ``LogWriter.abandon``."""
        for writer in (self._ending, self._writer, self._next):
            if writer is not None:
                writer.abandon()

    def _full(self, now_ns: int) -> bool:
        opened_ns = now_ns if self._opened_ns is None else self._opened_ns
        allowed = resource.getrlimit(resource.RLIMIT_FSIZE)[0]  # half of it is for what a sync brings, and the summary
        size = self._limits.size if allowed == resource.RLIM_INFINITY else min(self._limits.size, allowed // 2)
        return now_ns - opened_ns >= self._limits.span_ns or self._writer.bytes_written >= size

    def _open(self, number: int, place: int) -> LogWriter:
        path = segment_path(self._log, place)
        path.parent.mkdir(parents=True, exist_ok=True)  # somebody may have removed it
        writer = LogWriter(self._open_sink(path), sync_interval_ns=self._sync_interval_ns)
        try:
            if self._preamble.flight:
                told = {"flight": self._preamble.flight, "number": str(number)}
                writer.add_metadata(METADATA, with_crc(METADATA, told))
            for attachment in self._preamble.attachments:
                writer.attach(attachment.name, attachment.media_type, attachment.data, attachment.log_time_ns)
            for name, items in self._preamble.metadata.items():
                writer.add_metadata(name, items)
            for channel, dtype in self._channels.items():
                writer.register(channel, dtype)
            writer.flush()
        except OSError:
            writer.abandon()
            path.unlink()
            raise
        return writer

    def _open_ahead(self, now_ns: int) -> None:
        """Open the next segment at the next free name and sync its head; retried later if the disk fails."""
        if now_ns < self._open_again_ns:
            return
        self._open_again_ns = now_ns + _OPEN_AGAIN_NS
        try:
            self._ahead = free_place(self._log, self._ahead)
            self._next, self._why_not_ahead = self._open(self._number + 1, self._ahead), ""
        except OSError as error:  # meanwhile the current segment grows beyond its limit
            self._why_not_ahead = str(error)

    def _change(self, now_ns: int) -> None:
        """Switch to the next segment; all earlier rows are on the medium."""
        if self._next is None or self._ending is not None:
            return
        self._ending, self._writer, self._next = self._writer, self._next, None
        self._number, self._place, self._opened_ns = self._number + 1, self._ahead, now_ns
        self._ahead += 1
        self._open_again_ns, self._at_head = 0, dict(self.recorded)
        self._say_recorded()
        self._end_segment()

    def _look_after_files(self, now_ns: int) -> None:
        """Go on in the next segment where somebody removed, renamed or cut off the one in use; all rows are in it.

        Raises:
            OSError: no other can be made; it is tried again.
        """
        if self._next is not None and self._next.taken() is not None:
            self._next.abandon()
            self._next, self._open_again_ns = None, 0
            self._open_ahead(now_ns)  # past its name, where the one in use was renamed to that
        taken = self._writer.taken()
        if taken is None or self._ending is not None:
            return
        if self._next is None:
            self._open_ahead(now_ns)
        self._astray = self._next is None
        if self._astray:
            raise OSError(
                errno.ENOENT, f"{self.path.name} was {taken.how}, and no other can be made: {self._why_not_ahead}"
            )
        began_ns = now_ns if self._opened_ns is None else self._opened_ns
        path, before, nothing = self.path, self._at_head, ChannelProgress(-1, began_ns)
        is_lost = taken.rest < self._writer.bytes_written
        if is_lost:
            self._writer.abandon()
        if is_lost and taken.rest:
            before = before | recorded_at_end([path])
        rows = {
            name: (before.get(name, nothing), last)
            for name, last in self.recorded.items()
            if is_lost and last.sequence > before.get(name, nothing).sequence
        }
        count = sum(last.sequence - first.sequence for first, last in rows.values())
        what = f"{count} rows of {len(rows)} channels are lost" if is_lost else "its rows are there"
        where = segment_path(self._log, self._ahead).name
        self._losses.append(Loss(f"{path.name} was {taken.how}: {what}; goes on in {where}", is_lost, rows))
        self._change(now_ns)

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
