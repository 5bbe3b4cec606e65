"""Merges the logs of several recorders of one flight into one log, ordered by time.

Channels keep their names. If several logs have a channel of one name, events and gap records are prefixed with the name
of their log; channels of samples only with ``rename``, because their readers depend on the names. Channel names inside
rows (gap records, clocks) are changed alike. Attachments and metadata of the later logs are prefixed with their log's
name.

Joins recordings of one vehicle that were made one after the other: an arm without a load, and with one.

Their channels go on in the new log; a further channel says by its value, 1, 2, ..., which recording the rows are of. It
is what ``[estimation.phases] channel`` names, and ``payload_taken = 2`` where the second recording is the loaded one.
"""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.progress import Progress

from drivers.records import EVENT, GAP, SCALAR, Batch, Rows
from onboard.channels import CLOCK
from onboard.flight.store.flight_log import VEHICLE_ATTACHMENT
from onboard.ground.log.tables.progress import reporter
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.scan import Damage
from onboard.recording.format.segments import END, METADATA, RECORDED
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

NAME_BYTES = min(GAP["channel"].itemsize, CLOCK["channel"].itemsize)  # of a channel, as records hold it
PAUSE_S = 2.0  # between the recordings: longer than any smoothing
SAID_ns = 100_000_000  # how often the channel says it: a payload is taken at a phase's second reading


class RecorderLog(NamedTuple):
    """One recorder's log, and its mapping to the first one's clock: ``host_ns x rate + shift_ns``.

    ``label`` distinguishes its channels from the others'; the name of the log where it is empty. ``whole``: the path by
    which the whole flight was named, so that segments missing at its end are reported; None where segments were named.
    """

    segments: Sequence[Path]
    shift_ns: int = 0
    rate: float = 1.0
    label: str = ""
    whole: Path | None = None

    @property
    def name(self) -> str:
        """Prefix of its channels."""
        return self.label or self.segments[0].stem

    def open(self) -> LogReader:
        """A reader of it. Raises LogFormatError, OSError."""
        return LogReader(self.whole or self.segments)


class Merged(NamedTuple):
    """Rows by channel of the new log, damage of the old ones, and warnings."""

    rows: dict[str, int]
    damage: tuple[Damage, ...]
    warnings: tuple[str, ...]


def merge(
    parts: Sequence[RecorderLog], output: Path, *, rename: bool = False, progress: Progress | None = None
) -> Merged:
    """Write ``parts`` to a new log ``output``, in constant memory.

    Args:
        parts: the logs, at least two.
        output: the file to create.
        rename: prefix a channel of samples that several logs have with the name of its log.
        progress: receives a task that counts the bytes of the logs.

    Raises:
        ChannelError: several logs have a channel of samples without ``rename``, or a name gets too long.
        ValueError: fewer than two logs.
        FileExistsError: ``output`` exists.
        LogFormatError: a file is not a heft log.
        OSError: a log cannot be read, or the output not written.
    """
    if len(parts) < 2:
        raise ValueError(f"{parts[0].name if parts else 'nothing'}: give two logs or more to merge")
    logs = [part.open() for part in parts]
    parts = _labelled(parts, logs)
    names = _names(parts, logs, rename)
    tell = reporter(progress, f"merge {len(logs)} logs", sum(log.size for log in logs))
    rows = {new: 0 for known in names for new in known.values()}
    spans: list[tuple[int, int] | None] = [None] * len(logs)
    streams = [_stream(n, part, log, names[n]) for n, (part, log) in enumerate(zip(parts, logs, strict=True))]
    with LogWriter.create(output, durable=False) as writer:
        _describe(writer, parts, logs)
        for log, known in zip(logs, names, strict=True):
            for old, new in known.items():
                writer.register(new, log.channels[old], units=log.units[old])
        for first_ns, number, batch in heapq.merge(*streams, key=lambda item: item[:2]):
            writer.write(batch.channel, batch.rows)
            rows[batch.channel] += len(batch.rows)
            start_ns, end_ns = spans[number] or (first_ns, first_ns)
            spans[number] = min(start_ns, first_ns), max(end_ns, int(batch.rows["host_ns"][-1]))
            tell(sum(log.position for log in logs))
    damage = tuple(one for log in logs for one in log.damage)
    labels = [f"{part.label} is {part.segments[0]}" for part in parts if part.label]
    told = [f"channels that several logs have are renamed: {', '.join(labels)}"] if labels else []
    return Merged(rows, damage, (*told, *_strangers(parts, spans)))


