"""A log as tables for other programs: a file a channel, raw counts and SI side by side or one of them.

Memory does not grow with the log: CSV and Parquet are written as rows come; NPZ and MAT-files, which need the length of
a column first, from temporary files beside the target.
"""

import re
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import numpy as np
from rich.progress import Progress

from drivers.records import Rows
from onboard.offline.export import Table, opener
from onboard.offline.tables.columns import Column, columns
from onboard.offline.tables.selection import Selection
from onboard.recording.reader import LogReader
from onboard.recording.scan import Damage

_BLOCK_ROWS = 16384
_BLOCK_BYTES = 4 << 20

Values = Literal["both", "raw", "si"]
Opener = Callable[[Path | BinaryIO, Sequence[Column]], Table]


class DumpResult(NamedTuple):
    """What a dump wrote: files in the order of the channels, rows by channel, and what of the log was lost."""

    files: tuple[Path, ...]
    rows: dict[str, int]
    damage: tuple[Damage, ...]
    exit_code: int


def dump(
    log: LogReader | str | Path,
    target: str | Path | BinaryIO,
    selection: Selection = Selection(),  # noqa: B008  # frozen
    *,
    kind: str = "csv",
    values: Values = "both",
    progress: Progress | None = None,
) -> DumpResult:
    """Write each channel of ``log`` to ``target/CHANNEL.kind``, or one channel to an open file.

    Args:
        log: the log, or its path.
        target: a directory, made if need be, in which files of the same names are replaced; or a binary file to write
            the CSV of the one selected channel to.
        selection: what of the log.
        kind: format, of ``onboard.offline.export.FORMATS``.
        values: raw counts, SI (without the counts and scales that it is made of), or both.
        progress: gets a task that counts the bytes of the log.

    Raises:
        LogFormatError: ``log`` is no log of ours.
        ChannelError: it has no such channel.
        ValueError: the selection or the format cannot be had.
        OSError: a file cannot be read or written.
    """
    make = opener(kind)
    reader = log if isinstance(log, LogReader) else LogReader(log)
    batches = selection.batches(reader)
    wanted = selection.channels
    chosen = [name for name in reader.channels if wanted is None or name in wanted]
    targets: dict[str, Path | BinaryIO]
    if isinstance(target, str | Path):
        folder = Path(target)
        folder.mkdir(parents=True, exist_ok=True)
        paths = _paths(folder, chosen, kind)
        targets = dict(paths)
    elif len(chosen) == 1 and kind == "csv":
        paths, targets = {}, {chosen[0]: target}
    else:
        raise ValueError(f"one CSV goes into a pipe: say which with --channel; the log has {', '.join(chosen)}")
    task = None if progress is None else progress.add_task(f"dump {reader.path.name}", total=reader.size)
    tables: dict[str, _Pending] = {}
    with ExitStack() as stack:
        for name in chosen:
            dtype, units = reader.channels[name], reader.units[name]
            tables[name] = _Pending(make, targets[name], dtype, units, values)
            stack.callback(tables[name].close)
        for batch in batches:
            tables[batch.channel].add(batch.rows)
            if progress is not None and task is not None:
                progress.update(task, completed=reader.position)
    if progress is not None and task is not None:
        progress.update(task, completed=reader.size)
    counts = {name: table.rows for name, table in tables.items()}
    return DumpResult(tuple(paths.values()), counts, reader.damage, reader.exit_code)


def _paths(folder: Path, channels: Collection[str], kind: str) -> dict[str, Path]:
    """A file name for each channel; a name that is no file name gets its number, so that none is met twice."""
    paths: dict[str, Path] = {}
    for number, name in enumerate(channels, 1):
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".")
        paths[name] = folder / (f"{name}.{kind}" if plain == name else f"{plain}_{number}.{kind}")
    return paths


def chosen_columns(every: Sequence[Column], values: Values) -> list[Column]:
    """Those of ``every`` that ``values`` asks for."""
    if values == "raw":
        return [column for column in every if not column.converted]
    if values == "si":
        made_of = {name for column in every for name in column.made_of}
        return [column for column in every if column.name not in made_of]
    return list(every)


class _Pending:
    """A channel's rows on their way into a table, gathered to blocks."""

    def __init__(
        self, make: Opener, target: Path | BinaryIO, dtype: np.dtype[np.void], units: dict[str, str], values: Values
    ) -> None:
        self.rows = 0
        self._make, self._target, self._dtype, self._units, self._values = make, target, dtype, units, values
        self._table: Table | None = None
        self._waiting: list[Rows] = []
        self._waiting_rows = 0
        self._block = max(1, min(_BLOCK_ROWS, _BLOCK_BYTES // dtype.itemsize))

    def add(self, rows: Rows) -> None:
        """Take rows (n,) of the channel."""
        self._waiting.append(rows)
        self._waiting_rows += len(rows)
        if self._waiting_rows >= self._block:
            self._write()

    def close(self) -> None:
        """Write what waits, and close."""
        try:
            self._write()
        finally:
            if self._table is not None:
                self._table.close()

    def _write(self) -> None:
        rows = np.concatenate([np.empty(0, self._dtype), *self._waiting])
        if self._table is None:
            every = columns(self._dtype, self._units, rows)
            self._table = self._make(self._target, chosen_columns(every, self._values))
        self._table.write(rows)
        self.rows += len(rows)
        self._waiting, self._waiting_rows = [], 0
