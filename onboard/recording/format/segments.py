"""Finds the files of a flight's log: one file, or numbered segments.

``x.mcap`` continues in ``x_001.mcap``, ``x_002.mcap`` beside it; a log named without the suffix is a directory:
``x/x_000.mcap``, ``x/x_001.mcap``. Every segment is a whole MCAP file that can be read alone. Metadata ``segment`` says
which flight it belongs to, and its number, with a CRC: a neighbour of a like name is never taken for a part, and a part
whose head is damaged never for a neighbour.
"""

import glob
import json
import os
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.mcap_format import LIBRARY, Chunk, Header, Metadata
from onboard.recording.format.scan import Damage, Scan

SUFFIX = ".mcap"
METADATA = "segment"
RECORDED = "recorded"  # newest row of each channel at a segment's head
END = "flight_end"  # in the last segment of a flight that was closed: number of segments
_CRC = "#crc"
_MOST_NAMED = 1000  # missing segments
_NUMBERED = re.compile(r"(?P<stem>.+)_(?P<number>\d{3,9})", re.DOTALL)  # a name may hold a line end


def with_crc(name: str, items: Mapping[str, str]) -> dict[str, str]:
    """``items`` of metadata ``name``, and a CRC over both: MCAP has none for metadata."""
    return {**items, _CRC: _crc(name, items)}


def proven(name: str, items: Mapping[str, str]) -> bool | None:
    """Whether the CRC of metadata is right; None without a CRC."""
    return None if _CRC not in items else items[_CRC] == _crc(name, without_crc(items))


def written_as(name: str, items: Mapping[str, str]) -> str:
    """The name under which metadata was written: what its CRC proves, where ``name`` itself is altered."""
    return next((one for one in (METADATA, RECORDED, END) if one != name and proven(one, items)), name)


def without_crc(items: Mapping[str, str]) -> dict[str, str]:
    """Metadata without its CRC."""
    return {key: value for key, value in items.items() if key != _CRC}


def _crc(name: str, items: Mapping[str, str]) -> str:
    return f"{zlib.crc32(json.dumps([name, *items.items()]).encode()):08x}"


class Head(NamedTuple):
    """Metadata at the head of a file, before its first messages."""

    library: str
    segment: dict[str, str]  # metadata of that name; empty in a log without segments
    is_proven: bool | None = None  # see ``proven``
    is_damaged: bool = False

    @property
    def flight(self) -> str:
        """Identifier of its flight; empty where absent."""
        return "" if self.is_proven is False else self.segment.get("flight", "")

    @property
    def is_altered(self) -> bool:
        """Whether a flight's name may have stood there and is lost."""
        return self.is_damaged or self.is_proven is False

    @property
    def number(self) -> int | None:
        """Number of the segment; None where it is uncertain."""
        number = self.segment.get("number", "") if self.is_proven else ""
        return int(number) if number.isdecimal() and len(number) < 10 else None


EMPTY = Head("", {})


def segment_path(log: Path, number: int) -> Path:
    """Path of segment ``number`` of ``log``."""
    if log.suffix != SUFFIX:
        return log / f"{log.name}_{number:03d}{SUFFIX}"
    return log.with_stem(f"{log.stem}_{number:03d}") if number else log


def number_of(segment: Path) -> int:
    """Number in a segment's name; 0 for ``x.mcap``."""
    numbered = _NUMBERED.fullmatch(segment.stem)
    return int(numbered["number"]) if numbered else 0


def free_place(log: Path, place: int) -> int:
    """The first number from ``place`` on that no file beside has in its name, nor a link to nothing."""
    while os.path.lexists(segment_path(log, place)):
        place += 1
    return place


def continuing(log: Path) -> Path | None:
    """A file whose name is that of a later segment of the log ``log``, whatever it is; None where there is none."""
    if log.suffix != SUFFIX:
        return None
    beside = log.parent.glob(f"{glob.escape(log.stem)}_*{SUFFIX}")
    return min((path for path in beside if _continues(path, log.stem)), default=None)


def ordinal(segment: Path) -> int:
    """Number of a segment by its metadata, else by its name; 0 for a log without segments."""
    head = _head(segment)
    if head.number is not None:
        return head.number
    return number_of(segment) if head.segment or head.is_altered else 0


def is_part(segment: Path) -> bool:
    """Whether the file is not the first of its log."""
    return ordinal(segment) > 0


class Beside(NamedTuple):
    """Segments of the flight that a file is a part of."""

    others: tuple[Path, ...]
    missing: tuple[int, ...]  # numbers; those after the last that is there are not known


def beside(part: Path) -> Beside:
    """The other segments of the flight that the log ``part`` is a segment of, and those missing (1000 at most).

    Raises:
        OSError: the directory cannot be read.
    """
    numbered = _NUMBERED.fullmatch(part.stem)
    if numbered is None or not is_part(part):
        return Beside((), ())
    log = part.with_stem(numbered["stem"])
    if not log.exists() and part.parent.resolve().name == numbered["stem"]:
        log = part.parent
    others = {path.name: ordinal(path) for path in segments(log) if path.exists() and path.name != part.name}
    numbers = {ordinal(part), *others.values()}
    missing = sorted(set(range(max(numbers))) - numbers)
    return Beside(tuple(part.with_name(name) for name in others), tuple(missing[:_MOST_NAMED]))


