"""Readings of one channel in a log of a bench run, and the stretches of time in which it was still.

What the operator marked in the log comes first, then times that are given, then what the readings themselves show.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import EVENT, IMU, SCALAR, Rows
from onboard import config
from onboard.devices import si
from onboard.devices.base import BusDevice
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import READING, sigmas
from onboard.flight.bench import BEGIN, END
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.vehicle_file import attached_vehicle
from onboard.ground.log.tables.vehicle_time import UNKNOWN
from onboard.recording.reader import LogReader

SHORTEST_s = 2.0
_BLOCK_s = 0.1
_SETTLE_s = 0.5  # at either end of what the operator marked


class LogSpan(NamedTuple):
    """A stretch of time, s since the log's first sample of the channel."""

    start_s: float
    end_s: float

    def __str__(self) -> str:
        return f"{self.start_s:.1f}-{self.end_s:.1f} s"


def spans_of(text: str) -> list[LogSpan]:
    """Stretches written as ``2-12,15-25``.

    Raises:
        ValueError: they are not.
    """
    try:
        pairs = [part.split("-") for part in text.split(",") if part]
        return [LogSpan(float(start), float(end)) for start, end in pairs]
    except ValueError as error:
        raise ValueError(f"--at {text}: write 2-12,15-25 (s from the log's start)") from error


class Readings(NamedTuple):
    """Of one channel, SI."""

    channel: str
    start_s: float  # of the first
    time_s: FloatArray  # (n,) since then
    values: FloatArray  # (n, columns)
    usable: BoolArray  # (n,)
    resolution: FloatArray  # (columns,) a count
    spans: list[LogSpan]  # that the operator marked

    def within(self, span: LogSpan) -> slice:
        """The samples in a stretch."""
        return slice(*np.searchsorted(self.time_s, span).tolist())

    def mean(self, span: LogSpan) -> tuple[FloatArray, FloatArray]:
        """Mean over a stretch, (columns,), and how well that is known, by means of a tenth of it.

        Raises:
            CalibrationError: a sample in it may not be used.
        """
        part = self.within(span)
        if not self.usable[part].all():
            raise CalibrationError(
                f"{self.channel} is overloaded or says that its reading is not valid at {span}; load it less"
            )
        values = self.values[part]
        tenths = np.array([one.mean(axis=0) for one in np.array_split(values, 10)])
        spread = np.maximum(tenths.std(axis=0, ddof=1), self.resolution / np.sqrt(12.0 * len(values))) / np.sqrt(10.0)
        return values.mean(axis=0), spread


def readings(log: LogReader, vehicle: config.Vehicle, channel: str, *, calibrated: bool = False) -> Readings:
    """What a channel read, without its present calibration unless it is wanted.

    Raises:
        CalibrationError: the log is another vehicle's, or does not have the channel, or nothing on it.
    """
    _require_of(log, vehicle, channel)
    wanted = vehicle.channels[channel]
    if log.channels.get(channel) != wanted or wanted not in (IMU, SCALAR):
        held = ", ".join(name for name, dtype in log.channels.items() if dtype in (IMU, SCALAR))
        raise CalibrationError(f"{log.path} has no readings of {channel}; it has {held or 'none at all'}")
    rows, time_s = _timed(log, vehicle, channel)
    if len(rows) < 50:
        raise CalibrationError(f"{log.path}: {len(rows)} samples of {channel}; check that the device ran")
    signal = roles_of(vehicle).signals[channel]
    plain = signal if calibrated else signal._replace(corrections=())
    values, count = _si(rows, wanted, plain)
    spans = [LogSpan(a - time_s[0], b - time_s[0]) for a, b in _marked(log)]
    usable = si.usable(rows) & np.isfinite(values).all(axis=1)
    return Readings(channel, float(time_s[0]), time_s - time_s[0], values, usable, count, spans)


