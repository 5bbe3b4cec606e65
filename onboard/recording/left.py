"""What segments of a log hold, for a recorder that goes on after them."""

from pathlib import Path

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.segments import RECORDED
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress, marks_of, note


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