def read_head(path: Path) -> Head:
    """The head of the file at ``path``, as far as it can be read.

    Raises:
        LogFormatError: it does not begin like a log, and nothing in it proves to be of one.
        OSError: it cannot be read.
    """
    head = EMPTY
    for record in Scan(path).records():
        if isinstance(record, Damage):
            head = head._replace(is_damaged=True)
        elif isinstance(record.content, Header):
            head = head._replace(library=record.content.library)
        elif isinstance(record.content, Metadata) and written_as(*record.content) == METADATA:
            items = record.content.items
            return head._replace(segment=without_crc(items), is_proven=proven(METADATA, items))
        elif isinstance(record.content, Chunk):
            break
    return head


def _head(path: Path) -> Head:
    """As ``read_head``; a damaged head for an unreadable file."""
    try:
        return read_head(path)
    except (LogFormatError, OSError):
        return Head("", {}, is_damaged=True)


def flight_or_none(path: Path) -> str:
    """Identifier of the flight in the head of ``path``; empty where absent."""
    return _head(path).flight


def _is_whole(path: Path) -> bool:
    try:
        return not any(isinstance(record, Damage) for record in Scan(path).records())
    except (LogFormatError, OSError):
        return False


def segments(log: Path) -> tuple[Path, ...]:
    """The existing segments of ``log``, in order; unreadable ones are placed by file name.

    Args:
        log: a flight directory, a segment in one, or a file, which is given with those that continue it. The first may
            be missing.

    Raises:
        FileNotFoundError: no such log.
        LogFormatError: a directory that is not one flight.
        OSError: it cannot be read.
    """
    if log.is_dir():
        log = log.resolve()
        heads = {path: _head(path) for path in log.glob(f"*{SUFFIX}") if _continues(path, log.name)}
        if not heads:
            raise LogFormatError(f"{log} is not the directory of a flight; name a flight or a log in it")
        flight = _most_common(heads)
        return _of_flight(flight, heads) if flight else _in_order(heads, heads)
    beside = log.parent.glob(f"{glob.escape(log.stem)}_*{SUFFIX}")
    heads = {path: _head(path) for path in beside if _continues(path, log.stem)}
    if not heads:
        return (log,)
    if log.exists():
        heads[log] = _head(log)
        flight = heads[log].flight
        if not flight and heads[log].is_altered:
            flight = _most_common(heads)
    else:
        flight = _most_common(heads)
    if not flight:
        return (log,)  # of a missing log: opening it reports that
    found = _of_flight(flight, heads)
    return found if log in found or not log.exists() else (log, *found)


def _most_common(heads: Mapping[Path, Head]) -> str:
    counted = Counter(head.flight for head in heads.values() if head.flight)
    return counted.most_common(1)[0][0] if counted else ""


def _of_flight(flight: str, heads: Mapping[Path, Head]) -> tuple[Path, ...]:
    """Segments of a flight, and damaged files whose names continue it without a gap."""
    ours = [path for path, head in heads.items() if head.flight == flight]
    last = max((number_of(path) for path in ours), default=-1)
    for path in sorted(heads.keys() - set(ours), key=number_of):
        if number_of(path) <= last + 1 and _is_damaged_part(path, heads[path]):
            ours.append(path)
            last = max(last, number_of(path))
    return _in_order(ours, heads)


def _is_damaged_part(path: Path, head: Head) -> bool:
    """Whether a file with a continuing name, but without the flight's identifier, may belong to the flight."""
    if head.is_proven is not None:
        return not head.is_proven
    if head.library not in ("", LIBRARY):
        return False
    return not _is_whole(path) if head.segment else head.is_damaged


def _in_order(paths: Iterable[Path], heads: Mapping[Path, Head]) -> tuple[Path, ...]:
    """Sorted by number in the metadata, else in the file name; duplicates are left out."""
    found: dict[int, Path] = {}
    unsaid: list[Path] = []
    for path in sorted(paths, key=number_of):
        number = heads[path].number
        if number is None:
            unsaid.append(path)
        elif number not in found or number_of(path) == number:
            found[number] = path
    numbered = [*found.items(), *((number_of(path), path) for path in unsaid)]
    return tuple(path for _, path in sorted(numbered))


def _continues(path: Path, stem: str) -> bool:
    numbered = _NUMBERED.fullmatch(path.stem)
    return numbered is not None and numbered["stem"] == stem


def flights(paths: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Segments, flight directories and one-file logs as a command line gives them, grouped by flight, each in order.

    Raises:
        LogFormatError: as ``segments``.
        OSError: as ``segments``.
    """
    groups: dict[str, dict[Path, None]] = {}
    for path in paths:
        found = segments(path)
        flight = next((flight for one in found if (flight := flight_or_none(one))), "")
        groups.setdefault(flight or str(path), {}).update(dict.fromkeys(found))
    return [tuple(sorted(group, key=number_of)) for group in groups.values()]


def logs(paths: list[Path]) -> list[Path | tuple[Path, ...]]:
    """As ``flights``; a flight that one path names is that path, so that a reader knows which segments it must have."""
    groups = flights(paths)
    return list(paths) if len(groups) == len(paths) else list(groups)
