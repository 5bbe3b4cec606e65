"""Flat columns of a channel's rows for other programs: raw counts and SI values.

A converted column is made where the row carries its scale: ``gyro_raw`` with ``gyro_scale_rad_s`` gives ``gyro_x``
to ``gyro_z`` in rad/s, ``value_raw`` with ``scale`` and ``unit`` gives ``value`` in that unit. Converted vectors name
their frame (``gyro_imu_base_x``), and the zero count is taken off converted values. Rows that were given times
(:func:`with_times`) have ``time_s`` and, where the log knows it, ``utc`` in front.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.devices import si
from onboard.ground.log.tables.meaning import ChannelMeaning
from onboard.ground.log.tables.vehicle_time import UNKNOWN
from onboard.recording.format.texts import printable

Values = NDArray[np.generic]

_UNIT_OF_SUFFIX = {  # of the last words of a field's name
    "ns": "ns",
    "us": "us",
    "ms": "ms",
    "s": "s",
    "1_s": "1/s",
    "hz": "Hz",
    "m": "m",
    "m_s": "m/s",
    "m_s2": "m/s^2",
    "rad": "rad",
    "rad_s": "rad/s",
    "rad_s2": "rad/s^2",
    "deg": "deg",
    "deg_s": "deg/s",
    "deg_c": "deg C",
    "n": "N",
    "n_m": "N m",
    "kg": "kg",
    "kg_m": "kg m",
    "kg_m2": "kg m^2",
    "v": "V",
    "a": "A",
    "w": "W",
    "pa": "Pa",
    "ppm": "ppm",
    "percent": "%",
    "mb": "MB",
    "raw": "count",
    "tick": "count",
}
_CARTESIAN = {
    *("accel", "acceleration", "angular", "axis", "field", "force", "gyro", "magnetic", "moment", "position"),
    *("specific", "torque", "velocity"),
}


_IMU_COLUMNS = {"gyro": 0, "accel": 3}  # of si.imu, by what the raw field is called
TIME_FIELD = "time_ns"
_FAR_NS = 1 << 62  # the sum of two smaller ones is an i8
_PLAIN = ChannelMeaning()


class Times(NamedTuple):
    """Where a log's times begin.

    Attributes:
        start_ns: vehicle time of ``time_s`` = 0.
        utc_offset_ns: what is added to vehicle time for UTC; None where the log does not know it.
    """

    start_ns: int
    utc_offset_ns: int | None = None


class TableColumn(NamedTuple):
    """One column of a table.

    ``values`` takes rows (n,) to values (n,): numbers, text, timedelta64[ns] for times in s, datetime64[ns] for UTC;
    ``digits`` is how many significant decimal digits a converted value
    carries, None for a value that is to be written as it is. ``product`` takes rows to the counts and the scale that a
    converted value is the product of, where it is nothing but that; ``made_of`` names the columns it
    stands for; ``field`` is the recorded one it is an element of.
    """

    name: str
    unit: str
    values: Callable[[Rows], Values]
    digits: int | None = None
    product: tuple[Callable[[Rows], Values], Callable[[Rows], Values]] | None = None
    made_of: tuple[str, ...] = ()
    field: str = ""

    @property
    def converted(self) -> bool:
        """Whether it is an SI value converted from other columns."""
        return self.digits is not None

    @property
    def header(self) -> str:
        """Column heading: name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def unit_of(field: str) -> str:
    """Unit in a field name's suffix; empty if there is none."""
    words = field.split("_")
    suffixes = ("_".join(words[-n:]) for n in (3, 2, 1) if n <= len(words))
    return next((_UNIT_OF_SUFFIX[suffix] for suffix in suffixes if suffix in _UNIT_OF_SUFFIX), "")


@cache
def timed_dtype(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    """``dtype`` with ``time_ns``, vehicle time, behind its fields."""
    names = dtype.names or ()
    fields: Mapping[str, Any] = dtype.fields or {}
    return np.dtype(
        {
            "names": [*names, TIME_FIELD],
            "formats": [*(fields[name][0] for name in names), "<i8"],
            "offsets": [*(fields[name][1] for name in names), dtype.itemsize],
            "itemsize": dtype.itemsize + 8,
        }
    )


def with_times(rows: Rows, time_ns: NDArray[np.int64]) -> Rows:
    """``rows`` (n,) and vehicle time (n,) of each as rows of :func:`timed_dtype`."""
    size = rows.dtype.itemsize
    made = np.empty(len(rows), timed_dtype(rows.dtype))
    made.view(np.uint8).reshape(len(rows), made.dtype.itemsize)[:, :size] = (
        np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), size)
    )
    made[TIME_FIELD] = time_ns
    return made


def time_columns(times: Times) -> list[TableColumn]:
    """``time_s`` and, where it is known, ``utc``, of rows with times."""

    def since_start(rows: Rows) -> Values:
        return _shifted(rows[TIME_FIELD], -times.start_ns).view("m8[ns]")

    def utc(rows: Rows) -> Values:
        assert times.utc_offset_ns is not None
        return _shifted(rows[TIME_FIELD], times.utc_offset_ns).view("M8[ns]")

    known = [TableColumn("utc", "", utc)] if times.utc_offset_ns is not None else []
    return [TableColumn("time_s", "s", since_start), *known]


