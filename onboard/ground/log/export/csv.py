"""CSV writer; column headings contain the unit.

Formats columns of numbers and text as CSV (RFC 4180, LF line ends), vectorised over blocks of rows.

Every cell is written into a fixed-width field padded with NUL; the fields of a block form a matrix of bytes, from which
the NULs are removed. Recurring values are formatted once: 16-bit counts and their products with a constant scale come
from tables, other floats and text are formatted per distinct value.
"""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.ground.log.tables.columns import TableColumn, Values

Cells = NDArray[np.uint8]  # (n, width), NUL-padded; (1, width) if all rows are equal

_POWERS = 10 ** np.arange(1, 20, dtype=np.uint64)
_GROUP = np.uint64(10_000)
_ODD_BYTES = (b",", b'"', b"\n", b"\r")
_FORMULA_MARKS = (b"=", b"+", b"-", b"@", b"\t", b"\r")  # a spreadsheet takes text that begins with one for a formula
_NAT = np.iinfo(np.int64).min
_DAY_NS, _SECOND_NS = 86_400_000_000_000, 1_000_000_000


def header(columns: Sequence[TableColumn]) -> bytes:
    """The header line."""
    return b",".join(_safe(column.header.encode()) for column in columns) + b"\n"


class CsvEncoder:
    """Formats rows of one channel as lines, with caches of constant size.

    Args:
        columns: columns of the table.
    """

    def __init__(self, columns: Sequence[TableColumn]) -> None:
        self._columns = [(column, _Products(column.digits)) for column in columns]

    def block(self, rows: Rows) -> bytes:
        """The lines of ``rows`` (n,)."""
        if not len(rows):
            return b""
        parts = [self._cells(column, products, rows) for column, products in self._columns]
        lines = np.empty((len(rows), sum(part.shape[1] + 1 for part in parts)), np.uint8)
        at = 0
        for part in parts:
            end = at + part.shape[1]
            lines[:, at:end] = part
            lines[:, end] = ord(",")
            at = end + 1
        lines[:, -1] = ord("\n")
        return lines.tobytes().translate(None, b"\0")

    @staticmethod
    def _cells(column: TableColumn, products: "_Products", rows: Rows) -> Cells:
        if column.product is not None:
            counts, scale = (take(rows) for take in column.product)
            if counts.dtype == np.int16 and (scale == scale[0]).all():
                return products.cells(counts, scale[0])
        return cells(column.values(rows), column.digits)


class _Products:
    """Cache of the cells of count x scale for 16-bit counts; cleared when the scale changes."""

    def __init__(self, digits: int | None) -> None:
        self._digits = digits
        self._scale: np.generic | None = None
        self._known = np.zeros(0, np.bool_)
        self._table: Cells = np.zeros((0, 1), np.uint8)

    def cells(self, counts: Values, scale: np.generic) -> Cells:
        """Cells (n, width) of ``counts`` (n,) int16 x ``scale``."""
        if scale != self._scale:
            self._scale = scale
            self._known, self._table = np.zeros(1 << 16, np.bool_), np.zeros((1 << 16, 1), np.uint8)
        index = counts.view(np.uint16)
        if not self._known[index].all():
            new = np.unique(counts[~self._known[index]])
            made = cells(new.astype(np.float64) * np.float64(scale), self._digits)
            missing = made.shape[1] - self._table.shape[1]
            if missing > 0:
                self._table = np.pad(self._table, ((0, 0), (0, missing)))
            self._table[new.view(np.uint16)] = 0
            self._table[new.view(np.uint16), : made.shape[1]] = made
            self._known[new.view(np.uint16)] = True
        return _rows_of(self._table, index)


def cells(values: Values, digits: int | None = None) -> Cells:
    """``values`` (n,) as text: integers and text as they are, floats with ``digits`` significant digits.

    Floats without ``digits`` are written as the shortest text that reads back as the same value of their type.
    timedelta64[ns] is written in seconds, datetime64[ns] as UTC (ISO 8601), neither with fewer than nine decimals.
    """
    kind = values.dtype.kind
    if kind in "mM":
        return (_seconds if kind == "m" else _instants)(values.view(np.int64))
    if kind == "b" or (kind in "iu" and values.dtype.itemsize <= 2):
        name = values.dtype.str if kind in "iu" else "|u1"
        return _rows_of(_small_integers(name), values.astype(np.intp) - int(np.iinfo(name).min))
    if kind in "iu":
        return _integers(values)
    return _by_value(values, _float_formatter(values.dtype, digits) if kind == "f" else _text)


def _rows_of(table: Cells, index: NDArray[np.integer[Any]]) -> Cells:
    """Rows ``index`` (n,) of ``table``, each moved as one item."""
    width = table.shape[1]
    taken = table.view(f"V{width}").reshape(-1).take(index)
    return taken.view(np.uint8).reshape(len(index), width)


@cache
def _small_integers(kind: str) -> Cells:
    limits = np.iinfo(kind)
    return _matrix([b"%d" % n for n in range(int(limits.min), int(limits.max) + 1)])


@cache
def _groups() -> NDArray[np.uint32]:
    """Four digits of every number below 10,000, as one item each."""
    return np.array([b"%04d" % n for n in range(int(_GROUP))]).view(np.uint32)


