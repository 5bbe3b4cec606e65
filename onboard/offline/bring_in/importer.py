"""Converts foreign recordings to logs by a mapping file.

``host_ns`` is the recording's own clock, here the time of the sample. ``tick`` numbers the samples. The conversion is
deterministic to the byte.
"""

import hashlib
from collections.abc import Iterator
from collections.abc import Mapping as Columns
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from drivers import records
from drivers.records import Rows, SampleStatus, Severity
from onboard.offline.bring_in import foreign, mapping
from onboard.offline.bring_in.errors import SourceError
from onboard.offline.bring_in.foreign import Values
from onboard.offline.bring_in.mapping import NS_PER, ImuChannel, Mapping, Scalar, ScalarChannel, Time, VectorMapping
from onboard.recording.decode import FARTHEST_NS
from onboard.recording.writer import LogWriter

MAPPING_ATTACHMENT = "mapping.toml"
IMPORT_METADATA = "import"
EVENT_CHANNEL = "import_event"

_BLOCK_ROWS = 256  # rows per channel before the next channel's rows follow
_MOST_ROUNDED = 0.1  # rms of what rounding takes away, of the rms of the values
_HUGE = 2.0**62  # larger values are refused: they may overflow int64
_RAILS = np.iinfo(np.int16)


class ImportedLog(NamedTuple):
    """A log made by the import: path, source, number of rows."""

    path: Path
    source: Path
    rows: int


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
    task = None if progress is None else progress.add_task(f"import {source.name}", total=len(sources))
    logs = []
    for one in sources:
        logs.append(_import(chosen, one, directory / f"{one.stem}.mcap"))
        if progress is not None and task is not None:
            progress.advance(task)
    return logs


def _sources(source: Path, suffix: str) -> list[Path]:
    if not source.is_dir():
        return [source]
    found = sorted(source.glob(f"*.{suffix}"))
    if not found:
        raise SourceError(f"{source} holds no .{suffix} file, which is what the mapping reads; give another directory")
    return found


def _import(chosen: Mapping, source: Path, log: Path) -> ImportedLog:
    files: dict[Path, foreign.Recording] = {}
    channels: dict[str, Rows] = {}
    for name, channel in chosen.file.channel.items():
        path = source if channel.file is None else source.parent / channel.file
        if path not in files:
            files[path] = foreign.read(path, chosen.file.csv, chosen.file.mapping.format)
        columns = files[path].columns
        host_ns = _host_ns(path, columns, channel.time or chosen.file.time, _first_column(channel))
        channels[name] = (
            _imu(path, columns, channel, host_ns)
            if isinstance(channel, ImuChannel)
            else _scalar(path, columns, channel, host_ns)
        )
    unfinished = log.with_name(f".{log.name}.unfinished")
    try:
        _write(chosen, files, unfinished, channels)
        unfinished.replace(log)  # an earlier log of this name stays as it is until this one is whole
    finally:
        unfinished.unlink(missing_ok=True)
    return ImportedLog(log, source, sum(map(len, channels.values())))


def _write(chosen: Mapping, files: dict[Path, foreign.Recording], log: Path, channels: dict[str, Rows]) -> None:
    with LogWriter.create(log, overwrite=True) as writer:
        facts = {
            "source": ", ".join(path.name for path in files),
            "sha256": ", ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in files),
            "mapping": chosen.file.mapping.name,
            "host_ns": "the recording's own clock",
            "not_recorded": ", ".join(_absent(chosen)),
        }
        writer.add_metadata(IMPORT_METADATA, facts)
        writer.attach(MAPPING_ATTACHMENT, "application/toml", chosen.text.encode())
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
        _write_by_time(writer, channels)
        said = [_event(0, "truncated", f"{path.name}: {one.truncated}") for path, one in files.items() if one.truncated]
        said += _pauses(channels)
        writer.register(EVENT_CHANNEL, records.EVENT)
        for number, rows in enumerate(said):
            rows["sequence"] = number
            writer.write(EVENT_CHANNEL, rows)


def _absent(chosen: Mapping) -> list[str]:
    """Fields that the recording lacks; they are 0 in every row."""
    return [
        f"{name}.{field}"
        for name, channel in chosen.file.channel.items()
        for field in (
            ("temperature_raw", "filter_code", "sync")
            if isinstance(channel, ImuChannel)
            else ("sync_counter", "device_status")
        )
    ]


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


def _first_column(channel: ImuChannel | ScalarChannel) -> str:
    """A column that has a value for every sample."""
    if isinstance(channel, ScalarChannel):
        return next(iter(channel.value.terms))
    return channel.gyro.column or (channel.gyro.columns or ("",))[0]


