"""From ``[drive]``, a motion's CSV and the URDF to what the player of a bus sends, in counts of each drive.

The motion is put on the period of the drives (SYNC, or requests) by a cubic spline through its rows, at rest at both
ends, and refused as a whole where it leaves a limit anywhere: range less margin, rate, acceleration. Light, because
acquisition starts with it.
"""

import csv
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.play.player import PlayerConfig
from onboard.config.drive import Drive
from onboard.config.errors import ConfigError
from onboard.config.segments import Library
from onboard.devices.base import DeviceSection, Surroundings
from onboard.devices.driven import DrivenDevice

FloatArray = NDArray[np.float64]
LONGEST_S = 3600.0
FEWEST_ROWS = 4
HELD_S = 1.0  # of the posture of segments, before the first is asked for
WAY_POINTS_S = 0.2  # least time between two of them


class Range(NamedTuple):
    """Limits of a joint: rad, rad, rad/s."""

    low: float
    high: float
    rate: float


class Played(NamedTuple):
    """Parts of an armed vehicle: its file's name, tables, motion, segments and URDF."""

    label: str
    drive: Drive
    devices: Mapping[str, DeviceSection]
    motion: Path | None
    library: Library | None
    urdf_text: str


def player_of(around: Surroundings, vehicle: Played, bus: str) -> PlayerConfig[Any] | None:
    """What is played on a bus; None where nothing is: no motion and no segments, or another bus's drives.

    Raises:
        ConfigError: the motion, a limit or a device that cannot be driven.
    """
    drive, motion, library = vehicle.drive, vehicle.motion, vehicle.library
    if motion is None and library is None:
        return None
    driven = driven_on(vehicle.devices)
    if not driven:
        raise ConfigError(f"{vehicle.label}: no device has driven = true: give it to the drives that play")
    buses = sorted({device.bus for device in driven.values()})
    if len(buses) > 1:
        raise ConfigError(f"{vehicle.label}: driven devices are on {', '.join(buses)}; drives move on a single bus")
    if buses != [bus]:
        return None
    joints = [device.joint for device in driven.values()]
    name = "the posture of the segments" if motion is None else motion.name
    segments = {} if library is None else _segments(library, joints)
    if motion is not None:
        time_s, q = read_motion(motion, joints)
    else:
        time_s, q = np.array([0.0, HELD_S]), np.tile(next(iter(segments.values()))[1][0], (2, 1))
    ranges = joint_ranges(vehicle.urdf_text)
    period_s = 1.0 / next(iter(driven.values())).rate_on(around)
    on_sync_s, on_sync = resampled(time_s, q, period_s)
    axes, columns = [], []
    for column, (drives, device) in enumerate(driven.items()):
        limits = _range(drive, device.joint, ranges)
        require_within(
            str(motion or name), device.joint, on_sync_s, on_sync[:, column], limits, drive.acceleration_rad_s2
        )
        axes.append(device.axis(drives, _limits(drive, drives, device, limits), drive.master_node))
        columns.append(_counts(device, q[:, column] if drive.mode == "profile" else on_sync[:, column]))
    counts = np.stack(columns, 1)
    asked = {}
    for own, (at_s, angles) in segments.items():
        on_sync_s, on_sync = resampled(at_s, angles, period_s)
        for column, device in enumerate(driven.values()):
            limits = _range(drive, device.joint, ranges)
            require_within(own, device.joint, on_sync_s, on_sync[:, column], limits, drive.acceleration_rad_s2)
        asked[own] = np.stack([_counts(device, on_sync[:, k]) for k, device in enumerate(driven.values())], 1)
    ticks = np.arange(len(counts), dtype=np.int64)
    if drive.mode == "profile":
        if np.diff(time_s).min() < WAY_POINTS_S:
            raise ConfigError(f"{motion}: way points of a profile are {WAY_POINTS_S} s apart or more: thin it out")
        ticks = np.round((time_s - time_s[0]) / period_s).astype(np.int64)
    return PlayerConfig(
        *(tuple(axes), ticks, counts, drive.mode == "profile", drive.heartbeat_ms, drive.sync_limit_ms),
        name=name,
        segments=asked,
    )


