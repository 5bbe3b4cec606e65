"""Spools columns to temporary files beside the target, for formats that need a column's length first."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from drivers.records import Rows
from onboard.ground.log.tables.columns import TableColumn, Values

BLOCK_BYTES = 1 << 20


def seconds(values: Values) -> Values:
    """timedelta64 as float seconds, NaN for NaT; everything else as it is."""
    if values.dtype.kind != "m":
        return values
    return np.where(np.isnat(values), np.nan, values.view(np.int64) * 1e-9)


class SpooledTable:
    """A file that is written at its close, from a temporary file per column beside it.

    Args:
        target: path of the file; its directory needs space for the table once more.
        columns: columns of the table.
    """

    def __init__(self, target: Path | BinaryIO, columns: Sequence[TableColumn]) -> None:
        assert isinstance(target, Path)
        self.path, self.columns, self.rows = target, columns, 0
        self.dtypes: list[np.dtype[np.generic]] = [np.dtype(np.float64) for _ in columns]
        self._stack = ExitStack()
        self._files: list[IO[bytes]] = [
            self._stack.enter_context(tempfile.TemporaryFile(dir=target.parent))  # noqa: SIM115
            for _ in columns
        ]

    def write(self, rows: Rows) -> None:
        """Write rows (n,)."""
        for number, (column, file) in enumerate(zip(self.columns, self._files, strict=True)):
            values = seconds(column.values(rows))
            self.dtypes[number] = values.dtype
            file.write(np.ascontiguousarray(values).view(np.uint8).data)
        self.rows += len(rows)

    def blocks(self, number: int) -> Iterator[bytes]:
        """The bytes of column ``number`` from its first row on, block by block."""
        file = self._files[number]
        file.seek(0)
        while block := file.read(BLOCK_BYTES):
            yield block

    def mapped(self, number: int) -> np.memmap[tuple[int], np.dtype[np.generic]]:
        """Column ``number`` (n,), n > 0, memory-mapped."""
        self._files[number].flush()
        return np.memmap(self._files[number], self.dtypes[number], "r", shape=(self.rows,))

    def discard(self) -> None:
        """Remove the temporary files."""
        self._stack.close()
