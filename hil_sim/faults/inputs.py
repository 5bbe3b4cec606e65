"""Applies input faults to analogue inputs: stuck, saturated, wrong, delayed."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hil_sim.faults.plan import NEVER, DeviceFaults
from hil_sim.faults.vocabulary import INPUT_KINDS, MEMORYLESS, FaultKind
from hil_sim.sensing.analog import ImuAnalog, KnownAhead, ManyValues, ScalarAnalog

_INERTIAL = np.array([0, 1, 2, 4, 5, 6])  # columns of ImuAnalog.counts without the temperature


class FaultyScalar:
    """A ``ScalarAnalog`` with the faults ``stuck``, ``saturated``, ``wrong`` and ``delayed``; angles, rad: ``slipped``.

    Args:
        analog: The healthy input.
        faults: Faults of its device.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0.
    """

    def __init__(self, analog: ScalarAnalog, faults: DeviceFaults, start_ns: int) -> None:
        self._analog = analog
        self._faults, self._is_faulty = faults, bool(faults)
        self._start_ns = start_ns
        self._last = math.nan

    def value(self, time_s: float) -> float:
        """As ``ScalarAnalog.value``; saturation is an infinite value for the converter to clip."""
        if not self._is_faulty:
            return self._analog.value(time_s)
        now_ns = self._start_ns + round(time_s * 1e9)
        saturated = self._faults.active(FaultKind.SATURATED, now_ns)
        if saturated is not None:
            return math.copysign(math.inf, saturated.value)
        if self._faults.active(FaultKind.STUCK, now_ns) is not None and not math.isnan(self._last):
            return self._last
        delayed = self._faults.active(FaultKind.DELAYED, now_ns)
        reading = self._analog.value(time_s if delayed is None else max(time_s - delayed.value, 0.0))
        wrong = self._faults.active(FaultKind.WRONG, now_ns)
        self._last = reading if wrong is None else reading * (1.0 + wrong.value)
        slipped = self._faults.active(FaultKind.SLIPPED, now_ns)
        self._last += 0.0 if slipped is None else math.radians(slipped.value)
        return self._last

    def values(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """``value`` at each of ``times_s`` (n,), in order."""
        if not len(times_s):
            return np.zeros(0)
        times_ns = self._start_ns + np.rint(times_s * 1e9).astype(np.int64)
        first_ns, last_ns = times_ns[[0, -1]].tolist()
        is_stuck = self._faults.quiet_until(first_ns, *MEMORYLESS) <= last_ns
        if is_stuck or not isinstance(self._analog, ManyValues):
            return np.array([self.value(time_s) for time_s in times_s.tolist()])
        if self._faults.over(first_ns):
            return self._analog.values(times_s)
        at: NDArray[np.float64] = times_s - self._sizes(FaultKind.DELAYED, times_ns)
        readings = self._analog.values(np.where(at < times_s, np.maximum(at, 0.0), times_s))
        readings = readings * (1.0 + self._sizes(FaultKind.WRONG, times_ns))
        readings += self._sizes(FaultKind.SLIPPED, times_ns, math.radians)
        saturated = self._sizes(FaultKind.SATURATED, times_ns, lambda sign: math.copysign(math.inf, sign))
        unsaturated = readings[saturated == 0.0]
        self._last = float(unsaturated[-1]) if len(unsaturated) else self._last
        return np.where(saturated == 0.0, readings, saturated)

    def _sizes(
        self, kind: FaultKind, times_ns: NDArray[np.int64], size_of: Callable[[float], float] = float
    ) -> NDArray[np.float64]:
        """Of the fault of this kind that is in force at each of the times, (n,); 0: none is."""
        sizes = np.zeros(len(times_ns))
        for window in reversed(self._faults.windows):  # the first in force counts
            if window.kind is kind:
                sizes[(times_ns >= window.start_ns) & (times_ns < window.end_ns)] = size_of(window.value)
        return sizes


class FaultyImu:
    """An ``ImuAnalog`` with the same faults. Arguments as of ``FaultyScalar``."""

    def __init__(self, analog: ImuAnalog, faults: DeviceFaults, start_ns: int) -> None:
        self._analog = analog
        self._start_ns = start_ns
        kinds = (FaultKind.SATURATED, *INPUT_KINDS)
        self._windows = [w for w in faults.windows if w.kind in kinds]
        self._ahead = analog if isinstance(analog, KnownAhead) else None
        self._last: NDArray[np.int16] | None = None

    @property
    def known_s(self) -> float:
        """As of ``KnownAhead``; 0 where no future is known."""
        return 0.0 if self._ahead is None else self._ahead.known_s

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        """As ``ImuAnalog.counts``."""
        counts = self._analog.counts(times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg)
        if not self._windows:
            return counts
        counts = counts.copy()
        times_ns = self._start_ns + times_s * 1e9
        for window in self._windows:
            inside = np.flatnonzero((times_ns >= window.start_ns) & (times_ns < window.end_ns))
            if inside.size == 0:
                continue
            if window.kind is FaultKind.DELAYED:
                before_s = np.maximum(times_s[inside] - window.value, 0.0)
                counts[inside] = self._analog.counts(before_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg)
            elif window.kind is FaultKind.WRONG:
                cells = inside[:, np.newaxis], _INERTIAL
                readings = np.rint(counts[cells] * (1.0 + window.value))
                counts[cells] = np.clip(readings, -32768, 32767).astype(np.int16)
            elif window.kind is FaultKind.SATURATED:
                counts[inside[:, np.newaxis], _INERTIAL] = -32768 if window.value < 0 else 32767
            elif inside[0] > 0:
                counts[inside] = counts[inside[0] - 1]
            else:
                counts[inside] = counts[inside[0]] if self._last is None else self._last
        self._last = counts[-1]
        return counts


def reported_phases(changes: list[tuple[int, int]], faults: DeviceFaults) -> list[tuple[int, int]]:
    """Reported changes (time in ns, code) of the true ones, with the faults of an input.

    Args:
        changes: What changes, in order.
        faults: Faults of the device: ``stuck``, ``wrong``, ``delayed``.
    """
    windows = [w for w in faults.windows if w.kind in INPUT_KINDS]
    if not windows:
        return changes
    late: list[tuple[int, int]] = []
    for time_ns, code in changes:
        delayed = faults.active(FaultKind.DELAYED, time_ns)
        late.append((time_ns + (0 if delayed is None else round(delayed.value * 1e9)), code))
    late.sort(key=lambda change: change[0])
    told: list[tuple[int, int]] = []
    bounds = {t for w in windows for t in (w.start_ns, w.end_ns) if t < NEVER and w.kind is not FaultKind.DELAYED}
    for now_ns in sorted(bounds | {time_ns for time_ns, _ in late}):
        code = next((c for t, c in reversed(late) if t <= now_ns), 0)
        if faults.active(FaultKind.STUCK, now_ns) is not None:
            continue
        wrong = faults.active(FaultKind.WRONG, now_ns)
        code = code if wrong is None else (code + int(wrong.value)) & 0xFF
        if code != (told[-1][1] if told else 0):
            told.append((now_ns, code))
    return told