def _timed(log: LogReader, vehicle: config.Vehicle, channel: str) -> tuple[Rows, FloatArray]:
    """Rows and the times of their samples, s, rising: by the vehicle's clocks, or by arrival where no pulse came.

    By arrival: the device's ticks (row numbers where it has none) on a parabola through the whole log's arrivals, since
    rows share a stamp where a FIFO is drained, and a causal solution is not good enough at the start.
    """
    tables = FlightTables(log, vehicle)
    timed = channel in tables.clocked
    rows = tables.read(channel) if timed else log.read(channel)
    time_s = rows["time_ns"] * 1e-9 if timed else np.zeros(len(rows))
    known = rows["time_ns"] != UNKNOWN if timed else np.zeros(len(rows), np.bool_)
    device = vehicle.file.device.get(channel)
    if isinstance(device, BusDevice) and device.marks(channel, {channel: rows}) == 0:
        known[:] = False  # its clock runs by its nominal rate then, which is a percent off
    if not known.any() and len(rows) > 3:
        host_s = (rows["host_ns"] - rows["host_ns"][0]) * 1e-9
        tick = (rows["tick"] - rows["tick"][0]).astype(np.float64)
        if not (np.diff(tick) > 0.0).all():
            tick = np.arange(len(rows), dtype=np.float64)
        tick = tick / tick[-1]
        time_s = np.polynomial.Polynomial.fit(tick, host_s, 2)(tick) + rows["host_ns"][0] * 1e-9
        known = np.ones(len(rows), np.bool_)
    rows, time_s = rows[known], time_s[known]
    rising = np.append(True, np.diff(time_s) > 0.0)[: len(rows)]
    return rows[rising], time_s[rising]


def _si(rows: Rows, kind: np.dtype[np.void], signal: SmoothedChannel) -> tuple[FloatArray, FloatArray]:
    if kind == IMU:
        scales = [rows[field].astype(np.float64).max() for field in ("gyro_scale_rad_s", "accel_scale_m_s2")]
        return si.imu(rows, signal), np.repeat(scales, 3)
    factor = si.factors(rows, signal)
    if np.isnan(factor).all():
        known, unit = ", ".join(one.decode() for one in signal.si), rows["unit"][0].decode("ascii", "replace")
        raise CalibrationError(f"its readings are in {unit!r}, which is none of {known}; correct its device")
    return (si.scalar(rows, signal) * factor)[:, None], np.array([np.nanmax(np.abs(rows["scale"] * factor))])


def _require_of(log: LogReader, vehicle: config.Vehicle, channel: str) -> None:
    try:
        flown = attached_vehicle(log)
    except config.ConfigError:
        return  # an import: its channel has to be there
    name, own = flown.file.vehicle.name, vehicle.file.vehicle.name
    if name != own:
        raise CalibrationError(f"{log.path} is a log of vehicle {name!r}, not of {own!r}; give a log of this vehicle")
    was, now = flown.file.device.get(channel), vehicle.file.device.get(channel)
    if was is not None and now is not None and was.kind != now.kind:
        raise CalibrationError(f"{log.path}: {channel} was a {was.kind} then and is a {now.kind} now; record it again")


def _marked(log: LogReader) -> list[LogSpan]:
    """What the operator marked as held still, without how it was taken there; host time, s."""
    rows = [log.read(name) for name, dtype in log.channels.items() if dtype == EVENT]
    events = np.concatenate(rows) if rows else np.zeros(0, EVENT)
    said = events[np.isin(events["code"], [BEGIN.encode(), END.encode()])]
    said = said[np.argsort(said["host_ns"], kind="stable")]
    spans, begun = [], None
    for one in said:
        if one["code"] == BEGIN.encode():
            begun = float(one["host_ns"]) * 1e-9
        elif begun is not None:
            spans.append(LogSpan(begun + _SETTLE_s, float(one["host_ns"]) * 1e-9 - _SETTLE_s))
            begun = None
    return spans


