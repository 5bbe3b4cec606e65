"""Records to smoothed SI signals at the estimator's ticks, every channel through the same kernel, delays removed.

Samples keep their device ticks until the last moment: their times are taken from the timebase anew at every step, so a
better clock solution moves all of them together and no seam is left in a window.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard import config
from onboard.estimation.gates import GateReason, reasons, window_contains
from onboard.estimation.smoothing import Window
from onboard.flight.history import History
from onboard.flight.roles import Signal, roles_of
from onboard.timebase.timebase import Timebase

Floats = NDArray[np.float64]

UNUSABLE = int(SampleStatus.SATURATED | SampleStatus.NOT_VALID)
HISTORY_S = 2.0


class Smoothed(NamedTuple):
    """A channel at n ticks."""

    derivatives: tuple[Floats, ...]  # each (n, columns): the signal, its rate of change, ...
    sigma: tuple[Floats, ...]  # each (n, columns): noise of the above
    refused: NDArray[np.int64]  # (n,) GateReason


class Signals:
    """The smoothed channels of one vehicle."""

    def __init__(self, vehicle: config.Vehicle) -> None:
        self.width_s = vehicle.file.estimation.smoothing_ms * 1e-3
        self._signals = roles_of(vehicle).signals
        self._histories = {
            name: History(int(HISTORY_S / signal.period_s), len(signal.noise)) for name, signal in self._signals.items()
        }
        self._by_delay = {name: _by_delay(signal) for name, signal in self._signals.items()}
        self._reach_ns = round(1.5e9 * self.width_s)
        self._windows: deque[tuple[Window, tuple[Floats, Floats, float]]] = deque(maxlen=4)
        self._zero_lost: set[str] = set()
        self._told: set[tuple[str, str]] = set()

    def append(self, batches: Mapping[str, Rows]) -> dict[str, str]:
        """Take in what a step consumed; returns by channel what is newly wrong with it."""
        said = {}
        self._windows.clear()
        for name, arrived in batches.items():
            if name not in self._signals or not len(arrived):
                continue
            signal, history = self._signals[name], self._histories[name]
            restarts = np.flatnonzero(arrived["status"] & SampleStatus.AFTER_RESET)
            if len(restarts):
                history.clear()
                if not signal.absolute:
                    self._zero_lost.add(name)
            rows = arrived[restarts[-1] :] if len(restarts) else arrived
            values, usable = _values(signal, rows)
            why = ""
            if name in self._zero_lost:
                usable[:] = False
                why = "its counter began anew and its zero is lost: rows that need it are refused, zero it again"
            elif not np.isfinite(values).all():
                unit = rows["unit"][~np.isfinite(values[:, 0])][0].decode("ascii", "replace")
                why = f"unit {unit!r} is none of {', '.join(u.decode() for u in signal.si)}: not used, mend its device"
                values = np.nan_to_num(values)
            if why and (name, why) not in self._told:
                self._told.add((name, why))
                said[name] = why
            history.append(rows, values, usable)
        return said

    def together(
        self, names: Sequence[str], timebase: Timebase, at_ns: NDArray[np.int64], derivatives: int
    ) -> Smoothed:
        """Several channels at the same ticks, their columns side by side; a tick that one refuses is refused."""
        parts = [self.at(name, timebase, at_ns, derivatives) for name in names]
        refused = np.bitwise_or.reduce([part.refused for part in parts])
        values, sigma = (
            tuple(np.hstack(columns) for columns in zip(*sides, strict=True))
            for sides in ([part.derivatives for part in parts], [part.sigma for part in parts])
        )
        return Smoothed(values, sigma, refused)

    def at(self, name: str, timebase: Timebase, at_ns: NDArray[np.int64], derivatives: int) -> Smoothed:
        """Channel ``name`` and its first ``derivatives`` derivatives at vehicle times ``at_ns`` (n,), evenly spaced."""
        channel, history = self._signals[name], self._histories[name]
        n, columns = len(at_ns), len(channel.noise)
        # a sample is taken before it arrives: what arrived long before the window is not under it
        recent = slice(int(np.searchsorted(history.stamps["host_ns"], at_ns[0] - self._reach_ns)), None)
        stamps = history.stamps[recent]
        times_ns = timebase.time_ns(name, stamps) if len(stamps) > 1 else None
        if times_ns is None:
            nothing = np.full((n, columns), np.nan)
            reason = GateReason.GAP if len(stamps) < 2 else GateReason.NOT_SYNCHRONISED
            return Smoothed((nothing,) * (derivatives + 1), (nothing,) * (derivatives + 1), np.full(n, int(reason)))
        at_s = (at_ns - at_ns[0]) * 1e-9
        times_s = (times_ns - at_ns[0]) * 1e-9
        values, valid = history.values[recent], history.valid[recent]
        later = times_s[1:] > np.maximum.accumulate(times_s)[:-1]  # not so where a timer stood still
        waited = timebase.waited(name, stamps)
        if waited.any() or not later.all():
            kept = np.append(True, later) & ~waited
            times_s, values, valid = times_s[kept], values[kept], valid[kept]
        longest_gap_s = (4.5 if waited.any() else 3.5) * channel.period_s
        near = slice(*np.searchsorted(times_s, [at_s[0] - self.width_s, at_s[-1] + self.width_s]).tolist())
        times_s, values, valid = times_s[near], values[near], valid[near]
        refused = np.zeros(n, np.int64)
        if not valid.all():
            refused |= reasons(window_contains(times_s, ~valid, at_s, self.width_s), GateReason.SATURATED)
        values_out: list[Floats] = [np.full((n, columns), np.nan) for _ in range(derivatives + 1)]
        sigma_out = [np.full((n, columns), np.nan) for _ in range(derivatives + 1)]
        for delay_s, mine, noise in self._by_delay[name]:
            window = self._window(times_s - delay_s, at_s, longest_gap_s)
            for order in range(derivatives + 1):
                smoothed = window.apply(values[:, mine], order)
                values_out[order][:, mine] = smoothed.values
                sigma_out[order][:, mine] = smoothed.noise_gain[:, None] * noise
            refused |= reasons(~smoothed.valid, GateReason.GAP)
        # wrong by dt in time is wrong by dt times the next derivative, of which its own noise is no part
        timing_s = timebase.sigma_ns(name, int(at_ns[n // 2])) * 1e-9
        changes = [*values_out[1:], _rate_of_change(values_out[-1], at_s)]
        noises = [*sigma_out[1:], sigma_out[-1] * (np.pi / self.width_s)]
        for order, (change, noise) in enumerate(zip(changes, noises, strict=True)):
            moved = timing_s * np.sqrt(np.maximum(change * change - noise * noise, 0.0))
            sigma_out[order] = np.hypot(sigma_out[order], moved)
        return Smoothed(tuple(values_out), tuple(sigma_out), refused)

    def means(self, names: Sequence[str], timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int) -> Smoothed:
        """Channels as means over the tick of ``period_ns`` about each of ``at_ns``, their columns side by side.

        A tick with half of its samples or fewer has a gap; one with a sample that may not be used is refused. Samples
        are hardly ever even about a tick's middle, so the mean is that of a straight line through them.
        """
        parts = [self._means_of(name, timebase, at_ns, period_ns) for name in names]
        refused = np.bitwise_or.reduce([part.refused for part in parts])
        values = np.hstack([part.derivatives[0] for part in parts])
        return Smoothed((values,), (np.hstack([part.sigma[0] for part in parts]),), refused)

    def _means_of(self, name: str, timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int) -> Smoothed:
        channel, history = self._signals[name], self._histories[name]
        n, columns = len(at_ns), len(channel.noise)
        values, sigma = np.full((2, n, columns), np.nan)
        recent = slice(int(np.searchsorted(history.stamps["host_ns"], at_ns[0] - self._reach_ns)), None)
        stamps = history.stamps[recent]
        times_ns = timebase.time_ns(name, stamps) if len(stamps) > 1 else None
        if times_ns is None:
            reason = GateReason.GAP if len(stamps) < 2 else GateReason.NOT_SYNCHRONISED
            return Smoothed((values,), (sigma,), np.full(n, int(reason)))
        times_s = (times_ns - at_ns[0]) * 1e-9
        kept = np.append(True, times_s[1:] > np.maximum.accumulate(times_s)[:-1]) & ~timebase.waited(name, stamps)
        times_s, samples = times_s[kept], history.values[recent][kept]
        unusable = np.append(0, np.cumsum(~history.valid[recent][kept]))
        at_s, half_s = (at_ns - at_ns[0]) * 1e-9, 0.5e-9 * period_ns
        refused = np.zeros(n, np.int64)
        for delay_s, mine, noise in self._by_delay[name]:
            t = times_s - delay_s
            low, high = np.searchsorted(t, at_s - half_s), np.searchsorted(t, at_s + half_s)
            refused |= reasons(high - low <= half_s / channel.period_s, GateReason.GAP)
            refused |= reasons(unusable[high] > unusable[low], GateReason.SATURATED)
            for tick in np.flatnonzero(refused == 0):
                under = slice(low[tick], high[tick])
                offset_s = t[under] - at_s[tick]
                middle_s = offset_s.mean()
                weights = 1.0 / len(offset_s) - middle_s * (offset_s - middle_s) / ((offset_s - middle_s) ** 2).sum()
                values[tick, mine] = weights @ samples[under][:, mine]
                sigma[tick, mine] = noise * np.sqrt(weights @ weights)
        values[refused != 0] = sigma[refused != 0] = np.nan
        return Smoothed((values,), (sigma,), refused)

    def _window(self, times_s: Floats, at_s: Floats, gap_s: float) -> Window:
        """The kernel over these samples; channels that were sampled together share one."""
        for window, key in self._windows:
            if key[2] == gap_s and np.array_equal(key[0], times_s) and np.array_equal(key[1], at_s):
                return window
        window = Window(times_s, at_s, self.width_s, max_gap_s=gap_s)
        self._windows.append((window, (times_s, at_s, gap_s)))
        return window


def _by_delay(signal: Signal) -> list[tuple[float, list[int], Floats]]:
    """The columns by their filter's delay, with their noise."""
    groups = {d: [i for i, own in enumerate(signal.delays_s) if own == d] for d in signal.delays_s}
    return [(delay_s, columns, np.array(signal.noise)[columns]) for delay_s, columns in groups.items()]


