"""Summary of a log on one screen (``heft info``).

Missing sequence numbers of a channel, as sets of ranges.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.progress import Progress
from rich.table import Column, Table
from rich.text import Text

from drivers.records import EVENT, GAP, Batch, Rows, Severity
from onboard.ground.log.tables.progress import follow
from onboard.recording.format.scan import Damage
from onboard.recording.format.schema import message_name
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

Ranges = NDArray[np.int64]  # (n, 2): first and last number of each, both included

NO_RANGES: Ranges = np.empty((0, 2), np.int64)
_EVENTS_KEPT = 6
_MODES_KEPT = 50
_OWN_VERSION = ("heft", "revision")  # the others are in --json
_DAMAGE_SHOWN = 5


def union(ranges: Ranges) -> Ranges:
    """The numbers of ``ranges`` (n, 2) as ascending, disjoint, non-adjacent ranges."""
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    if not len(ranges):
        return NO_RANGES
    reach = np.maximum.accumulate(ranges[:, 1])
    opens = np.concatenate([[True], ranges[1:, 0] > reach[:-1] + 1])
    return np.stack([ranges[opens, 0], reach[np.concatenate([opens[1:], [True]])]], axis=1)


def count(ranges: Ranges) -> int:
    """Count of numbers in disjoint ``ranges`` (n, 2)."""
    return int((ranges[:, 1] - ranges[:, 0] + 1).sum())


def common(a: Ranges, b: Ranges) -> int:
    """Count of numbers in both of two sets."""
    return count(union(a)) + count(union(b)) - count(union(np.concatenate([a, b])))


class Continuity:
    """Tracks the sequence numbers of one channel: call ``add`` with its rows in order."""

    def __init__(self) -> None:
        self.rows = 0
        self.repeated = 0  # rows whose number is not above the previous one: duplicate, or restart
        self.first_sequence = self.last_sequence = 0
        self.first_ns = self.last_ns = 0
        self._missing: list[Ranges] = []

    def add(self, rows: Rows) -> None:
        """Add the next rows (n,), n > 0."""
        sequence = rows["sequence"].astype(np.int64)
        if not self.rows:
            self.first_sequence, self.first_ns = int(sequence[0]), int(rows["host_ns"][0])
        else:
            sequence = np.concatenate([[self.last_sequence], sequence])
        step = np.diff(sequence)
        jumps = np.flatnonzero(step > 1)
        if len(jumps):
            self._missing.append(np.stack([sequence[jumps] + 1, sequence[jumps + 1] - 1], axis=1))
        self.repeated += int(np.count_nonzero(step <= 0))
        self.rows += len(rows)
        self.last_sequence, self.last_ns = int(sequence[-1]), int(rows["host_ns"][-1])

    @property
    def missing(self) -> Ranges:
        """Numbers missing between the first and the last row, ranges (n, 2)."""
        return np.concatenate([NO_RANGES, *self._missing])

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of arrival, Hz; None for fewer than two instants."""
        duration_ns = self.last_ns - self.first_ns
        return (self.rows - 1) * 1e9 / duration_ns if duration_ns > 0 else None


@dataclass(frozen=True)
class ChannelInfo:
    """One channel: rows recorded, missing, and covered by gap records.

    ``missing``: sequence numbers missing between the first and the last row. ``gaps``: numbers in gap records without a
        row, also before the first and after the last row. ``about``: those of them in no record that counted them:
        about as many are missing. ``unexplained``: missing numbers in no gap record.
        ``flagged``: rows whose status is not 0.
    """

    name: str
    record: str
    rows: int
    rate_hz: float | None
    first_sequence: int
    last_sequence: int
    missing: int
    gaps: int
    about: int
    unexplained: int
    repeated: int
    flagged: int


@dataclass(frozen=True)
class EventLine:
    """One warning or error."""

    host_ns: int
    severity: int
    code: str
    source: str
    text: str


@dataclass(frozen=True)
class LogInfo:
    """Summary of a log. Times are the recording host's CLOCK_MONOTONIC."""

    path: Path
    size_bytes: int
    start_ns: int
    end_ns: int
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, int]
    channels: tuple[ChannelInfo, ...]
    events: tuple[EventLine, ...]
    event_counts: dict[int, int]
    modes: tuple[EventLine, ...]
    damage: tuple[Damage, ...]
    truncated: bool
    exit_code: int

    @property
    def duration_s(self) -> float:
        """From the first row of any channel to the last."""
        return (self.end_ns - self.start_ns) * 1e-9

    @property
    def rows(self) -> int:
        """Rows of all channels."""
        return sum(channel.rows for channel in self.channels)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        channels = [asdict(channel) for channel in self.channels]
        damage = [str(one) for one in self.damage]
        plain = {"path": str(self.path), "damage": damage, "duration_s": self.duration_s, "channels": channels}
        return asdict(replace(self, path=Path(), damage=(), channels=())) | plain

    @property
    def unexplained(self) -> int:
        """Missing rows of all channels without a gap record."""
        return sum(channel.unexplained for channel in self.channels)


