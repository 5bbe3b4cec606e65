"""Columns of numbers and text to CSV (RFC 4180, LF line ends), a block of rows at a time and without a loop over rows.

Every cell is laid into a field of fixed width with NUL as filler, the fields of a block make a matrix of bytes, and
what is not NUL is the text. Values that occur often (counts of a sensor do) are formatted once.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.offline.columns import Column, Values

Cells = NDArray[np.uint8]  # (n, width), NUL where there is nothing

_POWERS = 10 ** np.arange(1, 20, dtype=np.uint64)


def header(columns: Sequence[Column]) -> bytes:
    """The first line."""
    return b",".join(_quoted(column.header.encode()) for column in columns) + b"\n"


def block(columns: Sequence[Column], rows: Rows) -> bytes:
    """The lines of ``rows`` (n,)."""
    comma, newline = (np.full((len(rows), 1), ord(mark), np.uint8) for mark in ",\n")
    parts: list[Cells] = []
    for column in columns:
        parts += [cells(column.values(rows), column.digits), comma]
    parts[-1] = newline
    flat = np.concatenate(parts, axis=1).reshape(-1)
    text: bytes = flat[flat != 0].tobytes()
    return text


def cells(values: Values, digits: int | None = None) -> Cells:
    """``values`` (n,) as text: integers and text as they are, floats with ``digits`` significant digits.

    Floats without ``digits`` are written as the shortest text that reads back as the same value of their type.
    """
    kind = values.dtype.kind
    if kind == "b" or (kind in "iu" and values.dtype.itemsize == 1):
        table, lowest = _small_integers(np.int8 if kind == "i" else np.uint8)
        return table[values.astype(np.int64) - lowest]
    if kind in "iu":
        return _integers(values)
    return _by_value(values, _float_formatter(values.dtype, digits) if kind == "f" else _text)


@cache
def _small_integers(kind: type[np.int8 | np.uint8]) -> tuple[Cells, int]:
    lowest, highest = int(np.iinfo(kind).min), int(np.iinfo(kind).max)
    return _matrix([b"%d" % n for n in range(lowest, highest + 1)]), lowest


def _integers(values: Values) -> Cells:
    negative = np.less(values, 0)
    magnitude = values.astype(np.uint64)
    magnitude[negative] = np.uint64(0) - magnitude[negative]  # exact for the most negative one too
    largest = magnitude.max(initial=0)
    width = 1 + int(np.searchsorted(_POWERS, largest, side="right"))
    rest = magnitude if largest >> 32 else magnitude.astype(np.uint32)  # whose division is several times faster
    result = np.empty((len(values), width + 1), np.uint8)
    count = np.ones(len(values), np.uint8)
    for column in range(width, 0, -1):
        rest, digit = np.divmod(rest, rest.dtype.type(10))
        result[:, column] = digit + rest.dtype.type(ord("0"))
        count += rest != 0
    result *= np.arange(width + 1) > (width - count)[:, None]
    result[:, 0] = negative * np.uint8(ord("-"))
    return result if negative.any() else result[:, 1:]


def _by_value(values: Values, to_text: Callable[[NDArray[np.generic]], list[bytes]]) -> Cells:
    distinct, which = np.unique(values, return_inverse=True)
    return _matrix(to_text(distinct))[which]


def _matrix(texts: list[bytes]) -> Cells:
    packed = np.array(texts or [b""])
    return packed.view(np.uint8).reshape(len(packed), packed.dtype.itemsize)


def _float_formatter(dtype: np.dtype[np.generic], digits: int | None) -> Callable[[NDArray[np.generic]], list[bytes]]:
    def short(values: NDArray[np.generic]) -> list[bytes]:
        # float32 has a shortest text of its own, which str of the NumPy scalar gives
        source = values.tolist() if dtype == np.float64 else values
        return [str(value).encode() for value in source]

    if digits is None or digits > 15:
        return short
    form = f"%.{digits}g"
    return lambda values: [(form % value).encode() for value in values.tolist()]


def _text(values: NDArray[np.generic]) -> list[bytes]:
    return [_quoted(bytes(value).decode(errors="backslashreplace").encode()) for value in values.tolist()]


def _quoted(text: bytes) -> bytes:
    text = text.replace(b"\0", b"\\x00")
    if any(mark in text for mark in (b",", b'"', b"\n", b"\r")):
        return b'"' + text.replace(b'"', b'""') + b'"'
    return text
