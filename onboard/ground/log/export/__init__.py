"""Writers of a channel's rows to CSV, Parquet, NPZ and MAT-files, block by block in constant memory."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

from drivers.records import Rows
from onboard.ground.log.tables.columns import TableColumn


class TableWriter(Protocol):
    """Writer of a table file."""

    def write(self, rows: Rows) -> None:
        """Write rows (n,)."""

    def close(self) -> None:
        """Finish the file."""


FORMATS = ("csv", "parquet", "npz", "mat")


def opener(kind: str) -> Callable[[Path | BinaryIO, Sequence[TableColumn]], TableWriter]:
    """Factory of a table of format ``kind`` from a path (or an open file, CSV only) and columns.

    Raises:
        ValueError: unknown format, or its library is not installed.
    """
    match kind:
        case "csv":
            from onboard.ground.log.export.csv import CsvTable

            return CsvTable
        case "parquet":
            try:
                from onboard.ground.log.export.parquet import ParquetTable
            except ImportError as error:
                raise ValueError(f"--to parquet needs pyarrow ({error}): pip install 'heft-flight[export]'") from error
            return ParquetTable
        case "npz":
            from onboard.ground.log.export.numpy import NpzTable

            return NpzTable
        case "mat":
            from onboard.ground.log.export.matlab import MatTable

            return MatTable
    raise ValueError(f"--to {kind}: known formats: {', '.join(FORMATS)}, mcap")
