"""Writes a log as tables for other programs: one file per channel, raw counts, SI values or both.

Memory does not grow with the log: CSV and Parquet are written directly; NPZ and MAT-files, which need the length of a
column first, through temporary files beside the target.
"""

import re
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import numpy as np
from rich.progress import Progress

from drivers.records import Rows
from onboard.ground.log.export import TableWriter, legend, opener
from onboard.ground.log.tables.columns import TableColumn
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.progress import reporter
from onboard.ground.log.tables.selection import Selection
from onboard.recording.format.scan import Damage
from onboard.recording.reader import LogReader
from onboard.recording.space import naming

_BLOCK_ROWS = 16384
_BLOCK_BYTES = 4 << 20

ValueKind = Literal["both", "raw", "si"]
Opener = Callable[[Path | BinaryIO, Sequence[TableColumn]], TableWriter]


class DumpResult(NamedTuple):
    """Result of a dump: files in the order of the channels, rows by channel, damage of the log."""

    files: tuple[Path, ...]
    rows: dict[str, int]
    damage: tuple[Damage, ...]
    exit_code: int


def dump(
    log: FlightTables | LogReader | str | Path,
    target: str | Path | BinaryIO,
    selection: Selection = Selection(),  # noqa: B008  # frozen
    *,
    kind: str = "csv",
    values: ValueKind = "both",
    force: bool = False,
    progress: Progress | None = None,
) -> DumpResult:
    """Write each channel of ``log`` to ``target/CHANNEL.kind`` with a legend, or one channel to an open file.

    Args:
        log: the log, or its path.
        target: a directory, made if need be; or a binary file to write the CSV of the one selected channel to.
        selection: part of the log.
        kind: format, one of ``onboard.ground.log.export.FORMATS``.
        values: raw counts and all that was recorded, SI (without the counts and scales that it is made of), or both;
            what only replay needs is in the raw ones alone.
        force: replace files of the same names.
        progress: receives a task that counts the bytes of the log.

    Raises:
        LogFormatError: ``log`` is not a heft log.
        ChannelError: it has no such channel.
        FileExistsError: there is such a file already, and ``force`` was not asked for.
        ValueError: the selection or the format is not available.
        OSError: a file cannot be read or written.
    """
    make = opener(kind)
    tables = log if isinstance(log, FlightTables) else FlightTables(log)
    reader = tables.log
    chosen = _channels(tables, selection, values)
    batches = tables.batches(chosen, tables.windows(selection))
    files: dict[str, str] = {}
    if isinstance(target, str | Path):
        files = _files(chosen, kind)
    elif len(chosen) != 1 or kind != "csv":
        raise ValueError(f"a single CSV goes into a pipe: say which with --channel; the log has {', '.join(chosen)}")
    passes = 1 + bool(tables.clocked and set(chosen) - set(tables.clocked))
    tell = reporter(progress, f"dump {reader.path.name}", passes * reader.size)
    pending: dict[str, _Pending] = {}
    done = 0
    with ExitStack() as stack:
        if isinstance(target, str | Path):
            made = stack.enter_context(begin(Path(target), tables, files, force=force))
        for name in chosen:
            where = made / files[name] if isinstance(target, str | Path) else target
            pending[name] = _Pending(make, where, tables, name, values)
            stack.push(pending[name].close)
        for channel, rows in batches:
            pending[channel].add(rows)
            done = max(done, reader.position + (reader.size if passes > 1 and channel in tables.clocked else 0))
            tell(done)
    tell(passes * reader.size)
    counts = {name: table.rows for name, table in pending.items()}
    paths = tuple(Path(target) / file for file in files.values()) if isinstance(target, str | Path) else ()
    return DumpResult(paths, counts, reader.damage, reader.exit_code)


@contextmanager
def begin(folder: Path, tables: FlightTables, files: dict[str, str], *, force: bool) -> Iterator[Path]:
    """A directory inside ``folder`` for ``files`` by channel; they move to ``folder`` when all are written.

    The legend is added. If writing fails, ``folder`` keeps the files that it had.

    Raises:
        FileExistsError: one of them is there, and ``force`` was not asked for.
        OSError: they cannot be written; the error names ``folder``.
    """
    there = [name for name in [*files.values(), legend.FILE] if (folder / name).exists()]
    if there and not force:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise FileExistsError(
            f"{folder / there[0]}{more} would be written over; name another directory, or add --force"
        )
    folder.mkdir(parents=True, exist_ok=True)
    with naming(folder), tempfile.TemporaryDirectory(dir=folder, prefix=".unfinished-") as made:
        (Path(made) / legend.FILE).write_text(legend.legend(tables, files), encoding="utf-8")
        yield Path(made)
        for name in [*files.values(), legend.FILE]:
            (Path(made) / name).replace(folder / name)


def _channels(tables: FlightTables, selection: Selection, values: ValueKind) -> list[str]:
    """Those asked for; of all of them, not such as only replay needs, unless the raw values are asked for."""
    every = tables.log.channels
    wanted = selection.channels
    if wanted is not None:
        return [name for name in every if name in wanted] + [name for name in wanted if name not in every]
    return [n for n, dtype in every.items() if values == "raw" or set(dtype.names or ()) - tables.meanings[n].scratch]


def _files(channels: Collection[str], kind: str) -> dict[str, str]:
    """A unique file name for each channel; a name unfit for a file is replaced by its number."""
    files: dict[str, str] = {}
    for number, name in enumerate(channels, 1):
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".")
        stem = name if plain == name else f"{plain}_{number}"
        while f"{stem}.{kind}" in files.values() or (stem != name and stem in channels):
            stem += "_"
        files[name] = f"{stem}.{kind}"
    return files


def chosen_columns(every: Sequence[TableColumn], values: ValueKind, scratch: Collection[str] = ()) -> list[TableColumn]:
    """Those of ``every`` that ``values`` asks for; ``scratch``: fields that only the raw values have."""
    if values == "raw":
        return [column for column in every if not column.converted]
    every = [column for column in every if column.field not in scratch]
    if values == "si":
        made_of = {name for column in every for name in column.made_of}
        return [column for column in every if column.name not in made_of]
    return list(every)


class _Pending:
    """Buffer that joins a channel's rows into blocks for its table."""

    def __init__(
        self, make: Opener, target: Path | BinaryIO, tables: FlightTables, channel: str, values: ValueKind
    ) -> None:
        self.rows = 0
        self._make, self._target, self._values = make, target, values
        self._tables, self._channel = tables, channel
        self._table: TableWriter | None = None
        self._waiting: list[Rows] = []
        self._waiting_rows = 0
        self._block = max(1, min(_BLOCK_ROWS, _BLOCK_BYTES // tables.log.channels[channel].itemsize))

    def add(self, rows: Rows) -> None:
        """Add rows (n,) of the channel."""
        self._waiting.append(rows)
        self._waiting_rows += len(rows)
        if self._waiting_rows >= self._block:
            self._write()

    def close(self, error: type[BaseException] | None, *_: object) -> None:
        """Write the buffered rows, unless another table could not be written, and close."""
        try:
            if error is None:
                self._write()
        finally:
            if self._table is not None:
                self._table.close()

    def _write(self) -> None:
        rows = np.concatenate([self._tables.empty(self._channel), *self._waiting])
        if self._table is None:
            every = self._tables.columns(self._channel, rows)
            scratch = self._tables.meanings[self._channel].scratch
            self._table = self._make(self._target, chosen_columns(every, self._values, scratch))
        self._table.write(rows)
        self.rows += len(rows)
        self._waiting, self._waiting_rows = [], 0