class _Gatherer:
    """One pass over the rows."""

    def __init__(self, dtypes: dict[str, np.dtype[np.void]]) -> None:
        self.dtypes = dtypes
        self.channels = {name: Continuity() for name in dtypes}
        self.flagged = dict.fromkeys(dtypes, 0)
        self.events: list[EventLine] = []
        self.event_counts: dict[int, int] = {}
        self.modes: list[EventLine] = []
        self._gaps: dict[str, list[Ranges]] = {}
        self._counted: dict[str, list[Ranges]] = {}
        self.span: tuple[int, int] | None = None

    def add(self, batch: Batch) -> None:
        rows = batch.rows
        self.channels[batch.channel].add(rows)
        first, last = int(rows["host_ns"].min()), int(rows["host_ns"].max())
        start, end = self.span or (first, last)
        self.span = min(start, first), max(end, last)
        if "status" in (rows.dtype.names or ()):
            self.flagged[batch.channel] += int(np.count_nonzero(rows["status"]))
        if rows.dtype == GAP:
            self._add_gaps(rows)
        elif rows.dtype == EVENT:
            self._add_events(rows)

    def _add_gaps(self, rows: Rows) -> None:
        for channel in np.unique(rows["channel"]):
            of_channel = rows[rows["channel"] == channel]
            ranges = np.stack([of_channel["first_missing"], of_channel["last_missing"]], axis=1).astype(np.int64)
            self._gaps.setdefault(printable(channel), []).append(ranges)
            self._counted.setdefault(printable(channel), []).append(ranges[of_channel["counted"] != 0])

    def _add_events(self, rows: Rows) -> None:
        for severity, number in zip(*np.unique(rows["severity"], return_counts=True), strict=True):
            self.event_counts[int(severity)] = self.event_counts.get(int(severity), 0) + int(number)
        lines = [_event_line(row) for row in rows[rows["severity"] >= Severity.WARNING][-_EVENTS_KEPT:]]
        if len(self.modes) < _MODES_KEPT:
            self.modes += [_event_line(row) for row in rows[rows["code"] == b"mode"][:_MODES_KEPT]]
        self.events = sorted([*self.events, *lines], key=lambda line: line.host_ns)[-_EVENTS_KEPT:]

    def channel_info(self, name: str) -> ChannelInfo:
        seen = self.channels[name]
        told, counted = (_union_of(ranges.get(name, [])) for ranges in (self._gaps, self._counted))
        missing = seen.missing
        explained = common(told, missing)
        recorded = np.array([[seen.first_sequence, seen.last_sequence]]) if seen.rows else NO_RANGES
        outside = count(told) - common(told, recorded)
        return ChannelInfo(
            name=name,
            record=message_name(name, self.dtypes[name]).rpartition("/")[2],
            rows=seen.rows,
            rate_hz=seen.rate_hz,
            first_sequence=seen.first_sequence,
            last_sequence=seen.last_sequence,
            missing=count(missing),
            gaps=explained + outside,
            about=explained + outside - common(counted, missing) - count(counted) + common(counted, recorded),
            unexplained=count(missing) - explained,
            repeated=seen.repeated,
            flagged=self.flagged[name],
        )


def _union_of(ranges: list[Ranges]) -> Ranges:
    told = union(np.concatenate([NO_RANGES, *ranges]))
    return told[told[:, 0] <= told[:, 1]]


def _event_line(row: np.void) -> EventLine:
    texts = (printable(row[field]) for field in ("code", "source", "text"))
    return EventLine(int(row["host_ns"]), int(row["severity"]), *texts)