def _host_ns(source: Path, columns: Columns[str, Values], time: Time, sampled: str) -> NDArray[np.int64]:
    """Times (n,) of the samples, ns; evenly spaced by the number of ``sampled`` if the recording has none."""
    if time.column is None:
        assert time.rate_Hz is not None
        count = foreign.length(columns, sampled)  # a missing column is reported when its values are read
        start_ns = time.offset * NS_PER[time.unit]
        return np.asarray(np.rint(start_ns + np.arange(count) * (1e9 / time.rate_Hz)), np.int64)
    values = foreign.numbers(source, columns, time.column)
    per_unit = NS_PER[time.unit]
    approximate = (values.astype(np.float64) + time.offset) * per_unit
    if (bad := ~((approximate >= 0) & (approximate < _HUGE))).any():
        raise SourceError(
            f"{source}: {time.column!r} is no time from 0 on in row {_first(bad)}; remove the row, or give an offset"
        )
    if values.dtype.kind == "f":
        host_ns = np.rint(approximate).astype(np.int64)
    else:
        host_ns = values.astype(np.int64) * per_unit + round(time.offset * per_unit)
    if (back := np.diff(host_ns) <= 0).any():
        raise SourceError(f"{source}: {time.column!r} does not increase after row {_first(back)}; sort the recording")
    if (far := np.diff(host_ns) > FARTHEST_NS).any():
        raise SourceError(f"{source}: {time.column!r} jumps by years after row {_first(far)}; correct its unit")
    return host_ns


def _first(bad: NDArray[np.bool_]) -> int:
    """Number of the first row of ``bad`` (n, ...), counted from 1, that is true anywhere."""
    return int(np.argmax(bad.reshape(len(bad), -1).any(axis=1))) + 1


def _rows(host_ns: NDArray[np.int64], dtype: np.dtype[np.void]) -> Rows:
    rows = np.zeros(len(host_ns), dtype)
    rows["host_ns"] = host_ns
    rows["sequence"] = rows["tick"] = np.arange(len(host_ns))
    return rows


def _imu(source: Path, columns: Columns[str, Values], channel: ImuChannel, host_ns: NDArray[np.int64]) -> Rows:
    rows = _rows(host_ns, records.IMU)
    for name, vector in (("accel", channel.accel), ("gyro", channel.gyro)):
        counts = _vector_counts(source, columns, vector, len(rows))
        railed = ((counts <= _RAILS.min) | (counts >= _RAILS.max)).any(axis=1)
        signs = np.array([1 if axis[0] == "+" else -1 for axis in vector.axes])
        turned = counts[:, ["xyz".index(axis[1]) for axis in vector.axes]] * signs
        rows[f"{name}_raw"] = np.clip(turned, _RAILS.min, _RAILS.max)  # -(-32768) is not an int16: clipped to the limit
        rows["status"][railed] = SampleStatus.SATURATED
    rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = channel.accel.si_count, channel.gyro.si_count
    return rows


def _vector_counts(source: Path, columns: Columns[str, Values], vector: VectorMapping, count: int) -> NDArray[np.int64]:
    """Counts (n, 3) in the recorded axes, within int16."""
    if vector.columns is None:
        assert vector.column is not None
        names = vector.column
        values = foreign.numbers(source, columns, names, 3)
    else:
        names = ", ".join(vector.columns)
        values = np.stack([foreign.numbers(source, columns, name) for name in vector.columns], axis=1)
    counts = _counts(source, names, vector, values, count)
    if (beyond := (counts < _RAILS.min) | (counts > _RAILS.max)).any():
        raise SourceError(
            f"{source}: {names!r} does not fit 16 bits in row {_first(beyond)}; give the mapping a larger scale"
        )
    return counts


def _scalar(source: Path, columns: Columns[str, Values], channel: ScalarChannel, host_ns: NDArray[np.int64]) -> Rows:
    rows = _rows(host_ns, records.SCALAR)
    value = channel.value
    parts = {name: foreign.numbers(source, columns, name) for name in value.terms}
    lengths = {name: len(part) for name, part in parts.items()}
    if len(set(lengths.values())) > 1:
        raise SourceError(f"{source}: columns of a sum differ in length: {lengths}; they must be of the same samples")
    names = " + ".join(parts)
    values: Values = next(iter(parts.values()))
    if value.sum is not None:
        values = np.column_stack(list(parts.values())).astype(np.float64) @ np.array(list(value.sum.values()))
    counts = _counts(source, names, value, values, len(rows))
    rows["value_raw"] = counts if value.sign == "+" else -counts
    rows["scale"] = value.si_count
    rows["unit"] = value.si_unit.encode()
    return rows


def _counts(
    source: Path, names: str, quantity: VectorMapping | Scalar, values: Values, count: int
) -> NDArray[np.int64]:
    """``values`` as whole counts."""
    if len(values) != count:
        raise SourceError(
            f"{source}: {names!r} has {len(values)} rows and its time column {count}; name the time it goes with"
        )
    if quantity.values == "counts" and values.dtype.kind in "iu":
        return values.astype(np.int64)
    exact = values.astype(np.float64)
    if quantity.values == "physical":
        exact /= quantity.count
    counts = np.rint(exact)
    if (bad := ~(np.abs(counts) < _HUGE)).any():
        raise SourceError(f"{source}: {names!r} is no usable number in row {_first(bad)}; remove the row")
    lost, size = (float(np.sqrt(np.mean(x**2))) if x.size else 0.0 for x in (exact - counts, exact))
    if quantity.values == "physical" and lost > _MOST_ROUNDED * size:
        kept = f"counts of {quantity.count:g} {quantity.unit} leave {1.0 - lost / size:.0%} of {names!r}"
        raise SourceError(f"{source}: {kept}; give the mapping a smaller scale in the table that names this column")
    if quantity.values == "counts" and (bad := counts != exact).any():
        raise SourceError(
            f'{source}: {names!r} is no whole count in row {_first(bad)}; say values = "physical" in the mapping'
        )
    return counts.astype(np.int64)
