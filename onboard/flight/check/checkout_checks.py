"""Automatic checks of a checkout: a moved joint's sense and range, a cell without load, the log of a dry run."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.records import GAP, Severity
from onboard import config
from onboard.devices.roles import LoadCellKeys
from onboard.dynamics.model.vehicle import Joint
from onboard.estimation.arrays import FloatArray
from onboard.recording.reader import LogReader

MOVED_RAD = np.radians(5.0)  # before this, a joint's sense is not judged
_COVERED = 0.9  # of the URDF's range
_BEYOND_RAD = np.radians(2.0)  # of its limits
_MOVED_m, _BEYOND_m = 5e-3, 2e-3  # the same of one that slides
_TARE = 0.05  # of the capacity: largest reading of a cell without load
_TIMES_NOISE = 5.0
_FEWEST = 20  # samples


class CheckResult(NamedTuple):
    """Of an automatic check."""

    problems: tuple[str, ...]  # with the remedy; none: passed
    found: str  # measured


def judge_motion(joint: Joint, values: FloatArray, swings: dict[str, float], *, is_rate: bool = False) -> CheckResult:
    """Sense and range of a joint that the operator moved, first in its positive sense and then from stop to stop.

    Args:
        joint: of the URDF.
        values: its angle, rad (place, m, of one that slides), or its rate where ``is_rate``, (n,).
        swings: how far each other joint moved meanwhile, by name, rad.
        is_rate: only the sense is judged.
    """
    if len(values) < _FEWEST:
        return CheckResult((f"{len(values)} samples only: check power and wiring of its encoder",), "")
    unit, factor = ("deg", np.degrees(1.0)) if joint.revolute else ("mm", 1e3)
    moved = values if is_rate else values - np.median(values[: max(5, len(values) // 100)])
    threshold = 0.2 * float(np.abs(moved).max()) if is_rate else (MOVED_RAD if joint.revolute else _MOVED_m)
    low, high, span = float(values.min()), float(values.max()), float(np.ptp(values))
    if is_rate:
        found = f"rate {factor * low:.1f} to {factor * high:.1f} {unit}/s"
    else:
        found = f"read {factor * low:.1f} to {factor * high:.1f} {unit}"
    away = np.flatnonzero(np.abs(moved) > threshold)
    if not away.size or span == 0.0:
        return CheckResult((f"it moved by {factor * span:.2f} {unit} only: move it, or check its encoder",), found)
    problems = []
    if moved[away[0]] < 0.0:
        problems.append("it read backwards: exchange the encoder's A and B, or correct the axis in the URDF")
    further = {name: swing for name, swing in swings.items() if swing > span and not is_rate}
    if further:
        problems.append(f"{', '.join(further)} moved further: its encoder is wired or named as another joint's")
    if not is_rate and np.isfinite([joint.low, joint.high]).all():
        covered = (min(high, joint.high) - max(low, joint.low)) / (joint.high - joint.low)
        found += (
            f", {100.0 * max(covered, 0.0):.0f} % of the URDF's {factor * joint.low:.0f} to {factor * joint.high:.0f}"
        )
        beyond = max(joint.low - low, high - joint.high)
        if beyond > (_BEYOND_RAD if joint.revolute else _BEYOND_m):
            problems.append(
                f"it reads {factor * beyond:.1f} {unit} beyond the URDF's limits: correct zero_count, "
                "counts_per_revolution, or the limits"
            )
        elif covered < _COVERED:
            problems.append(f"it covered {100.0 * max(covered, 0.0):.0f} % of its range: something is in its way")
    return CheckResult(tuple(problems), found)


def judge_tare(values_n: FloatArray, keys: LoadCellKeys) -> CheckResult:
    """Reading of a cell without load, in N, calibration taken off."""
    if len(values_n) < _FEWEST:
        return CheckResult((f"{len(values_n)} samples only: check its power and wiring",), "")
    mean, spread = float(values_n.mean()), float(values_n.std())
    found = f"{mean:.3g} N without load, scatter {spread:.2g} N"
    problems = []
    if abs(mean) > _TARE * keys.capacity_N:
        problems.append(f"more than {100 * _TARE:.0f} % of {keys.capacity_N:g} N: unload it, or correct offset_N")
    if spread > _TIMES_NOISE * keys.noise_N:
        problems.append(f"it scatters {spread / keys.noise_N:.0f} times noise_N: keep it still, or check its cable")
    elif np.ptp(values_n) == 0.0:
        problems.append("it does not change at all: check that its converter runs")
    return CheckResult(tuple(problems), found)


def look_at(vehicle: config.Vehicle, log: LogReader, died: Sequence[str] = ()) -> CheckResult:
    """Whether the log of a dry run has rows of every device, and no error.

    Args:
        vehicle: that was flown.
        log: of the run.
        died: workers that did.
    """
    counts = dict.fromkeys(vehicle.channels, 0)
    errors: list[str] = []
    missing = 0
    for channel, rows in log.batches():
        if channel in counts:
            counts[channel] += len(rows)
        if "severity" in (rows.dtype.names or ()):
            loud = rows[rows["severity"] >= Severity.ERROR]
            errors += [f"{row['source'].decode()}: {row['text'].decode('utf-8', 'replace')}" for row in loud]
        if rows.dtype == GAP:
            missing += int((rows["last_missing"] - rows["first_missing"] + 1).sum())
    silent = [
        f"{channel} recorded nothing"
        for channel, count in counts.items()
        if not count and channel in {next(iter(d.channels(n))) for n, d in vehicle.file.device.items()}
    ]
    ended = [f"the {name} worker died" for name in died]
    torn = ["the log is damaged"] if log.damage else []
    found = f"{log.path.name}: {sum(counts.values())} rows of {len(counts)} channels, {missing} missing"
    return CheckResult((*ended, *torn, *silent, *dict.fromkeys(errors)), found)
