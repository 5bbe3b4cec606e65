"""Recording worker: copies rows from rings to the log, step by step.

The rings are its buffer. While the disk fails, rings are not drained; only rows that no longer fit are dropped, oldest
first, and recorded in a ``GAP`` row with the cause when writing works again. While the disk is nearly full only events
and gaps are recorded and other rows are dropped in the same way. Acquisition is not affected.

The recorder writes its events and gaps to two channels of its own, so that sequence numbers do not collide.

Reads one ring for the recorder and accounts for recorded and lost sequence numbers.
"""

import errno
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity
from onboard.recording.recorded import GAP_CHANNEL, ChannelProgress
from onboard.recording.segmented import Loss, SegmentedLog
from onboard.recording.space import SpaceGuard, refusal
from onboard.ring import RingReader

OVERRUN = "ring_overrun"
EVENT_CHANNEL = "recorder_event"
REFUSED, FULL, LOG_LOST = "disk_refused", "disk_full", "log_lost"
NOT_KEPT = frozenset({LOG_LOST, OVERRUN, "rows_lost"})  # events that say that rows are not in the log
_SOURCE = "recorder"
_KEPT = 0.75  # fill level kept while a ring is not drained: the rest takes rows until the next step
_TELL_NS = _LOOK_NS = 1_000_000_000
_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)


class Missing(NamedTuple):
    """Sequence numbers lost to the log: ``first`` to ``last``, both included."""

    first: int
    last: int
    from_ns: int  # host time of the row before
    to_ns: int  # of the row after; of the last missing one while there is none
    cause: str


class RingSource:
    """Reads or drops the rows of a ring and accounts for each.

    Args:
        ring: its reading end.
        recorded: last recorded row; None if there is none.
    """

    def __init__(self, ring: RingReader, recorded: ChannelProgress | None = None) -> None:
        self.ring, self.name = ring, ring.name
        self.missing: list[Missing] = []  # not yet in a gap record
        self.unplaced = 0  # lost rows without a jump of the sequence numbers
        self._last = recorded
        self._waiting = 0  # lost rows without a later row so far
        self._rejoining = recorded is not None and not ring.seek_after(recorded.sequence)

    def take(self) -> tuple[Rows, int]:
        """Rows to record, and the number lost by the ring."""
        rows, lost = self.ring.read()
        self._account(rows, lost)
        return rows, lost

    def drop(self, keep: int, cause: str) -> int:
        """Drop the oldest rows until at most ``keep`` remain; returns the number, including those lost by the ring."""
        excess = self.ring.backlog - keep
        if excess <= 0:
            return 0
        rows, lost = self.ring.read(excess)
        before = self._last
        self._account(rows, lost)
        if len(rows):
            sequence = rows["sequence"].astype(np.int64)
            host_ns = rows["host_ns"].astype(np.int64)
            starts = np.flatnonzero(np.concatenate([[True], np.diff(sequence) != 1]))
            ends = np.concatenate([starts[1:], [len(rows)]]) - 1
            before_ns = np.concatenate([[before.host_ns if before else host_ns[0]], host_ns[:-1]])
            for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
                span_ns = int(before_ns[start]), int(host_ns[end])
                self._miss(Missing(int(sequence[start]), int(sequence[end]), *span_ns, cause))
        return len(rows) + lost

    def _miss(self, missing: Missing) -> None:
        if self.missing and self.missing[-1].cause == missing.cause and self.missing[-1].last + 1 == missing.first:
            missing = missing._replace(first=self.missing[-1].first, from_ns=self.missing.pop().from_ns)
        self.missing.append(missing)

    def _account(self, rows: Rows, lost: int) -> None:
        """Locate ``lost`` rows at jumps of the sequence numbers before or among ``rows``."""
        self._waiting += lost
        if not len(rows):
            return
        if not (self._waiting or self._rejoining or self.missing):
            self._last = ChannelProgress(int(rows["sequence"][-1]), int(rows["host_ns"][-1]))
            return
        sequence, host_ns = rows["sequence"].astype(np.int64), rows["host_ns"].astype(np.int64)
        first_ns = int(host_ns[0])
        if self.missing and self.missing[-1].last + 1 == sequence[0]:
            self.missing[-1] = self.missing[-1]._replace(to_ns=first_ns)
        last = self._last or ChannelProgress(-1, first_ns)
        if self._rejoining:  # all rows between the log and the ring are lost, whatever the ring has counted
            self._waiting, self._rejoining = max(0, int(sequence[0]) - last.sequence - 1), False
        if self._waiting:
            before = np.concatenate([[last.sequence], sequence[:-1]])
            before_ns = np.concatenate([[last.host_ns], host_ns[:-1]])
            for jump in np.flatnonzero(sequence - before > 1):
                first, end = int(before[jump]) + 1, int(sequence[jump])
                self._miss(Missing(first, end - 1, int(before_ns[jump]), int(host_ns[jump]), OVERRUN))
                self._waiting -= end - first
                if self._waiting <= 0:  # further jumps are losses already reported by the device
                    break
            self.unplaced += max(0, self._waiting)
            self._waiting = 0
        self._last = ChannelProgress(int(sequence[-1]), int(host_ns[-1]))


