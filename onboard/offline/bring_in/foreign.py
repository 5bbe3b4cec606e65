"""Reads columns of foreign files (CSV with a header line, NumPy's NPZ); a whole file is held in memory."""

import csv
import json
import os
import re
import stat
from collections import deque
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as Columns
from itertools import islice
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from onboard.npz import NpzError, arrays_of
from onboard.offline.bring_in.errors import SourceError
from onboard.offline.bring_in.mapping import Csv

Values = NDArray[np.generic]
LARGEST_BYTES = 2 << 30  # of the arrays of one file
_LONGEST_LINE = 1 << 20  # characters of a CSV
_BLOCK = 1 << 20  # cells of a CSV that are text at a time
_MOST_NAMED, _LONGEST_NAME = 20, 80  # columns in a message, characters of one


def read_npz(path: Path) -> Columns[str, Values]:
    """The arrays of an NPZ file, by name.

    Raises:
        SourceError: not an NPZ file, or one with pickled objects.
        OSError: the file cannot be read.
    """
    try:
        return arrays_of(path, LARGEST_BYTES)
    except NpzError as error:
        raise SourceError(str(error)) from error


class Recording(NamedTuple):
    """A file that has been read."""

    columns: Columns[str, Values]
    truncated: str = ""  # what of it was left out, as its end is missing; empty if nothing


def read_csv(path: Path, layout: Csv) -> Recording:
    """The columns of a CSV file, by name: integers if every cell is one, else floats.

    A last row that has fewer cells than the header, or that ends, without a newline, in a cell that is no number where
    the row before has one, was cut off: it is left out.

    Raises:
        SourceError: a line with another number of cells than the header.
        OSError: the file cannot be read.
    """
    columns: list[list[Values]] = []  # by name, in blocks
    rows: list[list[str]] = []  # not in blocks yet
    count = 0  # of those that are

    def pack(last: int) -> None:
        """Put all ``rows`` but the ``last`` into blocks."""
        nonlocal count
        some, rows[:] = rows[: len(rows) - last], rows[len(rows) - last :]
        for number, row in enumerate(some, count + 1):
            if len(row) != len(names):
                found = f"{len(row)} cells where the header names {len(names)}"
                raise SourceError(f"{path}: row {number} has {found}; {_separated(names)}")
        if 8 * (count + len(some)) * len(names) > LARGEST_BYTES:
            raise SourceError(f"{path} has more numbers than {LARGEST_BYTES / 1e9:.1f} GB hold: divide it")
        for blocks, cells in zip(columns, zip(*some, strict=True), strict=bool(some)):
            blocks.append(_numbers(cells, layout.decimal, count))
        count += len(some)

    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            text = _lines(path, file)
            deque(islice(text, layout.header_line - 1), maxlen=0)  # passed over
            lines = csv.reader(text, delimiter=layout.delimiter)
            names = [name.strip() for name in next(lines, [])]
            columns += [[] for _ in names]
            for line in lines:
                if line:
                    rows.append(line)
                if len(rows) * len(names) > _BLOCK and len(rows) > 2:  # the last two tell whether it is cut off
                    pack(2)
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path} is not CSV text ({error}); check the mapping's format") from error
    cut = len(rows) > 1 and (
        len(rows[-1]) < len(names) or (_is_cut(rows, layout.decimal) and not _ends_with_a_newline(path))
    )
    truncated = f"row {count + len(rows)}, the last one, is cut off: left out" if cut else ""
    if cut:
        rows.pop()
    pack(0)
    return Recording({name: _joined(blocks) for name, blocks in zip(names, columns, strict=True)}, truncated)


def _lines(path: Path, file: TextIO) -> Iterator[str]:
    while line := file.readline(_LONGEST_LINE + 1):
        if len(line) > _LONGEST_LINE:
            raise SourceError(f"{path} has a line of more than {_LONGEST_LINE} characters; give a CSV file")
        yield line


def _joined(blocks: list[Values]) -> Values:
    """The numbers of a column; the reason where one of its blocks has one."""
    for block in blocks:
        if block.dtype.kind == "U":
            return np.broadcast_to(block[0], sum(map(len, blocks)))
    return np.concatenate(blocks) if blocks else np.zeros(0, np.int64)


def _ends_with_a_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 1))
        return file.read(1) in (b"\n", b"\r", b"")


