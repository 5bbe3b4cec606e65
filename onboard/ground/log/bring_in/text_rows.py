"""Reads text of rows and columns: CSV, semicolons, tabs or blanks; with names or without; comments; bad rows."""

import csv
import json
import os
import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Mapping as Columns
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.mapping import Csv

Values = NDArray[np.generic]
LARGEST_BYTES = 2 << 30  # of the arrays of one file
_LONGEST_LINE = 1 << 20  # characters of a CSV
_BLOCK = 1 << 20  # cells of a CSV that are text at a time
_SKIP = 'bad_rows = "skip" in [mapping] leaves such rows out'
_LOOKED_AT = 200  # rows, for a list
_LONGEST_LIST = 16  # lines that brackets hold together: in so many NumPy prints a hundred numbers
_LONGEST_CELL = 80  # characters of one in a message
_ARRAY = re.compile(r"\s*(?:np\.|numpy\.)?array\((.*?)(?:,\s*dtype=[\w.]+)?\)\s*", re.DOTALL)
_BRACKET = re.compile(r"[\[(][\s\[(]*[-+]?\.?\d")  # where a list of numbers begins; no unit in a header does so
_MASK = "\0"  # between numbers of a list, so that nothing there separates cells
_BETWEEN = re.compile(r"[\s,;\0\[\]()]+")
_CLOCK = re.compile(r"(\d{4}-\d\d-\d\d[T ])?\d{1,2}:\d\d(:\d\d(\.\d{1,9})?)?Z?")


class Recording(NamedTuple):
    """A file that has been read."""

    columns: Columns[str, Values]
    truncated: str = ""  # what of it was left out, as its end is missing; empty if nothing
    ragged: int = 0  # rows left out, since they have another number of cells


def read_csv(path: Path, layout: Csv, *, skip: bool = False, most_rows: int | None = None) -> Recording:
    """The columns of a CSV file, by name, or by number from 1: integers if every cell is one, else floats.

    Cells such as ``[0.1, 0.2, 0.3]`` or ``(0.1 0.2)``, all of one length, make an array (rows, length).

    A last row that has fewer cells than the header, or that ends, without a newline, in a cell that is no number where
    the row before has one, was cut off: it is left out. Names that stand more than once are distinguished by `` (1)``.

    Args:
        path: of the file.
        layout: of the text.
        skip: rows with another number of cells are left out and counted, cells that are no numbers are NaN.
        most_rows: further ones are not read.

    Raises:
        SourceError: a line with another number of cells than the header.
        OSError: the file cannot be read.
    """
    columns: list[list[Values]] = []  # by name, in blocks
    rows: list[list[str]] = []  # not in blocks yet
    count = ragged = 0  # rows in blocks; rows left out

    def pack(last: int) -> None:
        """Put all ``rows`` but the ``last`` into blocks."""
        nonlocal count, ragged
        some, rows[:] = rows[: len(rows) - last], rows[len(rows) - last :]
        if skip:
            whole = [row for row in some if len(row) == len(names)]
            some, ragged = whole, ragged + len(some) - len(whole)
        for place, row in enumerate(some, count + 1):
            if len(row) != len(names):
                found = f"{len(row)} cells where the header names {len(names)}"
                raise SourceError(f"{path}: row {place} has {found}; {_separated(names)}")
        if 8 * (count + len(some)) * len(names) > LARGEST_BYTES:
            raise SourceError(f"{path} has more numbers than {LARGEST_BYTES / 1e9:.1f} GB hold: divide it")
        for blocks, cells in zip(columns, zip(*some, strict=True), strict=bool(some)):
            blocks.append(_numbers(cells, layout.decimal, count, skip=skip))
        count += len(some)

    encoding = "utf-8-sig" if layout.encoding == "utf-8" else layout.encoding
    try:
        with path.open(encoding=encoding, newline="") as file:
            names, lines = _named(_lines(path, file), layout)
            columns += [[] for _ in names]
            for line in islice(lines, most_rows):
                rows.append(line)
                if len(rows) * len(names) > _BLOCK and len(rows) > 2:  # the last two tell whether it is cut off
                    pack(2)
    except (UnicodeError, csv.Error) as error:
        raise SourceError(
            f"{path} is not CSV text ({error}); check the mapping's format, and encoding of [csv]"
        ) from error
    whole = most_rows is not None and count + len(rows) >= most_rows
    cut = (
        len(rows) > 1
        and not whole
        and (len(rows[-1]) < len(names) or (_is_cut(rows, layout.decimal) and not _ends_with_a_newline(path)))
    )
    truncated = f"row {count + len(rows)}, the last, is cut off: left out" if cut else ""
    if cut:
        rows.pop()
    pack(0)
    return Recording({name: _joined(blocks) for name, blocks in zip(names, columns, strict=True)}, truncated, ragged)