class StepReport(NamedTuple):
    """Result of a step: rows accepted, rows lost, and whether the disk fails."""

    rows: int
    lost: int
    failing: bool


class Recorder:
    """Drains rings into a log. No method raises for a disk error: it becomes an event and ``StepReport.failing``.

    Args:
        writer: the log; the caller may attach files to it.
        rings: drained in this order, each into the channel of its own name.
        recorded: last recorded row of each channel in a log begun by another recorder.
        space: monitors the disk's free space.
        said: called with each event of the recorder's own, which go into the log without a ring.
        losses: gives, and forgets, the segments that somebody removed, renamed or cut off.

    Raises:
        SchemaError: the record of a ring cannot be written as a ROS 2 message.
        ChannelError: two rings of one name differ in their record.
    """

    def __init__(
        self,
        writer: SegmentedLog,
        rings: Iterable[RingReader],
        *,
        recorded: Mapping[str, ChannelProgress] | None = None,
        space: SpaceGuard | None = None,
        said: Callable[[Rows], object] = lambda rows: None,
        losses: Callable[[], Iterable[Loss]] = tuple,
    ) -> None:
        recorded = recorded or {}
        self._writer, self._space, self._said, self._losses = writer, space, said, losses
        self._sources = [RingSource(ring, recorded.get(ring.name)) for ring in rings]
        channels = (GAP_CHANNEL, EVENT_CHANNEL)
        self._sequence = {name: recorded[name].sequence + 1 if name in recorded else 0 for name in channels}
        self.lost = 0  # rows, since the start
        self._failing_since_ns: int | None = None
        self._refusal = REFUSED
        self._room = True
        self._look_ns = self._tell_ns = 0
        self._told_gaps = 0  # gap records whose rows an event has said to be lost
        for source in self._sources:
            writer.register(source.name, source.ring.dtype)
        writer.register(GAP_CHANNEL, records.GAP)
        writer.register(EVENT_CHANNEL, records.EVENT)

    @property
    def failing(self) -> bool:
        """Whether the disk refuses, so that nothing is recorded."""
        return self._writer.failing

    @property
    def has_room(self) -> bool:
        """Whether the disk has room for all channels, not only for events and gaps."""
        return self._room

    @property
    def disk_free(self) -> int:
        """Bytes, as last asked; -1 where that is not known."""
        return -1 if self._space is None else self._space.free

    def backlog(self) -> dict[str, int]:
        """Rows in each ring that are not in the log."""
        return {source.name: source.ring.backlog for source in self._sources}

    def step(self, now_ns: int) -> StepReport:
        """Record the rows in the rings."""
        self._look(now_ns)
        if self._writer.failing:
            self._sync(now_ns)
        report = self._drain(now_ns)
        if not self._writer.failing:
            self._sync(now_ns)
        return report._replace(failing=self._writer.failing)

    def close(self, now_ns: int) -> StepReport:
        """Record the remaining rows of the rings and close the log.

        Returns:
            ``failing`` if the disk failed: call it again, or ``abandon`` the writer.
        """
        report = StepReport(0, 0, False) if self._writer.ended else self.step(now_ns)
        try:
            if not self._writer.failing and not self._writer.ended:
                self._give_up_the_rest(now_ns)
                self._tell_lost(now_ns)
            self._writer.close()
        except OSError:
            return report._replace(failing=True)
        if self._space is not None:
            self._space.close()
        return report._replace(failing=False)

    def abandon(self) -> None:
        """Give up closing a log on a failing disk; rows not written remain in the rings."""
        self._writer.abandon()
        if self._space is not None:
            self._space.close()

    def say(self, now_ns: int, severity: Severity, code: str, text: str) -> None:
        """Write an event of the recorder to the log."""
        batch = records.event(now_ns, severity, code, _SOURCE, text)
        self._own(EVENT_CHANNEL, batch)
        self._said(batch.rows)

    def _drain(self, now_ns: int) -> StepReport:
        taken = lost = 0
        tell = now_ns - self._tell_ns >= _TELL_NS
        for source in self._sources:
            if self._writer.failing:
                lost += source.drop(int(_KEPT * source.ring.capacity), self._refusal)
            elif self._room or _essential(source):
                rows, missed = source.take()
                lost += missed
                self._tell_missing(now_ns, source)
                if len(rows):
                    self._write(now_ns, source.name, rows)
                    taken += len(rows)
            else:
                lost += source.drop(int(_KEPT * source.ring.capacity), FULL)
                if tell:
                    self._tell_missing(now_ns, source)
        if tell:
            self._tell_ns = now_ns
        self.lost += lost
        return StepReport(taken, lost, self._writer.failing)

    def _give_up_the_rest(self, now_ns: int) -> None:
        """Drop the rows in the rings, at the end of a flight with the disk nearly full."""
        for source in self._sources:
            if not self._room and not _essential(source):
                source.drop(0, FULL)
            self._tell_missing(now_ns, source)

    def _tell_lost(self, now_ns: int) -> None:
        """Say once that the log is not whole, also where a recorder that died left rows out."""
        if (gaps := self._sequence[GAP_CHANNEL] - self._told_gaps) > 0:
            self._told_gaps += gaps
            text = f"rows that came are not in the log: {gaps} gap records of the recorder say which (heft info)"
            self.say(now_ns, Severity.ERROR, "rows_lost", text)

    def _tell_missing(self, now_ns: int, source: RingSource) -> None:
        for first, last, from_ns, to_ns, cause in source.missing:
            self._own(GAP_CHANNEL, records.gap(now_ns, source.name, first, last, to_ns - from_ns, cause, counted=True))
        source.missing.clear()
        if source.unplaced:
            text = f"{source.name}: {source.unplaced} rows were lost that its sequence numbers do not show"
            self.say(now_ns, Severity.ERROR, OVERRUN, text)
            source.unplaced = 0

    def _own(self, channel: str, batch: Batch) -> None:
        """Write a row to a channel of the recorder."""
        batch.rows["sequence"] = self._sequence[channel]
        self._sequence[channel] += 1
        self._write(int(batch.rows["host_ns"][0]), channel, batch.rows)

    def _write(self, now_ns: int, channel: str, rows: Rows) -> None:
        try:
            self._writer.write(channel, rows)
        except OSError as error:
            self._refused(now_ns, error)

    def _sync(self, now_ns: int) -> None:
        try:
            self._writer.sync(now_ns)
        except OSError as error:
            self._refused(now_ns, error)
        for loss in self._losses():
            self.say(now_ns, Severity.ERROR, LOG_LOST if loss.is_lost else "log_moved", loss.text)
            for channel, (before, last) in loss.rows.items():
                span = before.sequence + 1, last.sequence, max(0, last.host_ns - before.host_ns)
                self._own(GAP_CHANNEL, records.gap(now_ns, channel, *span, LOG_LOST, counted=True))
                self._told_gaps += 1
        if self._failing_since_ns is not None and not self._writer.failing:
            since_ns, self._failing_since_ns = self._failing_since_ns, None
            text = f"the disk accepts writes again after {(now_ns - since_ns) * 1e-9:.3f} s"
            self.say(now_ns, Severity.INFO, "disk_resumed", text)

    def _refused(self, now_ns: int, error: OSError) -> None:
        self._refusal = FULL if error.errno in _FULL_ERRORS else REFUSED
        if self._failing_since_ns is None:
            self._failing_since_ns = now_ns
            text = f"write to the log failed: {refusal(error, short=True)}; the rings hold what comes"
            self.say(now_ns, Severity.ERROR, "disk_error", text)
        if self._refusal == FULL:
            self._look(now_ns, refused=True)

    def _look(self, now_ns: int, *, refused: bool = False) -> None:
        """Check the disk's free space, once a second and after a write failed for lack of space."""
        if self._space is None or not (refused or now_ns - self._look_ns >= _LOOK_NS):
            return
        self._look_ns = now_ns
        try:
            room = self._space.look(refused=refused)
        except OSError as error:
            self._look_ns = now_ns + 9 * _LOOK_NS
            self.say(now_ns, Severity.WARNING, "disk_not_asked", f"free space is not known: {error}")
            return
        for text in room.strange:
            self.say(now_ns, Severity.WARNING, "no_reserve_file", text)
        for path in room.removed:
            self.say(now_ns, Severity.WARNING, "old_flight_removed", f"{path.name}, to make room on the disk")
        if room.for_all != self._room:
            self._room = room.for_all
            if room.for_all:
                self.say(now_ns, Severity.INFO, "disk_has_room", "all channels are recorded again")
            else:
                text = "the disk is nearly full: only events and gaps are recorded; remove what is not needed"
                self.say(now_ns, Severity.ERROR, "disk_nearly_full", text)


def _essential(source: RingSource) -> bool:
    """Whether the channel is one of events or gaps, which are recorded even on a nearly full disk."""
    return source.ring.dtype in (records.EVENT, records.GAP)
