"""Writes level 5 MAT-files for MATLAB and Octave: one column vector per column, and ``units``, a row of text each.

Written block by block, because ``scipy.io.savemat`` needs every array in memory. Layout: "MAT File Format", MathWorks,
sections on Level 5 MAT-Files.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np

from onboard.ground.log.export.spool import BLOCK_BYTES, SpooledTable

_MI_INT8, _MI_UINT16, _MI_INT32, _MI_UINT32, _MI_MATRIX = 1, 4, 5, 6, 14
_MX_CHAR = 4
_TYPES = {  # miTYPE, mxCLASS
    "i1": (1, 8),
    "u1": (2, 9),
    "i2": (3, 10),
    "u2": (4, 11),
    "i4": (5, 12),
    "u4": (6, 13),
    "f4": (7, 7),
    "f8": (9, 6),
    "i8": (12, 14),
    "u8": (13, 15),
    "b1": (2, 9),
    "M8[ns]": (12, 14),  # UTC as ns since 1970, which datetime(..., 'ConvertFrom', 'epochtime') takes
}
_MOST_BYTES = (1 << 31) - 1  # largest size of a variable
_NAME_BYTES = 63
_DESCRIPTION = b"MATLAB 5.0 MAT-file, written by heft"


class MatTable(SpooledTable):
    """A MAT-file."""

    def close(self) -> None:
        """Finish the file.

        Raises:
            ValueError: a column is larger than the format can hold.
        """
        try:
            with self.path.open("wb") as file:
                file.write(_DESCRIPTION.ljust(124) + struct.pack("<H2s", 0x0100, b"IM"))
                for number, column in enumerate(self.columns):
                    dtype = self.dtypes[number]
                    if dtype.kind == "S":
                        self._text(file, number, column.name)
                    else:
                        size, types = self.rows * dtype.itemsize, _TYPES[dtype.str[1:]]
                        self._variable(file, column.name, types, (self.rows, 1), size, self.blocks(number))
                units = np.array([f"{c.name} [{c.unit}]" for c in self.columns] or [""], np.str_)
                chars = units.view(np.uint32).reshape(len(units), -1).astype("<u2").T
                self._matrix(file, "units", len(units), chars.shape[0], [chars.tobytes()])
        finally:
            self.discard()

    def _text(self, file: BinaryIO, number: int, name: str) -> None:
        """Write a character matrix, stored column by column."""
        width = self.dtypes[number].itemsize

        def places() -> Iterator[bytes]:
            rows = self.mapped(number).view(np.uint8).reshape(-1, width)
            for place in range(width):
                for first in range(0, len(rows), BLOCK_BYTES // 2):
                    block = rows[first : first + BLOCK_BYTES // 2, place].astype("<u2")
                    block[block == 0] = ord(" ")
                    yield block.tobytes()

        self._matrix(file, name, self.rows, width, places() if self.rows else [])

    def _matrix(self, file: BinaryIO, name: str, rows: int, width: int, blocks: Iterable[bytes]) -> None:
        self._variable(file, name, (_MI_UINT16, _MX_CHAR), (rows, width), 2 * rows * width, blocks)

    def _variable(
        self,
        file: BinaryIO,
        name: str,
        types: tuple[int, int],
        shape: tuple[int, int],
        size: int,
        blocks: Iterable[bytes],
    ) -> None:
        if size > _MOST_BYTES:
            raise ValueError(
                f"{self.path.name}: {name} has {size:,} bytes, and a MAT-file variable is limited to 2 GiB; cut the "
                "log with --from and --until, or use npz or parquet"
            )
        (kind, array_class), title = types, name.encode()[:_NAME_BYTES]
        head = struct.pack("<IIII", _MI_UINT32, 8, array_class, 0) + struct.pack("<IIii", _MI_INT32, 8, *shape)
        head += struct.pack("<II", _MI_INT8, len(title)) + _padded(title) + struct.pack("<II", kind, size)
        file.write(struct.pack("<II", _MI_MATRIX, len(head) + size + -size % 8) + head)
        for block in blocks:
            file.write(block)
        file.write(bytes(-size % 8))


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 8)
