"""Which readings of a channel are stuck, and the events that report it; ``onboard.estimation.stuck`` decides."""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, Severity
from onboard.devices import si
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.stuck import NONE, StuckReadings, longest_run

_OVER_S = 1.0  # without a stuck reading before it is said to be over: a freeze that comes and goes is reported once


class StuckEvent(NamedTuple):
    """An event about a channel."""

    severity: Severity
    code: str
    text: str


class StuckWatch:
    """Watches one channel.

    Args:
        signal: what is known of it.
    """

    def __init__(self, signal: SmoothedChannel) -> None:
        self._signal = signal
        self._readings: StuckReadings | None = None  # its counts are not known before the first rows
        self._sequence: int | None = None  # of the last row
        self._fine = 0  # readings since the last stuck one
        self._told = False

    def watch(self, rows: Rows, usable: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], slice, StuckEvent | None]:
        """Judge the next rows, at least one.

        Args:
            rows: of the channel, in order.
            usable: (n,) those that are good otherwise.

        Returns:
            Which are stuck, (n,); which of those before them are, counted from the first of these; what the
            event reports.
        """
        if self._readings is None:
            longest, travels = _longest(self._signal, rows[0]), self._signal.travels and not self._signal.repeats
            self._readings = StuckReadings(len(self._signal.noise), longest, travels=travels)
        raw = np.hstack([rows["gyro_raw"], rows["accel_raw"]]) if not self._signal.si else rows["value_raw"][:, None]
        stuck, before = np.zeros(len(rows), np.bool_), NONE
        starts = breaks(rows, self._sequence)
        self._sequence = int(rows["sequence"][-1])
        for first, last in itertools.pairwise(sorted({0, *starts, len(rows)})):
            if first in starts:
                self._readings.forget()
            steps = raw[first:last] / self._signal.quantum_counts
            stuck[first:last], reaching = self._readings.watch(steps, usable[first:last])
            begin, end = first + reaching.start, first + reaching.stop
            stuck[max(0, begin) : max(0, end)] = True
            if begin < min(end, 0):
                before = slice(begin, min(end, 0))
        return stuck, before, self._say(raw, stuck, before != NONE)

    def _say(self, raw: NDArray[np.generic], stuck: NDArray[np.bool_], before: bool) -> StuckEvent | None:
        if stuck.any() or before:
            at = np.flatnonzero(stuck)
            self._fine = len(stuck) - 1 - int(at[-1]) if len(at) else len(stuck)
            if self._told:
                return None
            self._told = True
            value = raw[int(at[0]) if len(at) else 0]
            held = ", ".join(str(count) for count in np.atleast_1d(value))
            text = f"it reads {held} again and again where it must change: rows that need it are refused meanwhile"
            return StuckEvent(Severity.ERROR, "stuck", text)
        self._fine += len(stuck)
        if self._told and self._fine * self._signal.period_s > _OVER_S:
            self._told = False
            return StuckEvent(Severity.INFO, "stuck_over", "its readings change again")
        return None


def breaks(rows: Rows, last: int | None) -> list[int]:
    """Which rows do not follow on the one before.

    Args:
        rows: in order, at least one.
        last: sequence number of the one before these; None: there was none.
    """
    numbers, resets = rows["sequence"], rows["status"] & si.AFTER_RESET
    begins = int(numbers[0]) - 1 if last is None else last
    if int(numbers[-1]) - begins == len(rows) and not resets.any():  # they ascend
        return []
    return np.flatnonzero((np.diff(numbers.astype(np.int64), prepend=begins) != 1) | (resets != 0)).tolist()


def _longest(signal: SmoothedChannel, row: np.void) -> float:
    """Run that may be chance."""
    if signal.repeats:
        return math.inf
    if signal.si:
        scales = [float(row["scale"]) * signal.si.get(row["unit"], math.nan)]
    else:
        scales = [float(row["gyro_scale_rad_s"])] * 3 + [float(row["accel_scale_m_s2"])] * 3
    steps = [signal.quantum_counts * abs(scale) for scale in scales]
    counts = [noise / step if step else math.inf for noise, step in zip(signal.noise, steps, strict=True)]
    delay_s = max(signal.delays_s)
    return longest_run(counts, math.exp(-signal.period_s / delay_s) if delay_s > 0.0 else 0.0)