def _labelled(parts: Sequence[RecorderLog], logs: Sequence[LogReader]) -> list[RecorderLog]:
    """``parts`` with the labels log1, log2, ... where their names are alike, or too long before a channel's name."""
    stems = [part.name for part in parts]
    every = [name for log in logs for name in log.channels]
    shared = max((len(name.encode()) for name in every if every.count(name) > 1), default=0)
    if len(set(stems)) == len(stems) and max(len(stem.encode()) for stem in stems) + 1 + shared <= NAME_BYTES:
        return list(parts)
    return [part._replace(label=f"log{number}") for number, part in enumerate(parts, 1)]


def _names(parts: Sequence[RecorderLog], logs: Sequence[LogReader], rename: bool) -> list[dict[str, str]]:
    """For each log: its channels and their names in the new one."""
    owners: dict[str, list[str]] = {}
    for part, log in zip(parts, logs, strict=True):
        for channel in log.channels:
            owners.setdefault(channel, []).append(part.name)
    clashes = [
        channel
        for channel, having in owners.items()
        if len(having) > 1
        and any(channel in log.channels and log.channels[channel] not in (EVENT, GAP) for log in logs)
    ]
    if clashes and not rename:
        told = ", ".join(f"{channel} ({' and '.join(owners[channel])})" for channel in clashes)
        raise ChannelError(f"several logs have the channels {told}; --rename puts the name of the log in front of each")
    return [
        {channel: f"{part.name}_{channel}" if len(owners[channel]) > 1 else channel for channel in log.channels}
        for part, log in zip(parts, logs, strict=True)
    ]


def _stream(number: int, part: RecorderLog, log: LogReader, names: dict[str, str]) -> Iterator[tuple[int, int, Batch]]:
    """First time, number of the log, rows; on the first log's clock and under the new names."""
    encoded = {old.encode(): new.encode() for old, new in names.items() if old != new}
    for channel, rows in log.batches():
        moved = rows.copy()
        if (part.shift_ns, part.rate) != (0, 1.0):
            stretch = np.rint(moved["host_ns"] * (part.rate - 1.0)).astype(np.int64)
            moved["host_ns"] += stretch + part.shift_ns
        if encoded and "channel" in (moved.dtype.names or ()):
            _rename(moved, encoded)
        yield int(moved["host_ns"][0]), number, Batch(names[channel], moved)


def _rename(rows: Rows, names: dict[bytes, bytes]) -> None:
    field = rows["channel"]
    for old in np.unique(field):
        if bytes(old) in names:
            field[field == old] = names[bytes(old)]


def _describe(writer: LogWriter, parts: Sequence[RecorderLog], logs: Sequence[LogReader]) -> None:
    """Attachments and metadata: the first log's as they are, the others' under the names of their logs."""
    for number, (part, log) in enumerate(zip(parts, logs, strict=True)):
        before = f"{part.name}." if number else ""
        for attachment in log.attachments.values():
            writer.attach(before + attachment.name, attachment.media_type, attachment.data, attachment.log_time_ns)
        for name, items in log.metadata.items():
            if name not in (METADATA, RECORDED, END):
                writer.add_metadata(before + name, items)
    sources = {
        part.name: f"host_ns x {part.rate!r} + {part.shift_ns} ns of {', '.join(path.name for path in part.segments)}"
        for part in parts
    }
    writer.add_metadata("merged", sources)


def _strangers(parts: Sequence[RecorderLog], spans: Sequence[tuple[int, int] | None]) -> Iterator[str]:
    first = spans[0]
    for part, span in zip(parts[1:], spans[1:], strict=True):
        if first is not None and span is not None and (span[0] > first[1] or span[1] < first[0]):
            yield (
                f"{part.name} and {parts[0].name} have no time in common, so their clocks differ: find the shift with "
                "heft resync, and merge with --align"
            )


