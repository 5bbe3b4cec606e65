"""Parquet writer (pyarrow): units in the metadata of the fields, one row group per block."""

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from drivers.records import Rows
from onboard.ground.log.export.spool import seconds
from onboard.ground.log.tables.columns import TableColumn, Values


class ParquetTable:
    """A Parquet file.

    Args:
        target: path of the file.
        columns: columns of the table.
    """

    def __init__(self, target: Path | BinaryIO, columns: Sequence[TableColumn]) -> None:
        self._columns, self._target = columns, target
        self._writer: pq.ParquetWriter | None = None

    def write(self, rows: Rows) -> None:
        """Write rows (n,)."""
        arrays = [_array(column.values(rows)) for column in self._columns]
        if self._writer is None:
            fields = [
                pa.field(column.name, array.type, nullable=column.name == "utc", metadata={"unit": column.unit})
                for column, array in zip(self._columns, arrays, strict=True)
            ]
            # dictionary encoding costs a third of the speed for a tenth of the size
            self._writer = pq.ParquetWriter(self._target, pa.schema(fields), compression="lz4", use_dictionary=False)
        table = pa.Table.from_arrays(arrays, schema=self._writer.schema)
        self._writer.write_table(table, row_group_size=max(1, len(rows)))

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()


def _array(values: Values) -> pa.Array:
    if values.dtype.kind == "M":
        return pa.array(np.ascontiguousarray(values), pa.timestamp("ns", "UTC"))
    if values.dtype.kind != "S":
        return pa.array(np.ascontiguousarray(seconds(values)))
    distinct, which = np.unique(values, return_inverse=True)
    texts = pa.array([bytes(text).decode(errors="backslashreplace") for text in distinct], pa.string())
    return texts.take(pa.array(which))
