"""Reads the arrays of an NPZ file that may come from anywhere: what it would take is added up before it is read."""

import io
import lzma
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from math import prod
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

_BROKEN = (  # what zipfile and NumPy raise for altered archives and array headers
    *(ValueError, EOFError, OverflowError, NotImplementedError, RuntimeError, SyntaxError, MemoryError, TypeError),
    *(KeyError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, tokenize.TokenError, struct.error, OSError),
)
_HEADERS = {  # by version: bytes of the header's length, and what reads it
    (1, 0): (2, np.lib.format.read_array_header_1_0),
    (2, 0): (4, np.lib.format.read_array_header_2_0),
}
_LONGEST_HEADER = 10_000  # bytes, as NumPy has it, which reads the whole of one before it looks
_MOST_ARRAYS = 10_000  # whose headers take 2 s


class NpzError(ValueError):
    """It cannot be read; the text begins with the file's path."""


def arrays_of(path: Path, most_bytes: int) -> dict[str, NDArray[np.generic]]:
    """The arrays, by name.

    Raises:
        NpzError: not an NPZ file of plain arrays, or one whose arrays take more than ``most_bytes``.
        OSError: the file cannot be opened.
    """
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's, of old headers that it can still read
        try:
            _require_bounded(path, most_bytes)
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, NpzFile):
                return {name: _readable(loaded[name], f"{path}: {name}") for name in loaded.files}
        except NpzError:
            raise
        except _BROKEN as error:
            raise NpzError(f"{path} is not an NPZ file of plain arrays ({error}); check its format") from error
    raise NpzError(f"{path} is an array without a name, not an NPZ file; save it with numpy.savez")


def _readable(array: NDArray[np.generic], where: str) -> NDArray[np.generic]:
    """The array; raises NpzError if it holds text with numbers that are no characters."""
    if array.dtype.kind == "U" and array.dtype.itemsize:
        codes = np.frombuffer(array.tobytes(), np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
        if (codes > sys.maxunicode).any():
            raise NpzError(f"{where} holds text that is none; save it again")
    return array


def _require_bounded(path: Path, most_bytes: int) -> None:
    """Raises NpzError if the arrays would take more memory than that."""
    if not zipfile.is_zipfile(path):
        return  # reported by the caller
    with zipfile.ZipFile(path) as archive:
        total = 0
        if len(archive.infolist()) > _MOST_ARRAYS:
            raise NpzError(f"{path} has more than {_MOST_ARRAYS} arrays: divide it")
        for member in archive.infolist():
            with archive.open(member) as array:
                known = _HEADERS.get(np.lib.format.read_magic(array))
                if known is None:
                    raise NpzError(f"{path}: {member.filename} is no array of a known version; save it again")
                bytes_of_length, header = known
                length = array.read(bytes_of_length)
                size = int.from_bytes(length, "little")
                if size > _LONGEST_HEADER:
                    raise NpzError(f"{path}: {member.filename} has a header of {size} bytes; save it again")
                shape, _, dtype = header(io.BytesIO(length + array.read(size)))
            total += max(member.file_size, dtype.itemsize * prod(shape))
        if total > most_bytes:
            limit = f"{most_bytes / 1e9:.1f} GB"
            raise NpzError(f"{path} would expand to {total / 1e9:.3g} GB; the limit is {limit}: divide it")
