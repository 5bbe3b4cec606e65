"""A table in memory, for NumPy, pandas and xarray. pandas and xarray are imported when they are asked for."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.ground.log.tables.columns import TIME_FIELD, TableColumn, Times, Values
from onboard.ground.log.tables.vehicle_time import UNKNOWN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


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
