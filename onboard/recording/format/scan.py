"""Scans a file sequentially for intact records and the damage between them.

The scan needs no summary and checks every length. After an invalid record it searches for the next valid one: a chunk
or attachment by its CRC, metadata by its lengths, the end by the footer.
"""

import errno
import os
import stat
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from onboard.recording.format import mcap_format
from onboard.recording.format.errors import ChecksumError, LogFormatError
from onboard.recording.format.mcap_format import MAGIC

_WINDOW = 1 << 16
_MOST_RECORD = 256 << 20  # bytes; the longest heft writes is an attached file
_MOST_METADATA = 10_000  # of a file, which has ten
_HEAD = mcap_format.RECORD_HEAD
_PROVABLE = np.array([Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END], np.uint8)

Content = (
    mcap_format.Header | mcap_format.Chunk | mcap_format.MessageIndex | mcap_format.Attachment | mcap_format.Metadata
)
_PARSERS: tuple[tuple[int, Callable[[bytes], Content]], ...] = (
    (Opcode.CHUNK, mcap_format.Chunk.parse),
    (Opcode.MESSAGE_INDEX, mcap_format.MessageIndex.parse),
    (Opcode.ATTACHMENT, mcap_format.Attachment.parse),
    (Opcode.METADATA, mcap_format.Metadata.parse),
)


class Damage(NamedTuple):
    """Bytes ``start`` to ``end`` (not included) of a file that are missing or damaged, with the reason."""

    start: int
    end: int
    reason: str
    file: str = ""  # name of the segment, in a log of several

    def __str__(self) -> str:
        where = f"{self.file}: " if self.file else ""
        if not self.end:
            return f"{where}{self.reason}"
        return f"{where}bytes {self.start} to {self.end}: {self.reason}"


class ScannedRecord(NamedTuple):
    """An intact record and its place in the file."""

    start: int
    end: int
    content: Content


