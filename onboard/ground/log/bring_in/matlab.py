"""Reads the arrays of MATLAB's files up to version 7; structures become ``name.field``."""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.text_rows import LARGEST_BYTES, Values

_HEADER, _COMPRESSED = 128, 15  # bytes of version 5's, miCOMPRESSED
_AT_ONCE = 1 << 20
# what the reader raises for altered files
_BROKEN = (ValueError, TypeError, KeyError, EOFError, NotImplementedError, OverflowError, MemoryError, zlib.error)


def read_mat(path: Path) -> dict[str, Values]:
    """Numbers by name: (n,), or (n, columns) with the longer side as rows.

    Raises:
        SourceError: no MAT file up to version 7, or one that would expand to more than a recording holds.
        OSError: the file cannot be read.
    """
    from scipy.io import loadmat  # noqa: PLC0415  (no other format needs it)
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    with path.open("rb") as file:
        head = file.read(_HEADER)
    if b"MATLAB 7.3" in head or head[:8] == b"\x89HDF\r\n\x1a\n":
        raise SourceError(
            f"{path} is HDF5, as MATLAB's of version 7.3: there, save('FILE.mat', '-v7'); else save arrays as NPZ"
        )
    _require_bounded(path, head)
    try:
        loaded = loadmat(path, simplify_cells=True)
    except (MatReadError, *_BROKEN) as error:
        raise SourceError(f"{path} is no MAT file that can be read ({error}); save it again with '-v7'") from error
    return dict(_arrays(loaded, ""))


def _arrays(fields: dict[str, Any], name: str) -> Iterator[tuple[str, Values]]:
    for key, one in fields.items():
        own = f"{name}.{key}" if name else key
        if isinstance(one, dict):
            yield from _arrays(one, own)
        elif isinstance(one, np.ndarray) and one.dtype.kind in "iufb" and 1 <= one.ndim <= 2:
            rows = one.squeeze() if one.ndim == 2 and 1 in one.shape else one
            rows = rows.T if rows.ndim == 2 and rows.shape[0] < rows.shape[1] else rows
            if rows.ndim:
                yield own, rows.astype(np.int64) if rows.dtype.kind in "uib" else rows


def _require_bounded(path: Path, head: bytes) -> None:
    """Add up what compressed elements expand to, as far as the limit."""
    little = head[126:128] == b"IM"
    total = 0
    with path.open("rb") as file:
        file.seek(_HEADER)
        while len(tag := file.read(8)) == 8:
            kind, size = (int.from_bytes(part, "little" if little else "big") for part in (tag[:4], tag[4:]))
            total += size
            if kind == _COMPRESSED:
                inflate = zlib.decompressobj()
                left = size
                try:
                    while left > 0 and (some := file.read(min(left, _AT_ONCE))):
                        left -= len(some)
                        while some and total <= LARGEST_BYTES:
                            total += len(inflate.decompress(some, _AT_ONCE))
                            some = inflate.unconsumed_tail
                except zlib.error:
                    return  # reported by the reader
            else:
                file.seek(size, 1)
            if total > LARGEST_BYTES:
                raise SourceError(f"{path} would expand to more than {LARGEST_BYTES / 1e9:.1f} GB: divide it")