def _integers(values: Values) -> Cells:
    if not len(values):
        return np.zeros((0, 1), np.uint8)
    negative = np.less(values, 0)
    magnitude = values.astype(np.uint64)
    magnitude[negative] = np.uint64(0) - magnitude[negative]  # exact for the most negative one too
    most = 1 + int(np.searchsorted(_POWERS, magnitude.max(), side="right"))
    fewest = 1 + int(np.searchsorted(_POWERS, magnitude.min(), side="right"))
    groups = np.empty((len(values), -(-most // 4)), np.uint32)
    for column in range(groups.shape[1] - 1, -1, -1):
        rest = magnitude // _GROUP
        groups[:, column] = _groups().take((magnitude - rest * _GROUP).astype(np.intp))
        magnitude = rest
    result: Cells = groups.view(np.uint8)[:, -most:]
    if fewest < most:  # leading zeros of shorter numbers
        result = result * np.logical_or.accumulate(result != ord("0"), axis=1)
        result[:, -1] = groups.view(np.uint8)[:, -1]
    if negative.any():
        result = np.column_stack([negative * np.uint8(ord("-")), result])
    return result


def _seconds(time_ns: NDArray[np.int64]) -> Cells:
    """Times as seconds; "nan" for NaT."""
    unknown = time_ns == _NAT
    if unknown.all():
        return _matrix([b"nan"])
    magnitude = np.abs(np.where(unknown, 0, time_ns))
    text = np.column_stack([_integers(magnitude // _SECOND_NS), _fraction(magnitude % _SECOND_NS)])
    if (negative := (time_ns < 0) & ~unknown).any():
        text = np.column_stack([negative * np.uint8(ord("-")), text])
    if unknown.any():
        text[unknown] = 0
        text[unknown, :3] = np.frombuffer(b"nan", np.uint8)
    return text


def _instants(time_ns: NDArray[np.int64]) -> Cells:
    """Instants as ``2026-11-20T17:05:05.123456789Z``; nothing for NaT."""
    unknown = time_ns == _NAT
    days, in_day = np.divmod(np.where(unknown, 0, time_ns), _DAY_NS)
    seconds, nanoseconds = np.divmod(in_day, _SECOND_NS)
    dates = _by_value(days, lambda d: [str(np.datetime64(int(one), "D")).encode() for one in d.tolist()])
    parts = [np.broadcast_to(dates, (len(days), dates.shape[1]))]  # a flight is in one day, as a rule
    for mark, two in (("T", seconds // 3600), (":", seconds // 60 % 60), (":", seconds % 60)):
        parts += [_filled(mark, len(time_ns)), _groups()[two].view(np.uint8).reshape(-1, 4)[:, 2:]]
    text: Cells = np.column_stack([*parts, _fraction(nanoseconds), _filled("Z", len(time_ns))])
    text[unknown] = 0
    return text


def _fraction(nanoseconds: NDArray[np.int64]) -> Cells:
    """A dot and nine digits."""
    parts = nanoseconds // 100_000_000, nanoseconds // 10_000 % 10_000, nanoseconds % 10_000
    groups = [_groups()[part].view(np.uint8).reshape(-1, 4) for part in parts]
    return np.column_stack([_filled(".", len(nanoseconds)), groups[0][:, 3:], *groups[1:]])


def _filled(mark: str, count: int) -> Cells:
    return np.full((count, 1), ord(mark), np.uint8)


def _by_value(values: Values, to_text: Callable[[NDArray[np.generic]], list[bytes]]) -> Cells:
    if len(values) > 1 and (values == values[0]).all():
        return _matrix(to_text(values[:1]))
    distinct, which = np.unique(values, return_inverse=True)
    return _rows_of(_matrix(to_text(distinct)), which)


def _matrix(texts: list[bytes]) -> Cells:
    packed = np.array(texts or [b""])
    return packed.view(np.uint8).reshape(len(packed), packed.dtype.itemsize)


def _float_formatter(dtype: np.dtype[np.generic], digits: int | None) -> Callable[[NDArray[np.generic]], list[bytes]]:
    def short(values: NDArray[np.generic]) -> list[bytes]:
        # str of the NumPy scalar gives the shortest float32 text
        source = values.tolist() if dtype == np.float64 else values
        return [str(value).encode() for value in source]

    if digits is None or digits > 15:
        return short
    form = f"%.{digits}g"
    return lambda values: [(form % value).encode() for value in values.tolist()]


def _text(values: NDArray[np.generic]) -> list[bytes]:
    return [_safe(bytes(value).decode(errors="backslashreplace").encode()) for value in values.tolist()]


def _safe(text: bytes) -> bytes:
    """``text`` as a cell that no spreadsheet computes: an apostrophe stands before what would begin a formula."""
    return _quoted(b"'" + text if text.startswith(_FORMULA_MARKS) else text)


def _quoted(text: bytes) -> bytes:
    text = text.replace(b"\0", b"\\x00")
    if any(mark in text for mark in _ODD_BYTES):
        return b'"' + text.replace(b'"', b'""') + b'"'
    return text


class CsvTable:
    """A CSV file, or a stream that stays open.

    Args:
        target: path, or open file.
        columns: columns of the table.
    """

    def __init__(self, target: Path | BinaryIO, columns: Sequence[TableColumn]) -> None:
        self._own = isinstance(target, Path)
        self._file: BinaryIO = target.open("wb") if isinstance(target, Path) else target
        self._encoder = CsvEncoder(columns)
        self._file.write(header(columns))

    def write(self, rows: Rows) -> None:
        """Write rows (n,)."""
        self._file.write(self._encoder.block(rows))

    def close(self) -> None:
        """Finish the file."""
        if self._own:
            self._file.close()
        else:
            self._file.flush()
