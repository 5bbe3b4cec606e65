"""A log as CSV: one file a channel, units in the header, raw counts and SI side by side."""

import re
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from rich.progress import Progress

from drivers.records import Rows
from onboard.offline import csv_text
from onboard.offline.columns import Column, columns
from onboard.recording.reader import LogReader
from onboard.recording.scan import Damage

_BLOCK_ROWS = 16384
_BLOCK_BYTES = 4 << 20


class DumpResult(NamedTuple):
    """What a dump wrote: files in the order of the channels, rows by channel, and what of the log was lost."""

    files: tuple[Path, ...]
    rows: dict[str, int]
    damage: tuple[Damage, ...]
    exit_code: int


def dump(
    log: str | Path,
    directory: str | Path,
    channels: Collection[str] | None = None,
    *,
    progress: Progress | None = None,
) -> DumpResult:
    """Write each channel of ``log`` to ``directory/CHANNEL.csv``; memory does not grow with the log.

    Args:
        log: path of the log.
        directory: made if need be; files in it of the same names are replaced.
        channels: only these.
        progress: gets a task that counts the bytes of the log.

    Raises:
        LogFormatError: ``log`` is no log of ours.
        ChannelError: it has no such channel.
        OSError: a file cannot be read or written.
    """
    reader = LogReader(log)
    chosen = [name for name in reader.channels if channels is None or name in channels]
    batches = reader.batches(channels)
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    paths = _paths(folder, chosen)
    task = None if progress is None else progress.add_task(f"dump {reader.path.name}", total=reader.size)
    tables: dict[str, _Table] = {}
    with ExitStack() as stack:
        for name in chosen:
            tables[name] = _Table(paths[name], reader.channels[name], reader.units[name])
            stack.callback(tables[name].close)
        for batch in batches:
            tables[batch.channel].add(batch.rows)
            if progress is not None and task is not None:
                progress.update(task, completed=reader.position)
    if progress is not None and task is not None:
        progress.update(task, completed=reader.size)
    counts = {name: table.rows for name, table in tables.items()}
    return DumpResult(tuple(paths.values()), counts, reader.damage, reader.exit_code)


def _paths(folder: Path, channels: Collection[str]) -> dict[str, Path]:
    """A file name for each channel; a name that is no file name gets its number, so that none is met twice."""
    paths: dict[str, Path] = {}
    for number, name in enumerate(channels, 1):
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".")
        paths[name] = folder / (f"{name}.csv" if plain == name else f"{plain}_{number}.csv")
    return paths


class _Table:
    """One CSV file in the making."""

    def __init__(self, path: Path, dtype: np.dtype[np.void], units: dict[str, str]) -> None:
        self.rows = 0
        self._dtype, self._units = dtype, units
        self._columns: list[Column] | None = None
        self._waiting: list[Rows] = []
        self._waiting_rows = 0
        self._block = max(1, min(_BLOCK_ROWS, _BLOCK_BYTES // dtype.itemsize))
        self._file: BinaryIO = path.open("wb")

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
            self._file.close()

    def _write(self) -> None:
        rows = np.concatenate([np.empty(0, self._dtype), *self._waiting])
        if self._columns is None:
            self._columns = columns(self._dtype, self._units, rows)
            self._file.write(csv_text.header(self._columns))
        if len(rows):
            self._file.write(csv_text.block(self._columns, rows))
        self.rows += len(rows)
        self._waiting, self._waiting_rows = [], 0
