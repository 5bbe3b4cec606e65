"""Rows of a channel from columns of a foreign recording: times, counts, axes; rows that cannot be used."""

from bisect import bisect_left
from collections.abc import Mapping as Columns
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import records
from drivers.records import Rows, SampleStatus
from onboard.ground.log.bring_in import foreign
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.mapping import NS_PER, ImuChannel, Scalar, ScalarChannel, Time, VectorMapping
from onboard.ground.log.bring_in.text_rows import Values
from onboard.recording.format.decode import FARTHEST_NS

_MOST_ROUNDED = 0.1  # rms of what rounding takes away, of the rms of the values
_MOST_OFF = 0.01  # of a unit quaternion's length
_HUGE = 2.0**62  # larger values are refused: they may overflow int64
_RAILS = np.iinfo(np.int16)
_SKIP = 'bad_rows = "skip" in [mapping] leaves such rows out'
_SORT, _REMOVE = f"sort the recording; {_SKIP}", f"remove the row; {_SKIP}"


def columns_of(channel: ImuChannel | ScalarChannel) -> list[str]:
    """The columns that a channel is read from, without those of times."""
    if isinstance(channel, ScalarChannel):
        return list(channel.value.terms)
    vectors = channel.gyro, channel.accel
    return [name for one in vectors for name in (one.columns or ("",) if one.column is None else (one.column,))]


def times_ns(source: Path, columns: Columns[str, Values], time: Time, sampled: str) -> NDArray[np.int64]:
    """Times (n,) of the samples, ns; evenly spaced by the number of ``sampled`` if the recording has none."""
    if time.column is None:
        assert time.rate_Hz is not None
        count = foreign.length(columns, sampled)  # a missing column is reported when its values are read
        start_ns = time.offset * NS_PER[time.unit]
        return np.asarray(np.rint(start_ns + np.arange(count) * (1e9 / time.rate_Hz)), np.int64)
    values = foreign.numbers(source, columns, time.column)
    approximate, host_ns = _ns(values, time)
    if (bad := ~_is_time(approximate)).any():
        raise SourceError(
            f"{source}: {time.column!r} is no time from 0 on in row {_first(bad)}; remove the row, or give an offset"
        )
    if (back := np.diff(host_ns) <= 0).any():
        raise SourceError(f"{source}: {time.column!r} does not increase after row {_first(back)}; {_SORT}")
    if (far := np.diff(host_ns) > FARTHEST_NS).any():
        raise SourceError(f"{source}: {time.column!r} jumps by years after row {_first(far)}; correct its unit")
    return host_ns


def _ns(values: Values, time: Time) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Times (n,), as floats and as whole ns; what is no time is any number of the latter."""
    per_unit = NS_PER[time.unit]
    if time.wraps is not None:
        values = unwrapped(values, time.wraps)
    approximate = (values.astype(np.float64) + time.offset) * per_unit
    if values.dtype.kind == "f":
        return approximate, np.rint(np.where(_is_time(approximate), approximate, 0.0)).astype(np.int64)
    return approximate, values.astype(np.int64) * per_unit + round(time.offset * per_unit)


def unwrapped(values: Values, modulus: float) -> Values:
    """What starts again after ``modulus``, a counter or an angle, (n,), without that; what is no number stays so."""
    known = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[known].astype(np.float64))
    turns = np.cumsum((steps < -0.5 * modulus).astype(np.int64) - (steps > 0.5 * modulus))
    more = np.zeros(len(values), np.int64)
    more[known[1:]] = turns
    if values.dtype.kind in "iu" and modulus == int(modulus):
        return values.astype(np.int64) + int(modulus) * more
    return values.astype(np.float64) + modulus * more


def _is_time(approximate: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (approximate >= 0) & (approximate < _HUGE)


def without_bad_rows(
    source: Path, columns: Columns[str, Values], channel: ImuChannel | ScalarChannel, time: Time
) -> tuple[Columns[str, Values], int]:
    """The columns without the rows that this channel cannot use, and how many these are.

    Left out are rows with a cell that is no number, or no time from 0 on, and the fewest rows without which times rise.

    Raises:
        SourceError: no row is left.
    """
    own = columns_of(channel)
    good = foreign.usable(columns, own if time.column is None else (time.column, *own))
    if time.column is not None and foreign.length(columns, time.column) == len(good) and good.any():
        at = np.flatnonzero(good)
        approximate, host_ns = _ns(foreign.numbers(source, columns, time.column), time)
        at = at[_is_time(approximate[at])]
        good[:] = False
        good[at[rising(host_ns[at])]] = True
    left_out = int((~good).sum())
    if not left_out:
        return columns, 0
    if not good.any():
        raise SourceError(f"{source}: no row has numbers in all of {', '.join(map(repr, own))}; correct the mapping")
    return {name: one[good] if len(one) == len(good) else one for name, one in columns.items()}, left_out


def rising(times: Values) -> NDArray[np.intp]:
    """Places of a longest part of ``times`` that rises strictly (patience sorting)."""
    if (np.diff(times) > 0).all():
        return np.arange(len(times))
    ends: list[float] = []  # the smallest last time of a part of each length
    at: list[int] = []  # its place
    before = np.full(len(times), -1)
    for k, time in enumerate(times.tolist()):
        length = bisect_left(ends, time)
        before[k] = at[length - 1] if length else -1
        ends[length : length + 1], at[length : length + 1] = [time], [k]
    kept = np.empty(len(ends), np.intp)
    k = at[-1]
    for place in range(len(ends) - 1, -1, -1):
        kept[place], k = k, int(before[k])
    return kept


def _first(bad: NDArray[np.bool_]) -> int:
    """Number of the first row of ``bad`` (n, ...), counted from 1, that is true anywhere."""
    return int(np.argmax(bad.reshape(len(bad), -1).any(axis=1))) + 1


def _rows(host_ns: NDArray[np.int64], dtype: np.dtype[np.void]) -> Rows:
    rows = np.zeros(len(host_ns), dtype)
    rows["host_ns"] = host_ns
    rows["sequence"] = rows["tick"] = np.arange(len(host_ns))
    return rows


def imu(source: Path, columns: Columns[str, Values], channel: ImuChannel, host_ns: NDArray[np.int64]) -> Rows:
    """Rows of ``records.IMU``, counts of 16 bits turned into the body's axes; those at the rails are saturated."""
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