def in_turn(parts: Sequence[RecorderLog], phase: str, output: Path, *, progress: Progress | None = None) -> Merged:
    """Write the recordings to a new log, in the order given.

    Args:
        parts: the logs, two or more, with the same channels; their clocks are not looked at.
        phase: name of the channel that says which it is.
        output: the file to create.
        progress: receives a task that counts the bytes read.

    Raises:
        ChannelError: a log with other channels than the first, with one called ``phase``, or without samples.
        ValueError: fewer than two logs, or a flight's log.
        FileExistsError: ``output`` exists.
        LogFormatError: a file is not a heft log.
        OSError: a log cannot be read, or the output not written.
    """
    if len(parts) < 2:
        raise ValueError("give two recordings or more to join")
    logs = [part.open() for part in parts]
    _require(logs, phase)
    tell = reporter(progress, "merge", sum(log.size for log in logs))
    spans = [_span(log) for log in logs]
    rows = {name: 0 for log in logs for name in log.channels} | {phase: 0}
    end_ns, following = spans[0][0] - round(PAUSE_S * 1e9), dict[str, int]()
    with LogWriter.create(output, durable=False) as writer:
        for name, kind in logs[0].channels.items():
            writer.register(name, kind, units=logs[0].units[name])
        writer.register(phase, SCALAR)
        for number, (log, (first_ns, last_ns)) in enumerate(zip(logs, spans, strict=True), 1):
            shift_ns = end_ns + round(PAUSE_S * 1e9) - first_ns
            before, due_ns = dict(following), first_ns + shift_ns
            for name, own in LogReader(log.segments).batches():
                moved = own.copy()
                moved["host_ns"] += shift_ns
                told = _said(number, rows[phase], due_ns, int(moved["host_ns"][0]))
                writer.write(phase, told)
                rows[phase] += len(told)
                due_ns += len(told) * SAID_ns
                _go_on(moved, name, before)
                following[name] = int(moved["sequence"][-1]) + 1
                writer.write(name, moved)
                rows[name] = rows.get(name, 0) + len(moved)
            tell(sum(done.size for done in logs[:number]))
            end_ns = last_ns + shift_ns
        sources = {str(number): ", ".join(path.name for path in log.segments) for number, log in enumerate(logs, 1)}
        writer.add_metadata("in turn", sources)
    return Merged(rows, tuple(one for log in logs for one in log.damage), ())


def _said(number: int, sequence: int, due_ns: int, up_to_ns: int) -> Rows:
    """Rows that say which recording it is, due until a time."""
    rows = np.zeros(max((up_to_ns - due_ns) // SAID_ns + 1, 0), SCALAR)
    rows["sequence"] = rows["tick"] = sequence + np.arange(len(rows))
    rows["host_ns"] = due_ns + SAID_ns * np.arange(len(rows))
    rows["value_raw"], rows["scale"], rows["unit"] = number, 1.0, b"1"
    return rows


def _go_on(rows: Rows, channel: str, before: Mapping[str, int]) -> None:
    """Count on from the recording before."""
    for count in ("sequence", "tick"):
        if count in (rows.dtype.names or ()):
            rows[count] += np.uint64(before.get(channel, 0))
    if rows.dtype == GAP:
        counted = [before.get(bytes(name).decode(), 0) for name in rows["channel"]]
        for end in ("first_missing", "last_missing"):
            rows[end] += np.array(counted, np.uint64)


def _of_samples(kind: np.dtype[np.void]) -> bool:
    return kind not in (EVENT, GAP)


def _samples(log: LogReader) -> dict[str, np.dtype[np.void]]:
    return {name: kind for name, kind in log.channels.items() if _of_samples(kind)}


def _require(logs: Sequence[LogReader], phase: str) -> None:
    first = _samples(logs[0])
    for log in logs:
        if VEHICLE_ATTACHMENT in log.attachments:
            raise ValueError(f"{log.path} is the log of a flight; its phases are in it, and it is identified by itself")
        if other := sorted({*first} ^ {*_samples(log)}):
            both = f"{log.path} and {logs[0].path}"
            raise ChannelError(f"{both} differ by channel {other[0]}; import them by the same mapping")
        if phase in log.channels:
            raise ChannelError(f"{log.path} has a channel {phase!r} already; name another")


def _span(log: LogReader) -> tuple[int, int]:
    """First and last time of its samples, ns."""
    first, last = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for _, rows in log.batches():
        if _of_samples(rows.dtype):
            first, last = min(first, int(rows["host_ns"].min())), max(last, int(rows["host_ns"].max()))
    if last < first:
        raise ChannelError(f"{log.path} has no samples")
    return first, last