def _named(text: Iterator[str], layout: Csv) -> tuple[list[str], Iterator[list[str]]]:
    """Names of the columns, and the cells of the rows after them; empty lines and comments are passed over."""
    comment = layout.comment
    if not layout.header:
        deque(islice(text, (layout.rows_from or 1) - 1), maxlen=0)
        rows = _cells(text, layout)
        first = next(rows, [])
        return [str(k + 1) for k in range(len(first))], chain([first] if first else [], rows)
    deque(islice(text, layout.header_line - 1), maxlen=0)  # passed over
    header = next(text, "")
    if comment and header.lstrip().startswith(comment):
        header = header.lstrip()[len(comment) :].lstrip()
    names = next(_cells(iter([header]), layout), [])
    deque(islice(text, (layout.rows_from or layout.header_line + 1) - layout.header_line - 1), maxlen=0)
    return _apart([name.strip() for name in names]), _cells(text, layout)


def unbroken(text: Iterable[str]) -> Iterator[str]:
    """Lines in which nothing inside of a list's brackets separates cells.

    A matrix that is printed over some lines stands in the first, and the others are empty. Brackets that do not close
    stay as they are.
    """
    lines, waiting = iter(text), deque[str]()
    while (line := waiting.popleft() if waiting else next(lines, None)) is not None:
        if _BRACKET.search(line) is None:
            yield line
            continue
        over, deep = [line], _deep(line)
        while deep > 0 and len(over) < _LONGEST_LIST:
            if (further := waiting.popleft() if waiting else next(lines, None)) is None:
                break
            over.append(further)
            deep += _deep(further)
        if deep:
            yield line
            waiting.extendleft(reversed(over[1:]))
            continue
        depth, listed, out = 0, False, []
        whole = " ".join([over[0].rstrip(), *map(str.strip, over[1:])]) if over[1:] else line
        for k, mark in enumerate(whole):
            if mark in "[(":
                listed = bool(_BRACKET.match(whole, k)) if not depth else listed
            depth += (mark in "[(") - (mark in "])")
            out.append(_MASK if depth > 0 and listed and (mark.isspace() or mark in ",;") else mark)
        yield "".join(out)
        yield from [""] * (len(over) - 1)


def _deep(line: str) -> int:
    """Brackets that a line opens and does not close."""
    return sum(line.count(mark) for mark in "[(") - sum(line.count(mark) for mark in "])")


def _cells(text: Iterator[str], layout: Csv) -> Iterator[list[str]]:
    if layout.comment:
        mark = layout.comment
        text = (line for line in text if not line.lstrip().startswith(mark))
    text = unbroken(text)
    rows = (line.split() for line in text) if layout.delimiter == " " else csv.reader(text, delimiter=layout.delimiter)
    return (row for row in rows if row)


def _apart(names: list[str]) -> list[str]:
    """Names of which none stands twice."""
    count, seen = Counter(names), Counter[str]()
    for k, name in enumerate(names):
        seen[name] += 1
        if count[name] > 1:
            names[k] = f"{name} ({seen[name]})".strip()
    return names


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
    if len({block.shape[1:] for block in blocks}) > 1:
        return np.broadcast_to(np.array("its lists differ in length"), sum(map(len, blocks)))
    return np.concatenate(blocks) if blocks else np.zeros(0, np.int64)