def scalar(source: Path, columns: Columns[str, Values], channel: ScalarChannel, host_ns: NDArray[np.int64]) -> Rows:
    """Rows of ``records.SCALAR``, of a column or a sum of some."""
    rows = _rows(host_ns, records.SCALAR)
    value = channel.value
    parts = {name: foreign.numbers(source, columns, name) for name in value.terms}
    lengths = {name: len(part) for name, part in parts.items()}
    if len(set(lengths.values())) > 1:
        raise SourceError(f"{source}: columns of a sum differ in length: {lengths}; they must be of the same samples")
    names = " + ".join(parts)
    values: Values = next(iter(parts.values()))
    if value.wraps is not None:
        values = unwrapped(values, value.wraps)
    if value.sum is not None:
        values = np.column_stack(list(parts.values())).astype(np.float64) @ np.array(list(value.sum.values()))
    if value.quaternion is not None:
        values = _yaw(source, names, np.array([parts[name] for name in value.quaternion], np.float64), value.up)
    counts = _counts(source, names, value, values, len(rows))
    rows["value_raw"] = counts if value.sign == "+" else -counts
    rows["scale"] = value.si_count
    rows["unit"] = value.si_unit.encode()
    return rows


def _yaw(source: Path, names: str, quaternion: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """Yaw (n,) about the vertical, rad, of quaternions (4, n): w, x, y, z; it goes on beyond half a turn."""
    norm = np.linalg.norm(quaternion, axis=0)
    if (bad := ~(np.abs(norm - 1.0) < _MOST_OFF)).any():
        raise SourceError(f"{source}: {names} is no unit quaternion in row {_first(bad)}; {_REMOVE}")
    w, x, y, z = quaternion / norm
    if up == "y":  # axes x, -z, y
        y, z = -z, y
    return np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


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
        raise SourceError(f"{source}: {names!r} is no usable number in row {_first(bad)}; {_REMOVE}")
    lost, size = (float(np.sqrt(np.mean(x**2))) if x.size else 0.0 for x in (exact - counts, exact))
    if quantity.values == "physical" and lost > _MOST_ROUNDED * size:
        kept = f"counts of {quantity.count:g} {quantity.unit} leave {1.0 - lost / size:.0%} of {names!r}"
        raise SourceError(f"{source}: {kept}; give the mapping a smaller scale in the table that names this column")
    if quantity.values == "counts" and (bad := counts != exact).any():
        raise SourceError(
            f'{source}: {names!r} is no whole count in row {_first(bad)}; say values = "physical" in the mapping'
        )
    return counts.astype(np.int64)
