"""A log for notebooks: channels by name, onboard estimates and events, signals on one time base.

A table in memory, for NumPy, pandas and xarray. pandas and xarray are imported when they are asked for.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from drivers.records import EVENT, GAP, Rows
from onboard import channels, config
from onboard.ground.identify.replay.replay import Reestimate, Replay, reestimate, replay
from onboard.ground.log.export.aligned import aligned
from onboard.ground.log.export.dump import chosen_columns
from onboard.ground.log.tables.columns import TIME_FIELD, TableColumn, Times, Values, columns, with_times
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.vehicle_time import UNKNOWN
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.scan import Damage

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
_INDEX = frozenset({"time_s", "utc"})  # of the tables, whose index the time is
_BOOKKEEPING = frozenset({"sequence", "host_ns", "tick", "vehicle_ns"})


class ChannelTable(NamedTuple):
    """Columns of one length, and when each row is from.

    Attributes:
        name: of the channel, or what was asked for.
        columns: arrays (n,) by name; a name ends with the unit where ``units`` does not say it.
        units: unit by column; columns without one are left out.
        vehicle_ns: (n,) vehicle time; ``UNKNOWN`` (NumPy's NaT) where the sample's clock never was known.
        times: where the log's times begin, and what UTC is.
        frame: of the URDF, in whose axes vectors are; empty where there is none.
    """

    name: str
    columns: Mapping[str, Values]
    units: Mapping[str, str]
    vehicle_ns: NDArray[np.int64]
    times: Times
    frame: str = ""

    @classmethod
    def of(cls, name: str, columns: Sequence[TableColumn], rows: Rows, times: Times, frame: str = "") -> "ChannelTable":
        """From rows with times (n,) and the columns that show them."""
        values = {column.name: _readable(column.values(rows)) for column in columns}
        units = {column.name: column.unit for column in columns if column.unit}
        return cls(name, values, units, rows[TIME_FIELD].astype(np.int64), times, frame)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(n,) s since the log's first record; NaN where it is not known."""
        since = np.where(self.vehicle_ns == UNKNOWN, np.nan, (self.vehicle_ns - self.times.start_ns) * 1e-9)
        return np.asarray(since, np.float64)

    @property
    def utc(self) -> NDArray[np.datetime64] | None:
        """(n,) datetime64[ns]; None where the log knows no wall clock."""
        if self.times.utc_offset_ns is None:
            return None
        known = self.vehicle_ns != UNKNOWN
        return np.where(known, self.vehicle_ns + self.times.utc_offset_ns, UNKNOWN).view("M8[ns]")

    def to_numpy(self) -> Rows:
        """A structured array (n,): ``time_s``, ``utc`` where it is known, and the columns by name."""
        utc = {} if self.utc is None else {"utc": self.utc}
        every = {"time_s": self.time_s, **utc, **self.columns}
        made = np.empty(len(self.vehicle_ns), [(name, values.dtype) for name, values in every.items()])
        for name, values in every.items():
            made[name] = values
        return made

    def to_pandas(self) -> "pd.DataFrame":
        """A data frame, indexed by UTC, or by the time since the log's first record where it knows no wall clock.

        ``attrs`` holds ``units``, ``frame`` and ``name``.

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError(f"data frames need pandas ({error}): pip install pandas") from error
        utc = self.utc
        index = (
            pd.TimedeltaIndex(self._since_start(), name="time")
            if utc is None
            else pd.DatetimeIndex(utc, name="utc").tz_localize("UTC")
        )
        frame = pd.DataFrame(dict(self.columns), index=index)
        frame.attrs |= {"name": self.name, "units": dict(self.units), "frame": self.frame}
        return frame

    def to_xarray(self) -> "xr.Dataset":
        """A dataset along ``time``: datetime64[ns] in UTC, or timedelta64[ns] where the log knows no wall clock.

        Each variable has its ``units``; the dataset ``frame`` and ``name``.

        Raises:
            ImportError: xarray is not installed.
        """
        try:
            import xarray as xr
        except ImportError as error:
            raise ImportError(f"datasets need xarray ({error}): pip install xarray") from error
        variables = {
            name: ("time", values, {"units": self.units[name]} if name in self.units else {})
            for name, values in self.columns.items()
        }
        utc = self.utc
        coordinates = {"time": self._since_start() if utc is None else utc}
        return xr.Dataset(variables, coordinates, {"name": self.name, "frame": self.frame})

    def _since_start(self) -> NDArray[np.timedelta64]:
        known = self.vehicle_ns != UNKNOWN
        return np.where(known, self.vehicle_ns - self.times.start_ns, UNKNOWN).view("m8[ns]")


def _readable(values: Values) -> Values:
    """Text as str, which NumPy keeps as fixed bytes in records; numbers as they are."""
    if values.dtype.kind != "S":
        return np.ascontiguousarray(values)
    distinct, which = np.unique(values, return_inverse=True)
    texts = np.array([bytes(text).decode(errors="backslashreplace") for text in distinct], np.str_)
    return texts[which]


if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class LogChannel:
    """One channel of a log; rows are read when a table is asked for.

    Attributes:
        name: of the channel.
        measures: what it measures, in words; empty where the vehicle file does not say.
        frame: of the URDF, in whose axes vectors are; empty where there is none.
        dtype: of the rows as recorded.
    """

    def __init__(self, log: "FlightLog", name: str) -> None:
        self._log, self.name = log, name
        meaning = log.tables.meanings[name]
        self.measures, self.frame = meaning.measures, meaning.frame
        self.dtype: np.dtype[np.void] = log.tables.log.channels[name]

    def __repr__(self) -> str:
        about = f": {self.measures}" if self.measures else ""
        return f"<LogChannel {self.name}{about}>"

    @property
    def rows(self) -> Rows:
        """The rows (n,) as recorded, in the order of the file."""
        return self._log.tables.log.read(self.name)

    def table(self, *, raw: bool = False) -> ChannelTable:
        """All rows.

        Args:
            raw: every field as recorded; else SI, zero counts taken off, without numbering and what only replay needs.
        """
        rows = self._log.with_times(self.name, self.rows)
        every = self._log.tables.columns(self.name, rows)
        chosen = chosen_columns(every, "raw" if raw else "si", self._log.tables.meanings[self.name].scratch)
        left_out = _INDEX if raw else _INDEX | _BOOKKEEPING
        shown = [column for column in chosen if column.name not in left_out]
        return ChannelTable.of(self.name, shown, rows, self._log.tables.times, self.frame)

    def to_numpy(self, *, raw: bool = False) -> Rows:
        """See :meth:`ChannelTable.to_numpy`."""
        return self.table(raw=raw).to_numpy()

    def to_pandas(self, *, raw: bool = False) -> "pd.DataFrame":
        """See :meth:`ChannelTable.to_pandas`."""
        return self.table(raw=raw).to_pandas()

    def to_xarray(self, *, raw: bool = False) -> "xr.Dataset":
        """See :meth:`ChannelTable.to_xarray`."""
        return self.table(raw=raw).to_xarray()


class FlightLog:
    """A log; ``log["imu_base"]`` is a channel. Made by :func:`open_log`.

    Attributes:
        tables: what the tables are made by.
    """

    def __init__(self, tables: FlightTables) -> None:
        self.tables = tables

    def __repr__(self) -> str:
        who = self.vehicle.file.vehicle.name if self.vehicle else "no vehicle"
        return f"<FlightLog {self.path.name}: {who}; {', '.join(self)}>"

    def __getitem__(self, name: str) -> LogChannel:
        if name not in self.tables.log.channels:
            raise ChannelError(f"{self.path} has no channel {name!r}; it has {', '.join(self)}")
        return LogChannel(self, name)

    def __contains__(self, name: object) -> bool:
        return name in self.tables.log.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables.log.channels)

    def __len__(self) -> int:
        return len(self.tables.log.channels)

    @property
    def path(self) -> Path:
        """Of the log."""
        return self.tables.log.path

    @property
    def channels(self) -> Mapping[str, LogChannel]:
        """By name, in the order of the log."""
        return {name: self[name] for name in self}

    @property
    def vehicle(self) -> config.Vehicle | None:
        """That flew; None where none is known."""
        return self.tables.vehicle

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Who flew, which versions, which clocks."""
        return self.tables.log.metadata

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What of the log could not be read; empty for a whole one."""
        return self.tables.log.damage

    @property
    def estimates(self) -> ChannelTable:
        """Every quantity as the flight reported it, from when the data first supported it: value, interval, unit.

        The numbers are NaN, and ``supported`` is 0, where it was withdrawn.
        """
        known = self.tables.log.channels.values()
        dtype = next((one for one in known if channels.is_quantity(one)), channels.QUANTITY)
        rows = self._together(dtype).copy()
        begun = np.zeros(len(rows), np.bool_)
        for name in np.unique(rows["name"]):
            of_name = rows["name"] == name
            begun[of_name] = np.maximum.accumulate(rows["supported"][of_name]) == 1
        rows = rows[begun]
        for field in {*channels.NUMBERS} & set(rows.dtype.names or ()):
            rows[field][rows["supported"] == 0] = np.nan
        return self._table("estimates", rows)

    @property
    def events(self) -> ChannelTable:
        """Events of all workers by time: severity, code, source, text."""
        return self._table("events", self._together(EVENT))

    @property
    def gaps(self) -> ChannelTable:
        """Gap records: channel, first and last sequence number, cause."""
        return self._table("gaps", self._together(GAP))

    def resample(self, rate_hz: float, channels: Sequence[str] | None = None) -> ChannelTable:
        """Every signal at common instants of vehicle time, known filter delays removed.

        Args:
            rate_hz: of the instants.
            channels: only these; every channel that carries a signal where None.

        Raises:
            ValueError: no vehicle is known, a channel that carries no signal, or a rate that is not positive.
        """
        found = aligned(self.tables, channels, rate_hz)
        blocks = list(found.blocks)
        rows = np.concatenate(blocks) if blocks else np.empty(0, found.dtype)
        shown = [column for column in found.columns if column.name not in _INDEX | _BOOKKEEPING]
        return ChannelTable.of(f"{self.path.stem} at {rate_hz:g} Hz", shown, rows, self.tables.times)

    @overload
    def replay(self) -> Replay: ...
    @overload
    def replay(self, settings: str | Path) -> Reestimate: ...
    def replay(self, settings: str | Path | None = None) -> Replay | Reestimate:
        """Estimate again from the log.

        Args:
            settings: TOML of settings put over those flown with; where None, the same, compared bit for bit.

        Raises:
            ConfigError: the log carries no vehicle, or the settings do not fit.
        """
        return replay(self.path) if settings is None else reestimate(self.path, Path(settings))

    def with_times(self, name: str, rows: Rows) -> Rows:
        """``rows``, all of channel ``name``, with the time of each."""
        if name in self.tables.clocked:
            return with_times(rows, self._clocked[name])
        return self.tables.read(name)

    @cached_property
    def _clocked(self) -> dict[str, NDArray[np.int64]]:
        """Vehicle time of every row of the channels that have clocks: one run of the timebase for all."""
        parts: dict[str, list[NDArray[np.int64]]] = {name: [np.empty(0, np.int64)] for name in self.tables.clocked}
        for name, time_ns in self.tables.times_of(self.tables.clocked):
            parts[name].append(time_ns)
        return {name: np.concatenate(times) for name, times in parts.items()}

    def _together(self, dtype: np.dtype[np.void]) -> Rows:
        names = [name for name, known in self.tables.log.channels.items() if known == dtype]
        rows = np.concatenate([np.empty(0, dtype), *(self.tables.log.read(name) for name in names)])
        return rows[np.argsort(rows["host_ns"], kind="stable")]

    def _table(self, name: str, rows: Rows) -> ChannelTable:
        at_ns = rows["vehicle_ns" if "vehicle_ns" in (rows.dtype.names or ()) else "host_ns"]
        shown = [column for column in columns(rows.dtype, {}, rows) if column.name not in _BOOKKEEPING]
        return ChannelTable.of(name, shown, with_times(rows, at_ns), self.tables.times)


def open_log(path: str | Path, vehicle: str | Path | config.Vehicle | None = None) -> FlightLog:
    """Open a log.

    Args:
        path: of the log, whole, damaged, or the first of its segments.
        vehicle: that flew: a vehicle file, the name of a packaged vehicle, or one that is loaded; the one that the log
            carries where None.

    Raises:
        LogFormatError: it is no log of ours.
        ConfigError: the vehicle cannot be used.
        OSError: it cannot be read.
    """
    return FlightLog(FlightTables(path, vehicle_named(vehicle)))


def vehicle_named(vehicle: str | Path | config.Vehicle | None) -> config.Vehicle | None:
    """A vehicle by the path of its file or the name of a packaged one; one that is loaded, and None, as they are.

    Raises:
        ConfigError: it cannot be used.
    """
    if vehicle is None or isinstance(vehicle, config.Vehicle):
        return vehicle
    return config.named(vehicle)