def _shifted(time_ns: NDArray[np.int64], by_ns: int) -> NDArray[np.int64]:
    """UNKNOWN (NumPy's NaT) for times out of range, as a crafted log may hold."""
    if abs(by_ns) >= _FAR_NS:
        return np.full(len(time_ns), UNKNOWN, np.int64)
    return np.where((time_ns > -_FAR_NS) & (time_ns < _FAR_NS), time_ns + np.int64(by_ns), UNKNOWN)


def columns(
    dtype: np.dtype[np.void], units: Mapping[str, str], sample: Rows, meaning: ChannelMeaning = _PLAIN
) -> list[TableColumn]:
    """The columns of a channel, in the order of its fields, each converted one after its raw one.

    Args:
        dtype: of the channel's rows.
        units: field to unit, from the log; other units come from the field name.
        sample: some of the rows (possibly none): where rows carry their unit, the first one's becomes that of the
            converted column, and rows with another unit are NaN there.
        meaning: of the channel: the frame that stands in the names of converted vectors, and the zero count.
    """
    result: list[TableColumn] = []
    for name, shape in _fields(dtype).items():
        unit = units.get(name, unit_of(name))
        for suffix, index in _components(name, shape):
            result.append(TableColumn(name + suffix, unit, _getter(name, index), field=name))
        if name.endswith("_raw"):
            result += _converted(dtype, name.removesuffix("_raw"), shape, sample, meaning)
    return result


def _fields(dtype: np.dtype[np.void]) -> dict[str, tuple[int, ...]]:
    return {name: dtype[name].shape for name in dtype.names or ()}


def _is_plain(dtype: np.dtype[np.void], name: str, kinds: str) -> bool:
    """Whether there is a field of this name with one element, of one of these kinds."""
    return name in (dtype.names or ()) and dtype[name].shape == () and dtype[name].kind in kinds


def _components(name: str, shape: tuple[int, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Suffix of the column's name, and index in the field, of each element."""
    if shape == (3,) and _CARTESIAN & set(name.split("_")):
        return [(f"_{axis}", (n,)) for n, axis in enumerate("xyz")]
    if shape == (4,) and name == "quaternion":
        return [(f"_{part}", (n,)) for n, part in enumerate("wxyz")]
    return [("".join(f"_{n}" for n in index), index) for index in np.ndindex(shape)]


def _element(rows: Rows, name: str, index: tuple[int, ...]) -> Values:
    field: Values = rows[name]
    for n in index:
        field = field[:, n]
    return field


def _getter(name: str, index: tuple[int, ...]) -> Callable[[Rows], Values]:
    return lambda rows: _element(rows, name, index)


def _converted(
    dtype: np.dtype[np.void], base: str, shape: tuple[int, ...], sample: Rows, meaning: ChannelMeaning
) -> list[TableColumn]:
    fields = _fields(dtype)
    own = next((name for name in fields if name.startswith(f"{base}_scale_")), None)
    if own is not None:
        scale, unit, text = own, unit_of(own), b""
    elif base == "value" and _is_plain(dtype, "scale", "iuf") and _is_plain(dtype, "unit", "S"):
        text = bytes(sample["unit"][0]) if len(sample) else b""
        scale, unit = "scale", printable(text)
    else:
        return []
    if not _is_plain(dtype, scale, "iuf") or dtype[f"{base}_raw"].base.kind not in "iuf":
        return []  # not as heft defines it
    digits = 9 if dtype[scale] == np.float32 else 17
    signal = meaning.signal if meaning.signal and meaning.signal.corrections else None

    def calibrated(index: tuple[int, ...]) -> Callable[[Rows], Values]:
        if text:
            assert signal is not None
            return lambda rows: np.where(rows["unit"] == text, si.scalar(rows, signal), np.nan)
        column = _IMU_COLUMNS[base] + index[0]
        return lambda rows: si.imu(rows, signal)[:, column]

    def converter(index: tuple[int, ...]) -> Callable[[Rows], Values]:
        def values(rows: Rows) -> Values:
            counts = (_element(rows, f"{base}_raw", index) - meaning.zero_count).astype(np.float64)
            with np.errstate(over="ignore", invalid="ignore"):  # an overflow is written as inf or NaN
                product: NDArray[np.float64] = counts * rows[scale].astype(np.float64)
            if text:
                product[rows["unit"] != text] = np.nan
            return product

        return values

    made: list[TableColumn] = []
    for suffix, index in _components(base, shape):
        whole = not text and not meaning.zero_count and signal is None
        product = (_getter(f"{base}_raw", index), _getter(scale, ())) if whole else None
        sources = (f"{base}_raw{suffix}", scale, *(("unit",) if text else ()))
        of_frame = f"_{meaning.frame}" if meaning.frame and len(shape) == 1 else ""
        values = converter(index) if signal is None else calibrated(index)
        made.append(TableColumn(base + of_frame + suffix, unit, values, digits, product, sources))
    return made
