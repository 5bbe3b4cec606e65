"""Resamples every signal of a log at common instants of vehicle time, known filter delays removed.

Signals are interpolated linearly. A channel slower than the instants gets the interpolated value; a faster one gets the
mean of the interpolation over one period about the instant. A missing or unusable sample gives NaN.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from drivers.records import IMU, Rows
from onboard import config
from onboard.devices import si
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.export import opener
from onboard.ground.log.export.dump import DumpResult, begin
from onboard.ground.log.tables.columns import TIME_FIELD, TableColumn, time_columns
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.selection import Selection, inside
from onboard.ground.log.tables.vehicle_time import UNKNOWN, Timed, timed
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

_IMU_UNITS = (("gyro", "rad/s"), ("accel", "m/s^2"))
_MARGIN_NS = 100_000_000  # history kept: longest filter delay, half a period, a few samples
_LONGEST_HOLE = 2.5  # longest gap interpolated, sample periods


class Aligned(NamedTuple):
    """The table's columns and its rows, block by block."""

    columns: list[TableColumn]
    dtype: np.dtype[np.void]
    blocks: Iterator[Rows]


def aligned(tables: FlightTables, channels: Sequence[str] | None, rate_hz: float) -> Aligned:
    """Resample a flight.

    Args:
        tables: of a log, with its vehicle.
        channels: only these; None: every channel that carries a signal.
        rate_hz: rate of the instants, which are whole multiples of its period.

    Raises:
        ValueError: no vehicle is known, a channel that carries no signal, or a rate that is not positive.
    """
    log, vehicle = tables.log, tables.vehicle
    if vehicle is None:
        raise ValueError(f"{log.path}: which channels are signals is not known ({tables.why_none}); give --vehicle")
    if not 0.0 < rate_hz <= 1e6:
        raise ValueError(f"--aligned {rate_hz:g}: give a rate between 0 and 1e6 Hz")
    signals = roles_of(vehicle).signals
    every = [name for name in tables.clocked if name in signals]
    chosen = every if channels is None else list(channels)
    if unknown := sorted(set(chosen) - set(every)):
        raise ValueError(f"{log.path}: {', '.join(unknown)} cannot be resampled; signals are {', '.join(every)}")
    tracks = {name: _Track(signals[name], log.channels[name] == IMU) for name in chosen}
    frames = {name: tables.meanings[name].frame for name in chosen}
    names = [
        (f"{name}.{part}", unit)
        for name, track in tracks.items()
        for part, unit in track.parts(log, name, frames[name])
    ]
    dtype = np.dtype([(TIME_FIELD, "<i8"), *((f"c{number}", "<f8") for number in range(len(names)))])
    columns = [*time_columns(tables.times), TableColumn("vehicle_ns", "ns", lambda rows: rows[TIME_FIELD])]
    columns += [TableColumn(name, unit, _taker(f"c{number}")) for number, (name, unit) in enumerate(names)]
    return Aligned(columns, dtype, _blocks(log, vehicle, tracks, dtype, round(1e9 / rate_hz)))


def dump_aligned(
    log: FlightTables | LogReader | str | Path,
    target: str | Path | BinaryIO,
    rate_hz: float,
    selection: Selection = Selection(),  # noqa: B008  # frozen
    *,
    kind: str = "csv",
    force: bool = False,
    progress: Progress | None = None,
) -> DumpResult:
    """Write every signal at common instants of vehicle time into one table, ``target/aligned.kind`` or an open file.

    Args:
        log: a flight, with its vehicle file.
        target: as for :func:`dump`.
        rate_hz: rate of the instants.
        selection: channels and times.
        kind: format; an open file takes CSV only.
        force: as for :func:`dump`.
        progress: receives a task that counts the bytes of the log.

    Raises:
        ValueError: no vehicle is known, or a channel cannot be resampled, or the format cannot be had, or see
            :meth:`Selection.windows`.
        OSError: a file cannot be read or written.
    """
    make = opener(kind)
    tables = log if isinstance(log, FlightTables) else FlightTables(log)
    reader = tables.log
    found = aligned(tables, selection.channels, rate_hz)
    windows = tables.windows(selection)
    name = f"aligned.{kind}"
    if not isinstance(target, str | Path) and kind != "csv":
        raise ValueError(f"--to {kind} -: only csv goes into a pipe; give a directory")
    tell = follow(progress, "align", reader)
    count = 0
    with ExitStack() as stack:
        where: Path | BinaryIO
        if isinstance(target, str | Path):
            where = stack.enter_context(begin(Path(target), tables, {"aligned": name}, force=force)) / name
        else:
            where = target
        table = make(where, found.columns)
        stack.callback(table.close)
        table.write(np.zeros(0, found.dtype))  # the file is made even if no instant is inside
        for block in found.blocks:
            rows = block if windows is None else block[inside(block[TIME_FIELD], windows)]
            table.write(rows)
            count += len(rows)
            tell()
    files = (Path(target) / name,) if isinstance(target, str | Path) else ()
    return DumpResult(files, {"aligned": count}, reader.damage, reader.exit_code)


def _taker(field: str) -> Callable[[Rows], FloatArray]:
    return lambda rows: rows[field]