def info(log: LogReader | str | Path, progress: Progress | None = None) -> LogInfo:
    """Summarise ``log`` in one further pass over it, in constant memory.

    Args:
        log: the log, or its path.
        progress: gets a task that counts the bytes of the log.

    Raises:
        LogFormatError: not a heft log.
        OSError: it cannot be read.
    """
    reader = log if isinstance(log, LogReader) else LogReader(log)
    gatherer = _Gatherer(reader.channels)
    tell = follow(progress, "read", reader)
    for batch in reader.batches():
        gatherer.add(batch)
        tell()
    start_ns, end_ns = gatherer.span or (0, 0)
    return LogInfo(
        path=reader.path,
        size_bytes=reader.size,
        start_ns=start_ns,
        end_ns=end_ns,
        metadata=reader.metadata,
        attachments={name: len(attachment.data) for name, attachment in reader.attachments.items()},
        channels=tuple(gatherer.channel_info(name) for name in reader.channels),
        events=tuple(gatherer.events),
        event_counts=gatherer.event_counts,
        modes=tuple(gatherer.modes),
        damage=reader.damage,
        truncated=reader.truncated,
        exit_code=reader.exit_code,
    )


def render(about: LogInfo) -> RenderableType:
    """``about`` for a terminal."""
    return Group(_head(about), _channel_table(about), *_empty_line(about), *_event_lines(about), *_verdict(about))


def _head(about: LogInfo) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row("log", Text(str(about.path)))
    table.add_row("length", f"{about.duration_s:.3f} s, {about.rows:,} rows, {about.size_bytes / 1e6:.2f} MB")
    for name, items in about.metadata.items():
        if name == "clock_map":  # the delays in it stand below, the rest in --json
            continue
        shown = {key: value for key, value in items.items() if name != "versions" or key in _OWN_VERSION}
        table.add_row(name, Text(", ".join(f"{key} {value}" for key, value in shown.items())))
    if about.modes:
        told = (f"{one.text.partition(':')[0]} {(one.host_ns - about.start_ns) * 1e-9:.1f} s" for one in about.modes)
        table.add_row("modes", Text(", ".join(told)))
    if about.attachments:
        table.add_row("files", Text(", ".join(f"{name} ({size:,} B)" for name, size in about.attachments.items())))
    return table


def _channel_table(about: LogInfo) -> Table:
    headings = ("rows", "rate Hz", "missing", "in gaps", "unexplained", "flagged")
    columns = Column("channel", no_wrap=True), *(Column(heading, justify="right") for heading in headings)
    table = Table(*columns, box=None, padding=(0, 1), pad_edge=False, header_style="bold")
    for channel in about.channels:
        if not (channel.rows or channel.gaps):
            continue
        rate = "" if channel.rate_hz is None else f"{channel.rate_hz:.2f}"
        gaps = f"about {channel.gaps:,}" if channel.about else _count(channel.gaps)
        unexplained = Text(_count(channel.unexplained), style="bold red" if channel.unexplained else "")
        counts = f"{channel.rows:,}", rate, _count(channel.missing), gaps
        table.add_row(Text(channel.name), *counts, unexplained, _count(channel.flagged))
    return table


def _empty_line(about: LogInfo) -> list[RenderableType]:
    empty = [channel.name for channel in about.channels if not (channel.rows or channel.gaps)]
    return [Text(f"without rows: {', '.join(empty)}")] if empty else []


def _count(number: int) -> str:
    return f"{number:,}" if number else "-"


def _event_lines(about: LogInfo) -> list[RenderableType]:
    if not about.event_counts:
        return []
    counts = ", ".join(f"{number} {_severity(severity)}" for severity, number in sorted(about.event_counts.items()))
    table = Table(box=None, padding=(0, 1), pad_edge=False, show_header=False)
    for event in about.events:
        style = {Severity.INFO: "", Severity.WARNING: "yellow"}.get(Severity(min(event.severity, 2)), "red")
        when = f"{(event.host_ns - about.start_ns) * 1e-9:.3f} s"
        cells = [Text(text) for text in (event.code, event.source, event.text)]
        table.add_row(when, Text(_severity(event.severity), style=style), *cells)
    if not about.events:
        return [Text(f"events: {counts}")]
    return [Text(f"events: {counts}; the last warnings and errors:", style="bold"), table]


def _severity(number: int) -> str:
    return Severity(number).name.lower() if number in Severity._value2member_map_ else str(number)


def _verdict(about: LogInfo) -> list[RenderableType]:
    lines: list[RenderableType] = [Text(str(one), style="red") for one in about.damage[:_DAMAGE_SHOWN]]
    if len(about.damage) > _DAMAGE_SHOWN:
        lines.append(Text(f"and {len(about.damage) - _DAMAGE_SHOWN} more", style="red"))
    if not about.damage:
        lines.append(Text("intact: every checksum is right", style="green"))
    if about.unexplained:
        lines.append(Text(f"{about.unexplained:,} rows are missing without a gap record", style="bold red"))
    return lines