class Scan:
    """One pass over a file. ``position``: bytes read; ``truncated``: the log was not closed.

    Args:
        path: file to read.
        start: offset of the first record to read; 0 begins with the magic.

    Raises:
        LogFormatError: not a regular file.
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path, start: int = 0) -> None:
        self._path = path
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise LogFormatError(f"{path} is no file, but a pipe, a device or a directory; give the path of a log")
        self.size = about.st_size
        self.position = start
        self._ended = False
        self._metadata = 0
        self._crc: int | None = None if start else 0  # of all bytes so far; None after a skipped byte
        with path.open("rb") as file:
            file.seek(max(0, self.size - mcap_format.FOOTER_BYTES))
            self._footer = mcap_format.Footer.at_end_of(file.read())
        self.truncated = self._footer is None

    def records(self) -> Iterator[ScannedRecord | Damage]:
        """Records and damage in the order of the file.

        Raises:
            LogFormatError: no MCAP magic at its start and no valid record in it.
            OSError: the file cannot be read.
        """
        with self._path.open("rb", buffering=1 << 18) as file:
            file.seek(self.position)
            if not self.position and (magic := self._read(file, len(MAGIC))) != MAGIC:
                yield self._not_magic(file, magic)
            while not self._ended:
                yield from self._next(file)
        self.position = self.size

    def _not_magic(self, file: BinaryIO, magic: bytes) -> Damage:
        if MAGIC.startswith(magic):
            return self._cut(0)
        damage = self._lost(file, 0, "the log does not begin with the magic of MCAP")
        if self._ended:
            raise LogFormatError(f"{self._path} is no heft log; give the path of an .mcap file that heft wrote")
        return damage

    def _read(self, file: BinaryIO, size: int) -> bytes:
        data = file.read(size)
        self.position += len(data)
        if self._crc is not None:
            self._crc = zlib.crc32(data, self._crc)
        return data

    def _next(self, file: BinaryIO) -> Iterator[ScannedRecord | Damage]:
        start, crc = self.position, self._crc
        head = self._read(file, _HEAD.size)
        if len(head) < _HEAD.size:
            yield self._cut(start)
            return
        opcode, length = _HEAD.unpack(head)
        self._metadata += opcode == Opcode.METADATA
        if length > self.size - self.position:
            yield self._lost(file, start, "a record is longer than the rest of the log")
        elif length > _MOST_RECORD:
            yield self._lost(file, start, f"a record has {length} bytes, more than heft writes")
        elif self._metadata > _MOST_METADATA:
            self._ended = True
            yield Damage(start, self.size, f"more than {_MOST_METADATA} metadata records: the rest is not read")
        elif opcode == Opcode.DATA_END and length == 4:
            yield from self._end(file, start, crc)
        else:
            try:
                content = _parse(opcode, self._read(file, length), start)
            except ChecksumError as error:
                yield Damage(start, self.position, str(error))
            except LogFormatError as error:
                yield self._lost(file, start, str(error))
            else:
                yield ScannedRecord(start, self.position, content)

    def _cut(self, start: int) -> Damage:
        self._ended = True
        if not self.size:
            return Damage(0, 0, "the log is empty: no byte was written, or it was cut to nothing")
        where = "inside a record" if start < self.size else "after a whole record"
        return Damage(start, self.size, f"the log ends {where}: it was not closed")

    def _end(self, file: BinaryIO, start: int, crc: int | None) -> Iterator[Damage]:
        """Check the data section's CRC and the summary, the rest of the file."""
        self._ended = True
        stored = int.from_bytes(self._read(file, 4), "little")
        if crc is not None and stored != crc:
            yield Damage(0, start, "the CRC of the whole does not match: a byte between the chunks is altered")
        summary, self._crc = self.position, 0
        checked = self.size - len(MAGIC) - 4
        while self.position < checked:
            if not self._read(file, min(_WINDOW, checked - self.position)):
                break
        if self._footer is None or self._footer.summary_start != summary or self._footer.summary_crc != self._crc:
            yield Damage(summary, self.size, "the summary is damaged or incomplete")

    def _lost(self, file: BinaryIO, start: int, reason: str) -> Damage:
        """Continue at the next valid record."""
        found = self._find(file, start + 1)
        self._crc = None
        if found is None:
            self._ended = True
            return self._cut(start) if self.truncated else Damage(start, self.size, reason)
        file.seek(found)
        self.position = found
        return Damage(start, found, reason)

    def _find(self, file: BinaryIO, start: int) -> int | None:
        """Offset of the first valid record at or after ``start``."""
        overlap = _HEAD.size - 1
        base = start
        with self._path.open("rb", buffering=0) as holes:
            while base < self.size:
                try:
                    base = os.lseek(holes.fileno(), base, os.SEEK_DATA)  # a record begins in no hole of a file
                except OSError as error:
                    if error.errno == errno.ENXIO:
                        return None
                    raise
                file.seek(base)
                block = np.frombuffer(file.read(_WINDOW + overlap), np.uint8)
                count = len(block) - overlap
                if count <= 0:
                    return None
                high = block[5 : count + 5] | block[6 : count + 6] | block[7 : count + 7] | block[8 : count + 8]
                for hit in np.flatnonzero(np.isin(block[:count], _PROVABLE) & (high == 0)):
                    if self._proves_itself(file, base + int(hit)):
                        return base + int(hit)
                base += _WINDOW
        return None

    def _proves_itself(self, file: BinaryIO, start: int) -> bool:
        file.seek(start)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        body_at = start + _HEAD.size
        if opcode == Opcode.DATA_END:
            return self._footer is not None and self._footer.summary_start == body_at + 4 and length == 4
        if length > min(self.size - body_at, _MOST_RECORD):
            return False
        if opcode == Opcode.CHUNK and not mcap_format.Chunk.plausible(file.read(mcap_format.CHUNK_HEAD_BYTES), length):
            return False
        file.seek(body_at)
        try:
            content = _parse(opcode, file.read(length), start)
        except LogFormatError:
            return False
        return not isinstance(content, mcap_format.Metadata) or bool(content.name and content.items)


def _parse(opcode: int, body: bytes, start: int) -> Content:
    """The content of a record of the data section."""
    if opcode == Opcode.HEADER and start == len(MAGIC):
        return mcap_format.Header.parse(body)
    for known, parse in _PARSERS:
        if opcode == known:
            return parse(body)
    raise LogFormatError(f"a record of type {opcode} has no place there")
