"""Finds the files of a flight's log: one file, or numbered segments.

``x.mcap`` continues in ``x_001.mcap``, ``x_002.mcap`` beside it; a log named without the suffix is a directory:
``x/x_000.mcap``, ``x/x_001.mcap``. Every segment is a complete MCAP file. Metadata ``segment`` has the flight's id, so
that a file of a similar name is not taken for a segment.
"""

import glob
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from onboard.recording.errors import LogFormatError
from onboard.recording.mcap_format import Chunk, Header, Metadata
from onboard.recording.scan import Damage, Scan

SUFFIX = ".mcap"
METADATA = "segment"
_NUMBERED = re.compile(r"(?P<stem>.+)_(?P<number>\d{3,})")


class Head(NamedTuple):
    """Metadata at the head of a file, before its first messages."""

    library: str
    segment: dict[str, str]  # metadata of that name; empty in a log without segments

    @property
    def flight(self) -> str:
        """Id of its flight; empty if not given."""
        return self.segment.get("flight", "")


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


def read_head(path: Path) -> Head:
    """The head of the file at ``path``, as far as it can be read.

    Raises:
        LogFormatError: it does not begin like a log, and nothing in it proves to be of one.
        OSError: it cannot be read.
    """
    head = EMPTY
    for record in Scan(path).records():
        if isinstance(record, Damage):
            continue
        if isinstance(record.content, Header):
            head = head._replace(library=record.content.library)
        elif isinstance(record.content, Metadata) and record.content.name == METADATA:
            return head._replace(segment=record.content.items)
        elif isinstance(record.content, Chunk):
            break
    return head


def _flight_or_none(path: Path) -> str:
    try:
        return read_head(path).flight
    except LogFormatError:
        return ""


def segments(log: Path) -> tuple[Path, ...]:
    """The existing segments of ``log``, in order.

    Args:
        log: a flight directory, a segment in one, or a file, which is given with those that continue it.

    Raises:
        FileNotFoundError: no such log.
        LogFormatError: a directory that is not one flight.
        OSError: it cannot be read.
    """
    if log.is_dir():
        log = log.resolve()
        found = [path for path in log.glob(f"*{SUFFIX}") if path.stem.startswith(f"{log.name}_")]
        found = [path for path in found if _NUMBERED.fullmatch(path.stem)]
        if not found:
            raise LogFormatError(f"{log} is not the directory of one flight; name a flight or a log in it")
        return tuple(sorted(found, key=number_of))
    further = [path for path in log.parent.glob(f"{glob.escape(log.stem)}_*{SUFFIX}") if _continues(path, log)]
    if further:
        flight = read_head(log).flight
        further = [path for path in further if flight and _flight_or_none(path) == flight]
    return (log, *sorted(further, key=number_of))


def _continues(path: Path, log: Path) -> bool:
    numbered = _NUMBERED.fullmatch(path.stem)
    return numbered is not None and numbered["stem"] == log.stem


def flights(paths: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Segments, flight directories and one-file logs as a command line gives them, grouped by flight, each in order.

    Raises:
        LogFormatError: as ``segments``.
        OSError: as ``segments``.
    """
    groups: dict[str, dict[Path, None]] = {}
    for path in paths:
        found = segments(path)
        groups.setdefault(_flight_or_none(found[0]) or str(path), {}).update(dict.fromkeys(found))
    return [tuple(sorted(group, key=number_of)) for group in groups.values()]
