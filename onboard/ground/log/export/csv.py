"""CSV writer; column headings contain the unit."""

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from drivers.records import Rows
from onboard.ground.log.export.csv_text import CsvEncoder, header
from onboard.ground.log.tables.columns import TableColumn


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
