"""Completes a log whose writer died: removes a partial record at its end and writes the summary.

Readable data are not changed. A log damaged elsewhere is left unchanged, for ``recover``.
"""

import os
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from onboard.recording.format import mcap_format
from onboard.recording.format.decode import Decoder
from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.mcap_format import Attachment, Chunk, MessageIndex, Metadata
from onboard.recording.format.scan import Damage, Scan, ScannedRecord
from onboard.recording.format.summary import SummarySection


class Sealed(NamedTuple):
    """Result: whether there were messages, and whether the log is intact now."""

    used: bool
    whole: bool


class _Placed(NamedTuple):
    """A chunk, its place, and the places of the message indexes after it."""

    found: ScannedRecord
    chunk: Chunk
    indexes: dict[int, int]
    end: int


class _Survey:
    """Result of a pass over the log."""

    def __init__(self) -> None:
        self.summary = SummarySection()
        self._decoder = Decoder()
        self._last: _Placed | None = None
        self.end = len(mcap_format.MAGIC)

    def add(self, found: ScannedRecord) -> None:
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
        """Offset at which to truncate the log, and the rebuilt message index of the last chunk."""
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
    """Complete the log at ``path`` (without a writer) if only its end is missing.

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
    ends = survey.end, survey.end + mcap_format.DATA_END_BYTES  # the summary may be the partial record
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
