"""Joins recordings of one vehicle that were made one after the other: an arm without a load, and with one.

Their channels go on in the new log; a further channel says by its value, 1, 2, ..., which recording the rows are of. It
is what ``[estimation.phases] channel`` names, and ``payload_taken = 2`` where the second recording is the loaded one.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.progress import Progress

from drivers.records import EVENT, GAP, SCALAR, Rows
from onboard.flight.store.flight_log import VEHICLE_ATTACHMENT
from onboard.ground.log.rescue.merge import Merged, RecorderLog
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

PAUSE_S = 2.0  # between the recordings: longer than any smoothing
SAID_ns = 100_000_000  # how often the channel says it: a payload is taken at a phase's second reading


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
    task = None if progress is None else progress.add_task("merge", total=sum(log.size for log in logs))
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
            if progress is not None and task is not None:
                progress.update(task, advance=log.size)
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
            raise ChannelError(f"{both} differ by channel {other[0]}; import them by one mapping")
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
