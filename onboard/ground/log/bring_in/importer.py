"""Converts foreign recordings to logs by a mapping file.

``host_ns`` is the recording's clock, here the time of the sample. ``tick`` numbers the samples. The conversion is
deterministic to the byte.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.progress import Progress

from drivers import records
from drivers.records import Rows, Severity
from onboard.ground.log.bring_in import channel_rows, foreign, mapping
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.mapping import ImuChannel, Mapping, MappingFile
from onboard.ground.log.bring_in.text_rows import Recording
from onboard.ground.log.tables.progress import reporter
from onboard.recording.writer import LogWriter

MAPPING_ATTACHMENT = "mapping.toml"
IMPORT_METADATA = "import"
EVENT_CHANNEL = "import_event"

_NOT_RECORDED = {"imu": ("temperature_raw", "filter_code", "sync"), "scalar": ("sync_counter", "device_status")}
_BLOCK_ROWS = 256  # rows per channel before the next channel's rows follow


class ImportedLog(NamedTuple):
    """A log made by the import: path, source, number of rows, and what was left out, in words."""

    path: Path
    source: Path
    rows: int
    left_out: tuple[str, ...] = ()


def import_recordings(
    mapping_name: str | Path, source: Path, directory: Path, *, progress: Progress | None = None
) -> list[ImportedLog]:
    """Make a log of ``source``, or of each recording in it if it is a directory, named like the recording.

    Args:
        mapping_name: name of a packaged mapping, or path of a mapping file.
        source: a recording, or a directory of them.
        directory: where the logs go; created if missing. Logs of the same names are replaced.
        progress: receives a task that counts the recordings.

    Raises:
        MappingError: the mapping cannot be used.
        SourceError: a recording does not match the mapping.
        OSError: a file cannot be read or written.
    """
    chosen = mapping.load(mapping_name)
    sources = _sources(source, chosen.file.mapping.format)
    directory.mkdir(parents=True, exist_ok=True)
    tell, logs = reporter(progress, f"import {source.name}", len(sources)), list[ImportedLog]()
    for one in sources:
        logs.append(_import(chosen, one, directory / f"{one.stem}.mcap"))
        tell(len(logs))
    return logs


def _sources(source: Path, suffix: str) -> list[Path]:
    if not source.is_dir() or (suffix == "bag" and foreign.is_bag_directory(source)):
        return [source]
    suffix = {"ulog": "ulg"}.get(suffix, suffix)
    found = sorted(source.glob(f"*.{suffix}"))
    if not found:
        raise SourceError(f"{source} holds no .{suffix} file, which is what the mapping reads; give another directory")
    return found


def _import(chosen: Mapping, source: Path, log: Path) -> ImportedLog:
    files: dict[Path, Recording] = {}
    channels: dict[str, Rows] = {}
    told: list[str] = []  # of what was left out
    skipped: dict[str, int] = {}  # rows by channel
    skip, wanted = chosen.file.mapping.bad_rows == "skip", _columns(chosen.file)
    for name, channel in chosen.file.channel.items():
        path = source if channel.file is None else source.parent / channel.file
        if path not in files:
            files[path] = foreign.read(path, chosen.file.csv, chosen.file.mapping.format, skip=skip, names=wanted)
            told += _of_file(path, files[path])
        columns, time = files[path].columns, channel.time or chosen.file.time
        if skip:
            columns, skipped[name] = channel_rows.without_bad_rows(path, columns, channel, time)
        host_ns = channel_rows.times_ns(path, columns, time, channel_rows.columns_of(channel)[0])
        if isinstance(channel, ImuChannel):
            channels[name] = channel_rows.imu(path, columns, channel, host_ns)
        else:
            channels[name] = channel_rows.scalar(path, columns, channel, host_ns)
    for count in sorted(set(skipped.values()) - {0}):
        names = ", ".join(name for name, own in skipped.items() if own == count)
        told.append(f"{count} rows left out: a cell that is no number, or a time that does not rise: {names}")
    unfinished = log.with_name(f".{log.name}.unfinished")
    try:
        _write(chosen, files, unfinished, channels, told)
        unfinished.replace(log)  # an earlier log of this name stays as it is until this one is whole
    finally:
        unfinished.unlink(missing_ok=True)
    return ImportedLog(log, source, sum(map(len, channels.values())), tuple(told))


def _columns(file: MappingFile) -> set[str]:
    """All that the mapping names."""
    times = [file.time, *(channel.time for channel in file.channel.values() if channel.time is not None)]
    named = {time.column for time in times if time.column is not None}
    return named.union(*(channel_rows.columns_of(channel) for channel in file.channel.values()))


def _sha256(path: Path) -> str:
    """Of a file, or of all files of a directory in the order of their names."""
    parts = sorted(path.iterdir()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.read_bytes())
    return digest.hexdigest()


def _of_file(path: Path, one: Recording) -> Iterator[str]:
    if one.truncated:
        yield f"{path.name}: {one.truncated}"
    if one.ragged:
        yield f"{path.name}: {one.ragged} rows left out: another number of cells than the others"


def _write(chosen: Mapping, files: Iterable[Path], log: Path, channels: dict[str, Rows], told: Sequence[str]) -> None:
    with LogWriter.create(log, overwrite=True) as writer:
        facts = {
            "source": ", ".join(path.name for path in files),
            "sha256": ", ".join(_sha256(path) for path in files),
            "mapping": chosen.file.mapping.name,
            "host_ns": "the recording's clock",
            "not_recorded": ", ".join(_absent(chosen)),
        }
        writer.add_metadata(IMPORT_METADATA, facts)
        writer.attach(MAPPING_ATTACHMENT, "application/toml", chosen.text.encode())
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
        _write_by_time(writer, channels)
        said = [_event(0, "truncated" if "cut off" in text else "bad_rows", text) for text in told]
        said += _pauses(channels)
        writer.register(EVENT_CHANNEL, records.EVENT)
        for number, rows in enumerate(said):
            rows["sequence"] = number
            writer.write(EVENT_CHANNEL, rows)


def _absent(chosen: Mapping) -> list[str]:
    """Fields that the recording lacks; they are 0 in every row."""
    channels = chosen.file.channel.items()
    return [f"{name}.{field}" for name, channel in channels for field in _NOT_RECORDED[channel.record]]


def _write_by_time(writer: LogWriter, channels: dict[str, Rows]) -> None:
    edges = np.unique(np.concatenate([rows["host_ns"][::_BLOCK_ROWS] for rows in channels.values()]))
    edges = np.concatenate([edges, [np.iinfo(np.int64).max]])
    cuts = {name: np.searchsorted(rows["host_ns"], edges) for name, rows in channels.items()}
    for block in range(len(edges) - 1):
        for name, rows in channels.items():
            part = rows[cuts[name][block] : cuts[name][block + 1]]
            if len(part):
                writer.write(name, part)


def _pauses(channels: dict[str, Rows]) -> Iterator[Rows]:
    """An event for each channel whose times show pauses: the recorder may have lost samples."""
    for name, rows in channels.items():
        steps = np.diff(rows["host_ns"])
        pauses = np.flatnonzero(steps > 1.5 * np.median(steps)) if len(steps) else steps
        if len(pauses):
            longest = int(pauses[np.argmax(steps[pauses])])
            text = (
                f"{name}: {len(pauses)} intervals are longer than 1.5 times the median, the longest "
                f"{steps[longest] * 1e-6:.3f} ms after sample {longest}; samples may be missing"
            )
            yield _event(int(rows["host_ns"][pauses[0]]), "pauses", text)


def _event(at_ns: int, code: str, text: str) -> Rows:
    return records.event(at_ns, Severity.WARNING, code, "import", text).rows
