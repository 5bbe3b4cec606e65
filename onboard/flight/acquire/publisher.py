"""Pushes batches into rings; numbers the rows of shared channels (events, gaps).

A process that takes over the rings of a dead one continues their sequence numbers: its devices count from 0 again, so
their numbers are shifted past those estimated to be lost meanwhile, which a GAP row records.
"""

import threading
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from drivers.records import CHANGES_UNHEARD, SENT, Batch, Rows, SampleStatus, gap
from onboard.ring import RingWriter

SHARED_CHANNELS = ("event", "gap")
RESTART, ABSENT = "worker_restart", "absent_at_start"


class ExpectedChannel(NamedTuple):
    """What a channel that has no row yet is to bring.

    Attributes:
        period_ns: nominal, between rows; 0 where it has no rate.
        within_ns: a first row that comes so long after the start is in time: devices take a while to be set up.
        unheard: it tells changes, and its bus is not there: nobody knows how many are lost until its first row.
    """

    period_ns: float
    within_ns: int
    unheard: bool = False


class _Left(NamedTuple):
    """Last rows of the previous process in a channel."""

    sequence: int
    host_ns: int
    period_ns: float
    cause: str = RESTART
    status: int = SampleStatus.AFTER_RESET  # of the first row that follows
    value: int | None = None  # of a channel that tells changes: the last one
    within_ns: int = 0  # a first row so soon is in time


def joined(batches: Iterable[Batch]) -> list[Batch]:
    """The batches with the rows of a channel as one, but where a batch of a shared channel lies between them."""
    made: list[Batch] = []
    pieces: dict[str, list[Rows]] = {}
    for batch in batches:
        if batch.channel in SHARED_CHANNELS:
            made += _wholes(pieces)
            made.append(batch)
        elif len(batch.rows):
            pieces.setdefault(batch.channel, []).append(batch.rows)
    return made + _wholes(pieces)


def _wholes(pieces: dict[str, list[Rows]]) -> list[Batch]:
    """One batch for the rows of each channel; empties ``pieces``."""
    made = []
    for channel, rows in pieces.items():
        whole = rows[0]
        if len(rows) > 1:  # by bytes: padding stays as it is
            whole = np.frombuffer(bytearray().join(part.tobytes() for part in rows), whole.dtype)
        made.append(Batch(channel, whole))
    pieces.clear()
    return made


class Publisher:
    """The one writer of a process's rings.

    Args:
        rings: by channel name. Those that hold rows are taken over from a process that died.
        suffix: appended to the names of shared channels, so that every process has its own (``event_estimation``).
        renumber: devices start their numbers at 0 in this process.
        changes: channels of devices that send on change. Of these at least one row is lost if the value is another one
            than before; if it is the same, none is known to be.
    """

    def __init__(
        self,
        rings: Mapping[str, RingWriter],
        suffix: str = "",
        *,
        renumber: bool = False,
        changes: Collection[str] = (),
    ) -> None:
        self._rings, self._suffix = rings, suffix
        self._lock = threading.Lock()
        self._shift: dict[str, int] = {}
        self._left: dict[str, _Left] = {}
        if renumber:
            for name, ring in rings.items():
                if name not in SHARED_CHANNELS and len(rows := ring.newest()):
                    left = _left(rows)
                    if rows.dtype in SENT:
                        left = left._replace(period_ns=0.0)
                    if name in changes:
                        left = left._replace(period_ns=0.0, value=int(rows["value_raw"][-1]))
                    self._left[name] = left

    def expect(self, channels: Mapping[str, ExpectedChannel], since_ns: int) -> None:
        """Rows of ``channels`` were to come since ``since_ns``: what is missed until a late first one becomes a gap.

        Args:
            channels: what is expected of each.
            since_ns: CLOCK_MONOTONIC.
        """
        for channel, (period_ns, within_ns, unheard) in channels.items():
            if not self._rings[channel].published:
                cause = CHANGES_UNHEARD if unheard else ABSENT
                left = _Left(-1, since_ns, period_ns, cause, SampleStatus.OK)
                self._left[channel] = left._replace(within_ns=within_ns)

    def finish(self, now_ns: int) -> None:
        """Last call: channels that were expected and never brought a row are a gap from the start."""
        for channel in [name for name, left in self._left.items() if left.cause in (ABSENT, CHANGES_UNHEARD)]:
            self._take_over(channel, now_ns)

    def publish(self, batches: Iterable[Batch]) -> None:
        """Push each batch into its channel's ring."""
        for channel, rows in batches:
            if channel in SHARED_CHANNELS:
                self._publish_shared(channel, rows)
            elif len(rows):
                if channel in self._left:
                    value = int(rows["value_raw"][0]) if self._left[channel].value is not None else None
                    status = self._take_over(channel, int(rows["host_ns"][0]), value)
                    if "status" in (rows.dtype.names or ()):
                        rows["status"][0] |= status
                if channel in self._shift:
                    rows["sequence"] += np.uint64(self._shift[channel])
                self._rings[channel].push(rows)

    def _publish_shared(self, channel: str, rows: Rows) -> None:
        if channel == "gap":
            for row in rows:
                name = row["channel"].decode()
                if name in self._left:
                    self._take_over(name, int(row["host_ns"] - row["duration_ns"]))
                for field in ("first_missing", "last_missing"):
                    row[field] += np.uint64(self._shift.get(name, 0))
        self._number(channel, rows)

    def _number(self, channel: str, rows: Rows) -> None:
        with self._lock:
            ring = self._rings[channel + self._suffix]
            first = ring.published
            rows["sequence"] = range(first, first + len(rows))
            ring.push(rows)

    def _take_over(self, channel: str, host_ns: int, value: int | None = None) -> int:
        """Continue the numbers of ``channel``, record the rows lost until ``host_ns``; the next row's status."""
        sequence, left_ns, period_ns, cause, status, last_value, within_ns = self._left.pop(channel)
        is_told = period_ns and host_ns - left_ns > within_ns
        is_other = cause == CHANGES_UNHEARD or value != last_value
        missed = max(0, round((host_ns - left_ns) / period_ns) - 1) if is_told else int(is_other)
        self._shift[channel] = sequence + 1 + missed
        if missed:
            told = gap(host_ns, channel, sequence + 1, sequence + missed, host_ns - left_ns, cause)
            self._number("gap", told.rows)
        return status


def _left(rows: Rows) -> _Left:
    """The newest of ``rows`` (n,), and the channel's mean period in them; 0 where they do not tell."""
    numbers = int(rows["sequence"][-1] - rows["sequence"][0])
    span_ns = int(rows["host_ns"][-1] - rows["host_ns"][0])
    return _Left(int(rows["sequence"][-1]), int(rows["host_ns"][-1]), span_ns / numbers if numbers else 0.0)
