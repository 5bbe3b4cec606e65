"""Ends a log whose writer died: what is torn at its end is cut off, and the summary is made that the writer could not.

Nothing that can be read is touched. A log that is damaged anywhere else is left as it is, for ``recover``.
"""

import os
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from onboard.recording import mcap_format
from onboard.recording.decode import Decoder
from onboard.recording.errors import LogFormatError
from onboard.recording.mcap_format import Attachment, Chunk, MessageIndex, Metadata
from onboard.recording.scan import Damage, Found, Scan
from onboard.recording.summary import SummarySection


class Sealed(NamedTuple):
    """How it went: whether there were messages, and whether the log is whole now."""

    used: bool
    whole: bool


class _Placed(NamedTuple):
    """A chunk, where it stands, and the place of each channel's message index behind it."""

    found: Found
    chunk: Chunk
    indexes: dict[int, int]
    end: int


class _Survey:
    """What a pass over the log has found."""

    def __init__(self) -> None:
        self.summary = SummarySection()
        self._decoder = Decoder()
        self._last: _Placed | None = None
        self.end = len(mcap_format.MAGIC)

    def add(self, found: Found) -> None:
        content = found.content
        if isinstance(content, MessageIndex) and self._last is not None:
            self._last.indexes[content.channel] = found.start
            self._last = self._last._replace(end=found.end)
        else:
            self._finish_chunk()
        if isinstance(content, Chunk):
            for run in self._decoder.runs(content.records):
                self.summary.define(self._decoder.definitions)
                self.summary.counts[run.channel.number] += len(run.records)
            self._last = _Placed(found, content, {}, found.end)
        elif isinstance(content, Attachment):
            self.summary.add_attachment(content, found.start, found.end - found.start)
        elif isinstance(content, Metadata):
            self.summary.add_metadata(content, found.start, found.end - found.start)
        self.end = found.end

    def _finish_chunk(self) -> None:
        if self._last is not None:
            found, chunk, indexes, end = self._last
            self.summary.add_chunk(chunk, found.start, found.end - found.start, indexes, end - found.end)
            self._last = None

    def finish(self) -> tuple[int, bytes]:
        """Where the log is to be cut off, and the last chunk's message index, which may have been torn, anew."""
        self.summary.define(self._decoder.definitions)
        if self._last is None:
            return self.end, b""
        found, chunk, _, _ = self._last
        packed = _message_indexes(chunk)
        at = found.end
        for channel, index in packed.items():
            self._last.indexes[channel] = at
            at += len(index)
        self._last = self._last._replace(end=at)
        self._finish_chunk()
        return found.end, b"".join(packed.values())


def _message_indexes(chunk: Chunk) -> dict[int, bytes]:
    """The message index records of a chunk that decodes, by channel."""
    places: dict[int, list[tuple[int, int]]] = {}
    at = 0
    while at < len(chunk.records):
        opcode, length = mcap_format.RECORD_HEAD.unpack_from(chunk.records, at)
        if opcode == Opcode.MESSAGE:
            _, _, channel, _, log_time, _ = mcap_format.MESSAGE_HEAD.unpack_from(chunk.records, at)
            places.setdefault(channel, []).append((log_time, at))
        at += mcap_format.RECORD_HEAD.size + length
    return {
        channel: mcap_format.pack_message_index(channel, *np.array(placed, np.uint64).T)
        for channel, placed in sorted(places.items())
    }


def seal(path: Path) -> Sealed:
    """Make a whole log of the file at ``path``, which nobody is writing, if its end is all that is amiss.

    Raises:
        OSError: the medium refused.
    """
    survey = _Survey()
    scan = Scan(path)
    damage: list[Damage] = []
    try:
        for record in scan.records():
            if isinstance(record, Damage):
                damage.append(record)
            else:
                survey.add(record)
    except LogFormatError as error:
        damage.append(Damage(0, scan.size, str(error)))
    used = any(survey.summary.counts.values())
    ends = survey.end, survey.end + mcap_format.DATA_END_BYTES  # the summary may be what is torn
    torn = len(damage) == 1 and scan.truncated and damage[0].end == scan.size and damage[0].start in ends
    if damage and not torn:
        return Sealed(used, whole=False)
    if damage:
        _write_end(path, *survey.finish(), survey.summary)
    return Sealed(used, whole=True)


def _write_end(path: Path, end: int, indexes: bytes, summary: SummarySection) -> None:
    with path.open("r+b") as file:
        crc, left = 0, end
        while left and (block := file.read(min(left, 1 << 20))):
            crc, left = zlib.crc32(block, crc), left - len(block)
        file.write(indexes + summary.pack_end(end + len(indexes), zlib.crc32(indexes, crc)))
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