def _segments(library: "Library", joints: Sequence[str]) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Times (n,) and angles (n, joints) of each segment, by name."""
    if sorted(library.joints) != sorted(joints):
        told = f"{', '.join(library.joints)}, and {', '.join(joints)} are driven"
        raise ConfigError(f"the segments of [mission] move {told}: they have to be the same")
    order = [library.joints.index(joint) for joint in joints]
    motions = zip(library.names, library.ticks.tolist(), library.q, strict=True)
    return {name: (library.time_s[:n], q[:n, order]) for name, n, q in motions}


def driven_on(devices: Mapping[str, DeviceSection]) -> dict[str, DrivenDevice]:
    """The devices that are driven, by name, in the order of the file."""
    return {name: device for name, device in devices.items() if isinstance(device, DrivenDevice) and device.driven}


def read_motion(path: Path, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """A motion's times (n,), s, and angles (n, joints), rad, from a CSV with a header ``time_s,JOINT,...``.

    Raises:
        ConfigError: it cannot be read, has other columns, or numbers that are none or do not rise in time.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"motion {path} cannot be read: {error}; heft plan writes such files") from error
    names = [name.strip() for name in rows[0]] if rows else []
    wanted = {"time_s", *joints}
    if set(names) != wanted or len(names) != len(wanted):
        missing, unknown = sorted(wanted - set(names)), sorted(set(names) - wanted)
        lacks = [f"lacks {', '.join(missing)}"] if missing else []
        lacks += [f"has {', '.join(unknown)}, which nothing drives"] if unknown else []
        raise ConfigError(f"motion {path} {' and '.join(lacks) or 'names a column twice'}: columns time_s and joints")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]], np.float64)
    except ValueError as error:
        raise ConfigError(f"motion {path}: {error}: every row has a number for each column") from error
    if table.ndim != 2 or len(table) < FEWEST_ROWS or not np.isfinite(table).all():
        raise ConfigError(f"motion {path}: {FEWEST_ROWS} rows and more of finite numbers: correct it")
    time_s = table[:, names.index("time_s")]
    if not (np.diff(time_s) > 0.0).all() or time_s[-1] - time_s[0] > LONGEST_S:
        raise ConfigError(f"motion {path}: time_s has to rise, over {LONGEST_S:g} s at most: correct it")
    return time_s, table[:, [names.index(joint) for joint in joints]]


def resampled(time_s: FloatArray, q: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray]:
    """A motion on a grid from its first row on: a cubic spline, at rest at both ends.

    Args:
        time_s: Of the rows, (n,).
        q: Angles, (n, joints).
        period_s: Of the grid.

    Returns:
        Times from 0 on (m,) and angles (m, joints); the last row is the end of the motion.
    """
    rate = _spline_rates(time_s, q)
    steps = math.ceil((time_s[-1] - time_s[0]) / period_s - 1e-9)
    at = np.minimum(time_s[0] + period_s * np.arange(steps + 1), time_s[-1])
    k = np.clip(np.searchsorted(time_s, at, side="right") - 1, 0, len(time_s) - 2)
    span = (time_s[k + 1] - time_s[k])[:, None]
    u = (at - time_s[k])[:, None] / span
    held, rise = 1.0 - u, u * u * (3.0 - 2.0 * u)
    slopes = u * held * (held * rate[k] - u * rate[k + 1]) * span
    return at - time_s[0], q[k] + rise * (q[k + 1] - q[k]) + slopes


def _spline_rates(time_s: FloatArray, q: FloatArray) -> FloatArray:
    """Rates at the rows (n, joints) with which the cubic through them has no jump of acceleration; 0 at both ends.

    Tridiagonal: r[k-1]/h[k-1] + 2 r[k] (1/h[k-1] + 1/h[k]) + r[k+1]/h[k] = 3 (d[k-1]/h[k-1] + d[k]/h[k]), d the slopes.
    """
    per = 1.0 / np.diff(time_s)
    slope = np.diff(q, axis=0) * per[:, None]
    right = 3.0 * (slope[:-1] * per[:-1, None] + slope[1:] * per[1:, None])
    rate, above = np.zeros_like(q), np.zeros(len(q))
    for k in range(1, len(q) - 1):
        pivot = 2.0 * (per[k - 1] + per[k]) - per[k - 1] * above[k - 1]
        above[k] = per[k] / pivot
        rate[k] = (right[k - 1] - per[k - 1] * rate[k - 1]) / pivot
    for k in range(len(q) - 2, 0, -1):
        rate[k] -= above[k] * rate[k + 1]
    return rate