def _blocks(
    log: LogReader, vehicle: config.Vehicle, tracks: "dict[str, _Track]", dtype: np.dtype[np.void], period_ns: int
) -> Iterator[Rows]:
    next_ns: int | None = None
    for step in timed(log, vehicle, tracks):
        for samples in step.samples:
            tracks[samples.channel].add(samples)
        starts = [track.first_ns for track in tracks.values() if track.first_ns is not None]
        if next_ns is None and starts:
            next_ns = -(-min(starts) // period_ns) * period_ns
        if next_ns is None:
            continue
        margin_ns = _MARGIN_NS + period_ns
        at_ns = np.arange(next_ns, step.until_ns - margin_ns, period_ns, dtype=np.int64)
        if not len(at_ns):
            continue
        next_ns = int(at_ns[-1]) + period_ns
        rows = np.zeros(len(at_ns), dtype)
        rows[TIME_FIELD] = at_ns
        number = 0
        for track in tracks.values():
            for values in track.at(at_ns, period_ns).T:
                rows[f"c{number}"] = values
                number += 1
            track.forget(next_ns - margin_ns)
        yield rows


class _Track:
    """The newest samples of one channel."""

    def __init__(self, signal: SmoothedChannel, is_imu: bool) -> None:
        self._signal, self._is_imu = signal, is_imu
        self._columns = 6 if is_imu else 1
        self._time_ns = np.zeros(0, np.int64)
        self._values: FloatArray = np.zeros((0, self._columns))

    def parts(self, log: LogReader, name: str, frame: str) -> list[tuple[str, str]]:
        """Name and unit of each column."""
        if self._is_imu:
            return [(f"{what}_{frame}_{axis}", unit) for what, unit in _IMU_UNITS for axis in "xyz"]
        first = next((batch.rows for batch in log.batches([name])), None)
        return [("value", "" if first is None else printable(first["unit"][0]))]

    @property
    def first_ns(self) -> int | None:
        """Time of the oldest sample, ns; None if there is none."""
        return int(self._time_ns[0]) if len(self._time_ns) else None

    def add(self, samples: Timed) -> None:
        """Add samples; an unusable one becomes NaN."""
        known = samples.time_ns != UNKNOWN
        rows = samples.rows[known]
        values = si.imu(rows, self._signal) if self._is_imu else si.scalar(rows, self._signal)[:, None]
        values[~si.usable(rows)] = np.nan
        self._time_ns = np.concatenate([self._time_ns, samples.time_ns[known]])
        self._values = np.concatenate([self._values, values])

    def forget(self, before_ns: int) -> None:
        """Drop older samples but the last one before ``before_ns``."""
        first = max(0, int(np.searchsorted(self._time_ns, before_ns)) - 1)
        self._time_ns, self._values = self._time_ns[first:], self._values[first:]

    def at(self, at_ns: NDArray[np.int64], period_ns: int) -> FloatArray:
        """Values (n, columns) at ``at_ns`` (n,)."""
        delays_s = self._signal.delays_s * (self._columns if len(self._signal.delays_s) == 1 else 1)
        out: FloatArray = np.full((len(at_ns), self._columns), np.nan)
        if len(self._time_ns) < 2:
            return out
        widest_ns = _LONGEST_HOLE * self._signal.period_s * 1e9
        for delay_s in set(delays_s):
            mine = [column for column, delay in enumerate(delays_s) if delay == delay_s]
            line = _Line(self._time_ns - round(delay_s * 1e9), self._values[:, mine], widest_ns)
            faster = self._signal.period_s * 1e9 < period_ns
            out[:, mine] = line.means(at_ns, period_ns) if faster else line.values(at_ns)
        return out


class _Line:
    """Linear interpolation; NaN next to an unusable sample and across a gap."""

    def __init__(self, time_ns: NDArray[np.int64], values: FloatArray, widest_ns: float) -> None:
        self._time_ns = np.maximum.accumulate(time_ns)
        self._step_ns = np.diff(self._time_ns)
        self._broken = np.isnan(values[1:] + values[:-1]) | (self._step_ns > widest_ns)[:, None]
        self._known = np.where(np.isnan(values), 0.0, values)
        areas = 0.5 * (self._known[1:] + self._known[:-1]) * self._step_ns[:, None]
        zero = np.zeros((1, values.shape[1]))
        self._area = np.concatenate([zero, np.cumsum(areas, axis=0)])
        self._breaks = np.concatenate([zero, np.cumsum(self._broken, axis=0)])

    def _at(self, at_ns: NDArray[np.int64]) -> tuple[NDArray[np.intp], FloatArray, FloatArray, NDArray[np.bool_]]:
        """Index of the segment, time into it (n, 1), value (n, columns), and whether it is valid."""
        piece = np.clip(np.searchsorted(self._time_ns, at_ns, side="right") - 1, 0, len(self._step_ns) - 1)
        since = (at_ns - self._time_ns[piece]).astype(np.float64)[:, None]
        rise = (self._known[piece + 1] - self._known[piece]) / np.maximum(self._step_ns[piece], 1)[:, None]
        inside = (at_ns >= self._time_ns[0]) & (at_ns <= self._time_ns[-1])
        return piece, since, self._known[piece] + rise * since, inside

    def values(self, at_ns: NDArray[np.int64]) -> FloatArray:
        """Values (n, columns) at ``at_ns`` (n,)."""
        piece, _, value, inside = self._at(at_ns)
        return np.where(inside[:, None] & ~self._broken[piece], value, np.nan)

    def means(self, at_ns: NDArray[np.int64], width_ns: int) -> FloatArray:
        """Means (n, columns) over ``width_ns`` about ``at_ns`` (n,)."""
        ends = []
        for at in (at_ns - width_ns // 2, at_ns + width_ns - width_ns // 2):
            piece, since, value, inside = self._at(at)
            ends.append((self._area[piece] + 0.5 * (self._known[piece] + value) * since, piece, inside))
        (low, first, low_inside), (high, last, high_inside) = ends
        whole = (self._breaks[last + 1] == self._breaks[first]) & (low_inside & high_inside)[:, None]
        return np.where(whole, (high - low) / width_ns, np.nan)