def still(read: Readings, at: Sequence[LogSpan] = (), shortest_s: float = SHORTEST_s) -> list[LogSpan]:
    """The stretches in which the readings were still, as given, as marked, or as found, in the order of time.

    Found: blocks of a tenth of a second whose scatter is that of rest (twice the lower fifth of all), and whose mean
    stays within as much of that of the block before.

    Raises:
        CalibrationError: there is none, or one that was given is not in the log.
    """
    for span in at:
        if not (0.0 <= span.start_s < span.end_s <= read.time_s[-1] + 1.0):
            raise CalibrationError(f"{span} is not in the log, which is {read.time_s[-1]:.1f} s long; correct --at")
    if at or read.spans:
        return list(at or read.spans)
    period = float(np.median(np.diff(read.time_s)))
    size = max(10, round(_BLOCK_s / period))
    blocks = len(read.values) // size
    if blocks < 10:
        raise CalibrationError(f"{read.time_s[-1]:.1f} s of {read.channel}; record longer")
    cut = read.values[: blocks * size].reshape(blocks, size, -1)
    times = read.time_s[: blocks * size].reshape(blocks, size)
    scatter, middle = cut.std(axis=1), cut.mean(axis=1)
    rest = np.maximum(np.quantile(scatter, 0.2, axis=0), 0.6 * read.resolution)
    calm = (scatter < 2.0 * rest).all(axis=1)
    stays = (np.abs(np.diff(middle, axis=0)) < 2.0 * rest).all(axis=1)
    whole = times[:, -1] - times[:, 0] < 1.5 * size * period
    spans = [
        LogSpan(float(times[first + 1, 0]), float(times[last - 1, -1]))
        for first, last in _runs(calm & whole, stays)
        if last - first >= 2 and times[last - 1, -1] - times[first + 1, 0] >= shortest_s
    ]
    if not spans:
        raise CalibrationError(
            f"{read.channel} is still nowhere for {shortest_s:g} s; let it rest at each step, or give the times by --at"
        )
    return spans


def require_within(read: Readings, capacity: float, remedy: str) -> None:
    """Refuse readings that stay at the end of the range.

    Raises:
        CalibrationError: for a second and more.
    """
    beyond = np.abs(read.values).max(axis=1) >= capacity
    if np.count_nonzero(beyond) * float(np.median(np.diff(read.time_s))) > 1.0:
        at_s = float(read.time_s[int(beyond.argmax())])
        raise CalibrationError(f"{read.channel} is overloaded at {at_s:.1f} s, {capacity:g} N and more; {remedy}")


def _runs(good: BoolArray, joined: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last of every run of good blocks, each joined to the one before."""
    found: list[tuple[int, int]] = []
    for index in np.flatnonzero(good).tolist():
        if found and found[-1][1] == index - 1 and joined[index - 1]:
            found[-1] = found[-1][0], index
        else:
            found.append((index, index))
    return found


def steps(read: Readings, at: Sequence[LogSpan], count: int, what: str) -> list[LogSpan]:
    """The stretches of so many steps in a known order; what is interrupted at one level is one stretch.

    Raises:
        CalibrationError: there are more, or fewer.
    """
    spans = still(read, at)
    merged = [spans[0]]
    for span in spans[1:]:
        (before, a), (now, b) = read.mean(merged[-1]), read.mean(span)
        between = read.values[read.within(LogSpan(merged[-1].end_s, span.start_s))]
        apart = np.abs(now - before) > np.maximum(sigmas(READING) * np.hypot(a, b), 2.0 * read.resolution)
        left = len(between) and (np.abs(between - before) > 30.0 * np.maximum(a, read.resolution)).any()
        if apart.any() or at or read.spans or left:
            merged.append(span)
        else:
            merged[-1] = LogSpan(merged[-1].start_s, span.end_s)
    if len(merged) != count:
        shown = "; ".join(f"{span}: {', '.join(f'{v:.6g}' for v in read.mean(span)[0])}" for span in merged)
        raise CalibrationError(
            f"{len(merged)} steady readings in the log, {count} {what}: {shown}. Leave each for a few seconds in the "
            "order that is given, or give the times by --at"
        )
    return merged
