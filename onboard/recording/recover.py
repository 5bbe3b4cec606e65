"""Copies the readable part of a damaged log into a new, intact one, and reports the rest.

Every chunk with a right CRC is copied; damage between them is skipped. Missing sequence numbers without a gap record of
the flight get a gap record in the recovered log.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers import records
from drivers.records import Rows
from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.scan import Damage
from onboard.recording.format.segments import END, METADATA, RECORDED, beside
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress, marks_of
from onboard.recording.writer import LogWriter

GAP_CHANNEL = "recover_gap"
LOST = "lost_from_log"
EXIT_LOSSLESS, EXIT_NOTHING, EXIT_LOSSY = 0, 1, 3
_TURN = 1 << 64  # a crafted log may hold any u64 as sequence number
_LONGEST_NS = (1 << 63) - 1


class Gap(NamedTuple):
    """Sequence numbers ``first`` to ``last`` (included) of a channel that are not in the log."""

    channel: str
    first: int
    last: int
    duration_ns: int  # host time from the row before to the row after
    cause: str  # cause recorded in flight; LOST: lost with the damaged part of the log
    host_ns: int  # time of the gap record; without one, of the row after the gap

    def __str__(self) -> str:
        numbers = f"{self.first}" if self.first == self.last else f"{self.first} to {self.last}"
        return f"{self.channel}: {numbers} missing, {self.duration_ns * 1e-9:.3f} s, {self.cause}"


class Recovery(NamedTuple):
    """Result of a recovery.

    ``problem``: reason if nothing was recovered; ``others``: segments of the flight that were not asked for.
    """

    rows: dict[str, int]
    gaps: tuple[Gap, ...]
    damage: tuple[Damage, ...]
    problem: str = ""
    others: tuple[Path, ...] = ()

    @property
    def exit_code(self) -> int:
        """0: lossless; 3: some rows are lost; 1: nothing could be read."""
        if self.problem or (self.damage and not any(self.rows.values())):
            return EXIT_NOTHING
        return EXIT_LOSSY if self.damage or any(gap.cause == LOST for gap in self.gaps) else EXIT_LOSSLESS


class _Jump(NamedTuple):
    """Sequence numbers skipped by the rows of a channel, and the host times on both sides."""

    first: int
    last: int
    from_ns: int
    to_ns: int


class _Track:
    """Tracks a channel's sequence numbers; ``next`` is the expected number of its first row."""

    def __init__(self, expected: int) -> None:
        self._next = expected
        self._last_ns: int | None = None
        self.rows = 0
        self.jumps: list[_Jump] = []

    def add(self, rows: Rows) -> None:
        sequence, host_ns = rows["sequence"], rows["host_ns"]
        following = np.concatenate([[np.uint64(self._next % _TURN)], sequence[:-1] + np.uint64(1)])  # may wrap around
        before_ns = np.concatenate([[host_ns[0] if self._last_ns is None else self._last_ns], host_ns[:-1]])
        for at in np.flatnonzero(sequence > following):
            self.jumps.append(_Jump(int(following[at]), int(sequence[at]) - 1, int(before_ns[at]), int(host_ns[at])))
        self._next, self._last_ns = int(sequence[-1]) + 1, int(host_ns[-1])
        self.rows += len(rows)


def recover(
    log: Path | Sequence[Path], output: Path, progress: Callable[[int, int], None] = lambda done, size: None
) -> Recovery:
    """Write the readable part of ``log`` to a new file ``output``, in constant memory.

    Args:
        log: as for ``LogReader``.
        output: the file to create; not created if there is nothing to recover.
        progress: called with bytes read and total bytes.

    Raises:
        FileExistsError: ``output`` exists.
        OSError: the log cannot be read, or the output not written.
    """
    try:
        reader = LogReader(log)
        damage = reader.damage
    except LogFormatError as error:
        return Recovery({}, (), (), str(error))
    if not reader.channels and damage:
        return Recovery({}, (), damage, "no chunk of the log can be read")
    others, missing = ((), None) if reader.is_flight else _elsewhere(reader.segments)
    damage = damage if missing is None else (missing, *damage)
    before = {} if reader.is_flight else marks_of(LogReader(reader.segments[:1]).metadata.get(RECORDED, {}))
    tracks = {name: _Track(_after(before.get(name))) for name in reader.channels}
    told: list[Gap] = []
    with LogWriter.create(output) as writer:
        for attachment in reader.attachments.values():
            writer.attach(attachment.name, attachment.media_type, attachment.data, attachment.log_time_ns)
        for name, items in reader.metadata.items():
            if name not in (METADATA, RECORDED, END):
                writer.add_metadata(name, items)
        for name, dtype in reader.channels.items():
            writer.register(name, dtype, units=reader.units[name])
        writer.register(GAP_CHANNEL, records.GAP)
        for name, rows in reader.batches():
            writer.write(name, rows)
            tracks[name].add(rows)
            if rows.dtype == records.GAP:
                told += _recorded_gaps(rows)
            progress(reader.position, reader.size)
        untold = [gap for name, track in tracks.items() for gap in _unrecorded_gaps(name, track.jumps, told)]
        known = tracks[GAP_CHANNEL].rows if GAP_CHANNEL in tracks else 0
        for number, gap in enumerate(untold, known):
            row = records.gap(gap.host_ns, *gap[:5], counted=True).rows
            row["sequence"] = number
            writer.write(GAP_CHANNEL, row)
        writer.add_metadata("recovered", _account(reader, untold))
    return Recovery({name: track.rows for name, track in tracks.items()}, (*told, *untold), damage, "", others)


def _elsewhere(given: Sequence[Path]) -> tuple[tuple[Path, ...], Damage | None]:
    """Segments of the flight that are not among those ``given``, and the missing ones."""
    found = beside(given[-1])
    others = tuple(path for path in found.others if path.name not in {one.name for one in given})
    if not found.missing:
        return others, None
    first, *rest = found.missing
    more = f" and {len(rest)} more" if rest else ""
    return others, Damage(
        0, 0, f"segment {first}{more} of its flight is not beside it; put it there if it is elsewhere"
    )


def _after(mark: ChannelProgress | None) -> int:
    """The number after the one that metadata ``recorded`` gives."""
    return 0 if mark is None else mark.sequence + 1


def _recorded_gaps(rows: Rows) -> Iterator[Gap]:
    for row in rows:
        first, last, duration_ns = (int(row[name]) for name in ("first_missing", "last_missing", "duration_ns"))
        channel, cause = (printable(row[name]) for name in ("channel", "cause"))
        yield Gap(channel, first, last, duration_ns, cause, int(row["host_ns"]))


def _unrecorded_gaps(channel: str, jumps: list[_Jump], told: list[Gap]) -> Iterator[Gap]:
    """The parts of ``jumps`` that no gap in ``told`` covers."""
    named = sorted((gap.first, gap.last) for gap in told if gap.channel == channel)
    for jump in jumps:
        following = jump.first
        for first, last in [(a, b) for a, b in named if b >= jump.first and a <= jump.last] + [(jump.last + 1,) * 2]:
            if following < first:
                duration_ns = max(-_LONGEST_NS, min(_LONGEST_NS, jump.to_ns - jump.from_ns))
                yield Gap(channel, following, first - 1, duration_ns, LOST, jump.to_ns)
            following = max(following, last + 1)


def _account(reader: LogReader, untold: list[Gap]) -> Mapping[str, str]:
    return {
        "from": ", ".join(segment.name for segment in reader.segments),
        "damaged_places": str(len(reader.damage)),
        "rows_lost_to_damage": str(sum(gap.last - gap.first + 1 for gap in untold)),
    }
