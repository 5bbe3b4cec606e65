"""A channel's rows to a file of some format, a block at a time; memory does not grow with the rows."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

from drivers.records import Rows
from onboard.offline.tables.columns import Column


class Table(Protocol):
    """A file in the making."""

    def write(self, rows: Rows) -> None:
        """Take rows (n,)."""

    def close(self) -> None:
        """Finish the file."""


FORMATS = ("csv", "parquet", "npz", "mat")


def opener(kind: str) -> Callable[[Path | BinaryIO, Sequence[Column]], Table]:
    """What makes a table of format ``kind`` from a path (or an open file, which only CSV can write to) and columns.

    Raises:
        ValueError: no such format, or what it needs is not installed.
    """
    match kind:
        case "csv":
            from onboard.offline.export.csv import CsvTable

            return CsvTable
        case "parquet":
            try:
                from onboard.offline.export.parquet import ParquetTable
            except ImportError as error:
                raise ValueError(f"--to parquet needs pyarrow ({error}): pip install 'heft-flight[export]'") from error
            return ParquetTable
        case "npz":
            from onboard.offline.export.numpy import NpzTable

            return NpzTable
        case "mat":
            from onboard.offline.export.matlab import MatTable

            return MatTable
    raise ValueError(f"--to {kind}: known formats: {', '.join(FORMATS)}")