def _is_cut(cells: list[list[str]], decimal: str) -> bool:
    """Whether the last cell of the last row is no number, and that of the row before is one."""

    def number(cell: str) -> bool:
        try:
            float(cell.replace(decimal, "."))
        except ValueError:
            return False
        return True

    return len(cells[-2]) == len(cells[-1]) and number(cells[-2][-1]) and not number(cells[-1][-1])


def _separated(names: list[str]) -> str:
    """What to do about a header of one name that holds another separator."""
    for other in ";\t" if len(names) == 1 else "":
        if other in names[0]:
            return f"they seem to be separated by {other!r}: write delimiter = {json.dumps(other)} into [csv]"
    return "check delimiter and header_line of [csv]"


def _numbers(cells: Sequence[str], decimal: str, before: int) -> Values:
    """Numbers of a column from row ``before`` on; in every place the reason if one is none: an error if it is used."""
    text = np.array(cells, dtype=str)
    text = text if decimal == "." else np.char.replace(text, decimal, ".")
    for kind in (np.int64, np.float64):
        try:
            return text.astype(kind)
        except (ValueError, OverflowError):
            continue
    return np.broadcast_to(np.array(_no_number(text.tolist(), before)), len(cells))


def _no_number(cells: list[str], before: int) -> str:
    """``row 3 has '0,25', with a decimal comma: ...``: the first cell that is no number, and the remedy."""
    for row, cell in enumerate(cells, before + 1):
        try:
            float(cell)
        except ValueError:
            shown = repr(cell[:_LONGEST_NAME])
            if re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell):
                return f'row {row} has {shown}, with a decimal comma: write decimal = "," into [csv] of the mapping'
            return f"row {row} has {shown}, which is no number: correct it, or the mapping"
    return "its numbers are too large: correct them, or the mapping"


def read(path: Path, layout: Csv, kind: str) -> Recording:
    """The columns of a file of ``kind`` (csv or npz); see ``read_csv`` and ``read_npz``.

    Raises:
        SourceError: as these; a pipe or a device, which may never end; more than a recording holds.
        OSError: as these.
    """
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise SourceError(f"{path} is no file, but a pipe, a device or a directory; give the path of a recording")
    if about.st_size > LARGEST_BYTES:
        limit = f"{LARGEST_BYTES / 1e9:.1f} GB"
        raise SourceError(f"{path} has {about.st_size / 1e9:.3g} GB; the limit is {limit}: divide it")
    return read_csv(path, layout) if kind == "csv" else Recording(read_npz(path))


def _found(columns: Columns[str, Values], name: str) -> Values | None:
    """A column by its name, or ``NAME[k]``, column k of an array (n, columns); None where there is none."""
    if name in columns:
        return columns[name]
    indexed = re.fullmatch(r"(.+)\[(\d+)\]", name)
    if indexed is None or indexed[1] not in columns:
        return None
    array, k = columns[indexed[1]], int(indexed[2])
    return array[:, k] if array.ndim == 2 and k < array.shape[1] else None


def length(columns: Columns[str, Values], name: str) -> int:
    """Rows of a column; 0 where there is none of that name."""
    found = _found(columns, name)
    return 0 if found is None else len(found)


def numbers(path: Path, columns: Columns[str, Values], name: str, width: int | None = None) -> Values:
    """Column ``name`` (n,), or (n, width), of a file that has been read; ``NAME[k]`` is column k of an array.

    Raises:
        SourceError: no such column, or not numbers of that shape.
    """
    values = _found(columns, name)
    if values is None:
        listed = ", ".join(repr(one)[:_LONGEST_NAME] for one in list(columns)[:_MOST_NAMED])
        more = f" and {len(columns) - _MOST_NAMED} more" if len(columns) > _MOST_NAMED else ""
        raise SourceError(f"{path} has no column {name!r}; it has {listed}{more}")
    if values.dtype.kind not in "iuf":
        told = str(values.flat[0]) if values.size and values.strides == (0,) else ""  # of a CSV column: see _numbers
        wrong = f": {told}" if told else " holds cells that are not numbers; correct them or the mapping"
        raise SourceError(f"{path}: column {name!r}{wrong}")
    if values.ndim != (1 if width is None else 2) or (width is not None and values.shape[1] != width):
        wanted = "one value" if width is None else f"{width} values"
        raise SourceError(f"{path}: column {name!r} has shape {values.shape}; the mapping needs {wanted} a row")
    return values
