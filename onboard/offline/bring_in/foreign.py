"""Reads columns of foreign files (CSV with a header line, NumPy's NPZ); a whole file is held in memory."""

import csv
import lzma
import os
import re
import stat
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping as Columns
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from onboard.offline.bring_in.errors import SourceError
from onboard.offline.bring_in.mapping import Csv

Values = NDArray[np.generic]
LARGEST_BYTES = 2 << 30  # of the arrays of one file
BROKEN = (  # what zipfile and NumPy raise for altered archives and array headers
    *(ValueError, EOFError, OverflowError, NotImplementedError, RuntimeError, SyntaxError, MemoryError, TypeError),
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, tokenize.TokenError, struct.error, OSError),
)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(path: Path) -> Columns[str, Values]:
    """The arrays of an NPZ file, by name.

    Raises:
        SourceError: not an NPZ file, or one with pickled objects.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's, of old headers that it can still read
        try:
            _require_bounded(path)
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, NpzFile):
                return {name: loaded[name] for name in loaded.files}
        except SourceError:
            raise
        except BROKEN as error:
            raise SourceError(f"{path} is not an NPZ file of plain arrays ({error}); check its format") from error
    raise SourceError(f"{path} is one array without a name, not an NPZ file; save it with numpy.savez")


def _require_bounded(path: Path) -> None:
    """Raises SourceError if the arrays of an NPZ file would take more memory than a recording does."""
    if not zipfile.is_zipfile(path):
        return  # told by the caller
    with zipfile.ZipFile(path) as archive:
        total = 0
        for member in archive.infolist():
            with archive.open(member) as array:
                header = _HEADERS.get(np.lib.format.read_magic(array))
                if header is None:
                    raise SourceError(f"{path}: {member.filename} is no array of a known version; save it again")
                shape, _, dtype = header(array)
            total += max(member.file_size, dtype.itemsize * prod(shape))
        if total > LARGEST_BYTES:
            limit = f"{LARGEST_BYTES / 1e9:.1f} GB"
            raise SourceError(f"{path} would expand to {total / 1e9:.3g} GB; the limit is {limit}: divide it")


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
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for _ in range(layout.header_line - 1):
                file.readline()
            lines = csv.reader(file, delimiter=layout.delimiter)
            names = [name.strip() for name in next(lines, [])]
            cells = [line for line in lines if line]
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path} is not CSV text ({error}); check the mapping's format") from error
    cut = len(cells) > 1 and (len(cells[-1]) < len(names) or (_is_cut(cells) and not _ends_with_a_newline(path)))
    truncated = f"row {len(cells)}, the last one, is cut off: left out" if cut else ""
    if cut:
        cells.pop()
    for number, line in enumerate(cells, 1):
        if len(line) != len(names):
            raise SourceError(
                f"{path}: row {number} has {len(line)} cells where the header names {len(names)}; check [csv]"
            )
    columns = zip(*cells, strict=True) if cells else ([] for _ in names)
    return Recording(
        {name: _numbers(path, name, list(column)) for name, column in zip(names, columns, strict=True)}, truncated
    )


def _ends_with_a_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 1))
        return file.read(1) in (b"\n", b"\r", b"")


def _is_cut(cells: list[list[str]]) -> bool:
    """Whether the last cell of the last row is no number, and that of the row before is one."""

    def number(cell: str) -> bool:
        try:
            float(cell)
        except ValueError:
            return False
        return True

    return len(cells[-2]) == len(cells[-1]) and number(cells[-2][-1]) and not number(cells[-1][-1])


def _numbers(path: Path, name: str, cells: list[str]) -> Values:
    """Numbers of a column; text if a cell is not a number (an error only if the mapping uses the column)."""
    for kind in (np.int64, np.float64):
        try:
            return np.array(cells, dtype=str).astype(kind)
        except (ValueError, OverflowError):
            continue
    return np.array(cells, dtype=str)


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
        raise SourceError(f"{path} has no column {name!r}; it has {', '.join(map(repr, columns))}")
    if values.dtype.kind not in "iuf":
        raise SourceError(f"{path}: column {name!r} holds cells that are not numbers; correct them or the mapping")
    if values.ndim != (1 if width is None else 2) or (width is not None and values.shape[1] != width):
        wanted = "one value" if width is None else f"{width} values"
        raise SourceError(f"{path}: column {name!r} has shape {values.shape}; the mapping needs {wanted} a row")
    return values
