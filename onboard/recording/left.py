"""What segments of a log hold, for a recorder that goes on after them."""

import json
from pathlib import Path
from typing import NamedTuple, Self

from onboard.recording.format.decode import Decoder, MessageRun, rows_of
from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.mcap_format import Chunk
from onboard.recording.format.scan import Damage, Scan
from onboard.recording.format.segments import RECORDED, read_head, segment_path
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress, marks_of, note
from onboard.recording.writer import HEADER


class Progress(NamedTuple):
    """How far a log is written: what a recorder leaves to the next one, so that this one need not read the log.

    The last recorded row of each channel at ``offset`` of segment ``number``, whose file's name has number ``place``.
    """

    number: int
    place: int
    offset: int
    recorded: dict[str, ChannelProgress]

    def to_bytes(self) -> bytes:
        """As JSON."""
        return json.dumps(self).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self | None:
        """What :meth:`to_bytes` gave; None where it is none."""
        try:
            number, place, offset, recorded = json.loads(data)
            marks = {str(k): ChannelProgress(*map(int, v)) for k, v in recorded.items()}
            return cls(int(number), int(place), int(offset), marks)
        except (ValueError, TypeError, AttributeError):
            return None


def recorded_at_end(found: list[Path]) -> dict[str, ChannelProgress]:
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


def may_have_messages(segment: Path) -> bool:
    """False for a segment opened ahead, with a whole or torn head."""
    try:
        return any(True for _ in LogReader([segment]).batches())
    except LogFormatError:
        return True


def may_be_of(path: Path, flight: str) -> bool:
    """Whether the file at ``path`` is a segment of ``flight``, as far as its head can be read."""
    try:
        head = read_head(path)
    except (LogFormatError, OSError):
        return False
    return head.flight == flight or head.is_altered


def is_torn(path: Path) -> bool:
    """Whether the file at ``path`` is a head torn before it said of which flight; a loss of power may leave zeros."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        begins = file.read(len(HEADER))
    if path.stat().st_size <= len(HEADER):
        return HEADER.startswith(begins) or not any(begins)
    return begins == HEADER and not read_head(path).segment and Scan(path).truncated and not may_have_messages(path)


def recorded_since(log: Path, progress: Progress, flight: str) -> dict[str, ChannelProgress] | None:
    """Last recorded row of each channel, by ``progress`` and the rows after it; None where they do not fit."""
    path, ahead, further = (segment_path(log, progress.place + n) for n in range(3))
    if further.exists() or not path.exists() or path.stat().st_size < progress.offset:
        return None
    if ahead.exists() and not is_torn(ahead) and (may_have_messages(ahead) or not may_be_of(ahead, flight)):
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