def joint_ranges(urdf: str) -> dict[str, Range]:
    """Range and speed of every joint that turns; infinite where the URDF says none.

    Raises:
        ConfigError: it is not XML, or a limit is no number.
    """
    try:
        root = ET.fromstring(urdf)
        found = {}
        for joint in root.iterfind("joint"):
            limit = joint.find("limit")
            if joint.get("type") != "revolute" or limit is None:
                continue
            low, high = float(limit.get("lower", "nan")), float(limit.get("upper", "nan"))
            found[str(joint.get("name"))] = Range(low, high, float(limit.get("velocity", "inf")))
    except (ET.ParseError, ValueError) as error:
        raise ConfigError(f"the limits of the URDF cannot be read: {error}") from error
    return found


def _range(drive: Drive, joint: str, ranges: dict[str, Range]) -> Range:
    """Range of the URDF less the margin; its speed at most ``[drive] rate_rad_s``."""
    if joint not in ranges:
        raise ConfigError(
            f"the URDF gives {joint!r} no range (a revolute joint with <limit>): a driven joint needs a range"
        )
    low, high, rate = ranges[joint]
    if not low < high:
        raise ConfigError(f"the URDF's limits of {joint!r} are {low:g} to {high:g}: the lower below the upper")
    low, high = low + drive.margin_rad, high - drive.margin_rad
    if not low < high:
        raise ConfigError(f"[drive] margin_rad = {drive.margin_rad:g} leaves {joint!r} no range: make it smaller")
    rate = min(rate, drive.rate_rad_s if drive.rate_rad_s is not None else math.inf)
    if not 0.0 < rate < math.inf:
        raise ConfigError(f"{joint!r} has no largest rate: give <limit velocity> in the URDF, or [drive] rate_rad_s")
    return Range(low, high, rate)


def require_within(
    motion: str, joint: str, time_s: FloatArray, q: FloatArray, limits: Range, acceleration: float
) -> None:
    """Check one joint's motion on a grid; times and angles (n,).

    Raises:
        ConfigError: where it first leaves a limit.
    """
    step_s = time_s[1] - time_s[0]
    rate = np.diff(q) / step_s
    tried: tuple[tuple[FloatArray, float, float, str], ...] = (
        (q, limits.low, limits.high, "rad, its range less the margin"),
        (rate, -limits.rate, limits.rate, "rad/s, its largest rate"),
        (
            np.diff(rate) / step_s,
            -acceleration,
            acceleration,
            "rad/s2, [drive] acceleration_rad_s2 (a motion begins and ends at rest)",
        ),
    )
    for values, low, high, what in tried:
        slack = 1e-6 * (high - low)
        out = np.flatnonzero((values < low - slack) | (values > high + slack))
        if len(out):
            at = f"{joint} is at {values[out[0]]:.4g} after {time_s[out[0]]:.3g} s"
            raise ConfigError(f"motion {motion}: {at}, beyond {low:.4g} to {high:.4g} {what}")


def _counts(device: DrivenDevice, q: FloatArray) -> NDArray[np.int64]:
    return np.round(q * _per_rad(device)).astype(np.int64) + device.zero_count


def _per_rad(device: DrivenDevice) -> float:
    return device.gain * device.counts_per_revolution / math.tau


def _limits(drive: Drive, name: str, device: DrivenDevice, limits: Range) -> dict[str, Any]:
    """Of an ``AxisConfig``: what is the same for every kind of drive."""
    per_rad = abs(_per_rad(device))
    low, high = sorted(_counts(device, np.array([limits.low, limits.high])).tolist())
    return {
        "sent": f"{name}_sent",
        "low": low,
        "high": high,
        "rate": limits.rate * per_rad,
        "acceleration": drive.acceleration_rad_s2 * per_rad,
        "quick_stop": drive.quick_stop_rad_s2 * per_rad,
        "following_error": round(drive.following_error_rad * per_rad),
        "start_within": round(drive.start_within_rad * per_rad),
        "holds": drive.after_stop == "hold",
    }
