"""Newest recorded row of each channel: written at a segment's head, and the starting point of a takeover."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from drivers import records
from drivers.records import Rows
from onboard.recording.format.segments import RECORDED, proven, without_crc
from onboard.recording.format.texts import printable

GAP_CHANNEL = "recorder_gap"
_BEYOND = 1 << 63


class ChannelProgress(NamedTuple):
    """Sequence and host time of a channel's newest row in the log, or of the newest reported as missing."""

    sequence: int
    host_ns: int


def marks_of(items: Mapping[str, str]) -> dict[str, ChannelProgress]:
    """Metadata ``recorded``; without channels whose mark is invalid; empty if its CRC fails."""
    marks = {}
    for name, text in without_crc(items).items() if proven(RECORDED, items) is not False else ():
        numbers = text.split()
        if len(numbers) == 2 and all(re.fullmatch(r"-?\d{1,19}", number) for number in numbers):
            mark = ChannelProgress(*map(int, numbers))
            if 0 <= mark.sequence < _BEYOND and abs(mark.host_ns) < _BEYOND:
                marks[name] = mark
    return marks


def note(recorded: dict[str, ChannelProgress], channel: str, rows: Rows) -> None:
    """Bring ``recorded`` up to date with ``rows`` (n,) of ``channel``; rows lost in the recorder (gaps) count too."""
    if not len(rows):
        return
    recorded[channel] = ChannelProgress(int(rows["sequence"][-1]), int(rows["host_ns"][-1]))
    if channel == GAP_CHANNEL and rows.dtype == records.GAP:
        for row in rows:
            name, last = printable(row["channel"]), int(row["last_missing"])
            if name not in recorded or recorded[name].sequence < last:
                recorded[name] = ChannelProgress(last, int(row["host_ns"]))