def _rate_of_change(values: Floats, at_s: Floats) -> Floats:
    """Of ``values`` (n, columns) from tick to tick; 0 where there is no neighbour to tell it."""
    rate = np.zeros_like(values)
    if len(at_s) > 1:
        steps = np.diff(values, axis=0) / (at_s[1] - at_s[0])
        rate[0], rate[-1] = steps[0], steps[-1]
        rate[1:-1] = 0.5 * (steps[1:] + steps[:-1])
    return np.nan_to_num(rate)


def _values(signal: Signal, rows: Rows) -> tuple[Floats, NDArray[np.bool_]]:
    """SI values, (n, columns), gyro and accelerometer in sensor axes or one scalar; and which may be used, (n,)."""
    usable = (rows["status"] & UNUSABLE) == 0
    if not signal.si:
        gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"].astype(np.float64)[:, None]
        accel = rows["accel_raw"] * rows["accel_scale_m_s2"].astype(np.float64)[:, None]
        return np.hstack([gyro, accel]), usable
    factor = np.full(len(rows), np.nan)
    for unit, si in signal.si.items():
        factor[rows["unit"] == unit] = si
    values: Floats = (rows["value_raw"] - signal.zero_count) * rows["scale"] * factor
    return values[:, None], usable & (np.abs(values) < signal.limit)