def _ends_with_a_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 1))
        return file.read(1) in (b"\n", b"\r", b"", b"\0")  # the last of UTF-16


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


def _numbers(cells: Sequence[str], decimal: str, before: int, *, skip: bool) -> Values:
    """Numbers of a column from row ``before`` on; in every place the reason if one is none: an error if it is used.

    With ``skip`` those that are none are NaN, if any is one.
    """
    text = np.array(cells, dtype=str)
    text = text if decimal == "." else np.char.replace(text, decimal, ".")
    for kind in (np.int64, np.float64):
        try:
            return text.astype(kind)
        except (ValueError, OverflowError):
            continue
    if (times := times_of(text.tolist())) is not None:
        return times
    if (lists := _lists(text.tolist(), before, skip=skip)) is not None:
        return lists
    if skip:
        return np.array([number(cell) for cell in text.tolist()])
    return np.broadcast_to(np.array(_no_number(text.tolist(), before)), len(cells))


def times_of(cells: list[str]) -> NDArray[np.int64] | None:
    """Times of day or dates as in ISO 8601, ns since 1970 (of a time of day: since midnight); None if one is none."""
    if not cells or not _CLOCK.fullmatch(cells[0].strip()):
        return None
    plain = [cell.strip().removesuffix("Z") for cell in cells]
    days = [cell if "-" in cell else f"1970-01-01T{'0' * (cell[1:2] == ':')}{cell}" for cell in plain]
    try:
        return np.array(days, "datetime64[ns]").astype(np.int64)
    except ValueError:
        return None


def list_of(cell: str) -> list[float]:
    """Numbers of a cell that is a list of them, or a matrix, by rows; empty if it is none."""
    array = _ARRAY.fullmatch(cell)
    text = (array[1] if array else cell).strip(_MASK + " \t\n")
    if text[:1] not in ("[", "(") or text[-1:] not in ("]", ")"):
        return []
    parts = [part for part in _BETWEEN.split(text) if part]
    values = [number(part) for part in parts]
    bad = any(not np.isfinite(value) and part.lower() != "nan" for part, value in zip(parts, values, strict=True))
    return [] if bad else values


def _lists(cells: list[str], before: int, *, skip: bool) -> Values | None:
    """Of cells that are lists as long as most of them are; None where they are none; see ``_numbers``."""
    if not any(cell.rstrip().endswith(("]", ")")) for cell in cells[:_LOOKED_AT]):
        return None
    rows = [list_of(cell) for cell in cells]
    lengths = Counter(len(row) for row in rows if row)
    if not lengths:
        return None
    width = lengths.most_common(1)[0][0]
    odd = next((k for k, row in enumerate(rows) if len(row) != width), None)
    if odd is None or skip:
        return np.array([row if len(row) == width else [np.nan] * width for row in rows])
    told = f"row {before + 1 + odd} has {cells[odd][:_LONGEST_CELL]!r}, where others have a list of {width} numbers"
    return np.broadcast_to(np.array(f"{told}: {_SKIP}"), len(cells))


def number(cell: str) -> float:
    """Of a cell; NaN if it is none."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _no_number(cells: list[str], before: int) -> str:
    """``row 3 has '0,25', with a decimal comma: ...``: the first cell that is no number, and the remedy."""
    for row, cell in enumerate(cells, before + 1):
        try:
            float(cell)
        except ValueError:
            shown = repr(cell[:_LONGEST_CELL])
            if re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell):
                return f'row {row} has {shown}, with a decimal comma: write decimal = "," into [csv] of the mapping'
            said = f"row {row} has {shown}, which is no number: correct it, or the mapping"
            return f"{said}; {_SKIP}"
    return "its numbers are too large: correct them, or the mapping"
