"""Device clock from arrival stamps alone: a line through the least delayed arrivals.

Of each block of time only the least delayed arrival is used; a line through the last of these, minus their scatter (for
delays with an exponential tail the mean delay of the least delayed one), gives offset and rate. A constant delay beyond
``delay_ns`` remains as an error of the offset.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from onboard.timebase.clock import DRIFT_PER_S, ClockSolution, ClockState, FlywheelingClock


class ArrivalClock(FlywheelingClock):
    """Fits one device's clock to the arrival times of its samples.

    Args:
        nominal_period_ns: data-sheet length of a tick.
        tolerance: largest relative error of it.
        delay_ns: known lower bound of the time from the sample to its arrival.
        delay_sigma_ns: its standard deviation.
        drift_per_s: largest change of the relative rate per second.
    """

    BLOCK_S = (0.05, 1.0)  # the first blocks are short, for an early first fit
    BLOCKS = 16
    BLOCKS_TO_LOCK = 4
    GATE_NS, GATE_SCATTERS = 3e6, 8.0  # larger residuals: the host stalled, or the device's clock jumped
    FIRST_SCATTER_NS = 1e6  # scatter assumed in weighing arrivals against the nominal rate
    STRANGERS_TO_RESTART = 3
    flywheel_after_ns, invalid_sigma_ns = 2e9, 20e6

    def __init__(
        self,
        nominal_period_ns: float,
        tolerance: float = 0.06,
        delay_ns: float = 0.0,
        delay_sigma_ns: float = 0.0,
        drift_per_s: float = DRIFT_PER_S,
    ) -> None:
        self.nominal_period_ns, self.tolerance = nominal_period_ns, tolerance
        self.delay_ns, self.delay_sigma_ns, self.drift_per_s = delay_ns, delay_sigma_ns, drift_per_s
        self.rejected = 0
        self.restart()

    def restart(self) -> None:
        """Restart from the nominal period."""
        self.state = ClockState.ACQUIRING
        self.marks = 0
        self.residual_ns = 0.0
        self._blocks: deque[tuple[int, int]] = deque(maxlen=self.BLOCKS)  # (tick, host_ns), least delayed
        self._block: tuple[float, int, int] | None = None  # lateness, tick, host_ns
        self._block_ns = 0  # when the current one began
        self._strangers = 0
        self._tick, self._reference_ns, self._period_ns = 0, 0.0, self.nominal_period_ns
        self._scatter_ns, self._span_s = math.inf, 0.0

    def arrived(self, tick: int, host_ns: int) -> bool:
        """Take the arrival of sample ``tick`` at ``host_ns``; returns whether the solution changed."""
        gate_ns = self.GATE_NS + self.GATE_SCATTERS * self._scatter_ns
        lateness = host_ns - (self._reference_ns + (tick - self._tick) * self._period_ns)
        if lateness < -gate_ns and self.trusted:
            self.restart()  # arrival before the sample: the ticks have restarted
        if not self._block_ns:
            self._block_ns, self._tick, self._reference_ns, lateness = host_ns, tick, float(host_ns), 0.0
        if self._block is None or lateness < self._block[0]:
            self._block = (lateness, tick, host_ns)
        shortest, longest = self.BLOCK_S
        if host_ns - self._block_ns < 1e9 * (longest if self.marks >= self.BLOCKS else shortest):
            return False
        (lateness, *least), self._block, self._block_ns = self._block, None, host_ns
        if self.trusted and lateness > gate_ns:
            self.rejected += 1
            self._strangers += 1
            self.state = ClockState.FLYWHEEL
            if self._strangers >= self.STRANGERS_TO_RESTART:
                self.restart()
            return False
        self._strangers = 0
        self._blocks.append((least[0], least[1]))
        self.marks += 1
        self.residual_ns = lateness
        self._fit()
        return self.trusted

    def _fit(self) -> None:
        tick, host_ns = self._blocks[-1]
        ticks = np.array([float(t - tick) for t, _ in self._blocks])
        times = np.array([float(h - host_ns) for _, h in self._blocks]) - ticks * self.nominal_period_ns
        mean_tick, mean_time = ticks.mean(), times.mean()
        limit = self.tolerance * self.nominal_period_ns
        square = float(np.sum((ticks - mean_tick) ** 2)) + (2.0 * self.FIRST_SCATTER_NS / limit) ** 2
        slope = float(np.sum((ticks - mean_tick) * (times - mean_time))) / square
        slope = min(max(slope, -limit), limit)
        residuals = times - mean_time - slope * (ticks - mean_tick)
        self._scatter_ns = float(np.sqrt(np.sum(residuals**2) / max(len(ticks) - 2, 1)))
        self._span_s = float(np.ptp(ticks)) * self.nominal_period_ns * 1e-9
        self._period_ns = self.nominal_period_ns + slope
        self._tick = tick
        self._reference_ns = host_ns + mean_time - slope * mean_tick - self._scatter_ns
        if len(self._blocks) >= self.BLOCKS_TO_LOCK:
            self.state = ClockState.LOCKED

    @property
    def period_ns(self) -> float:
        """Length of a tick, ns."""
        return self._period_ns

    def time_ns(self, ticks: NDArray[np.generic] | float) -> NDArray[np.int64]:
        """Vehicle time [ns] of ``ticks`` (n,), known delay removed, int64 (n,)."""
        numbers = np.asarray(ticks)
        numbers = numbers.astype(np.int64) if numbers.dtype.kind in "ui" else numbers
        whole = int(self._reference_ns)
        after = (numbers - self._tick) * self._period_ns + (self._reference_ns - whole - self.delay_ns)
        times: NDArray[np.int64] = whole + np.rint(after).astype(np.int64)
        return times

    def tick_at(self, time_ns: int) -> float:
        """Fractional tick at vehicle time ``time_ns``."""
        return self._tick + (time_ns + self.delay_ns - self._reference_ns) / self._period_ns

    def sigma_ns(self, tick: float) -> float:
        """1-sigma of the vehicle time of ``tick`` [ns]."""
        away_s = abs(tick - self._tick) * self.nominal_period_ns * 1e-9
        rate = self._sigma_rate * 1e9
        drifted_ns = 1e9 * self.drift_per_s * (0.5 * away_s + self._span_s / 6.0) * (away_s + 0.5 * self._span_s)
        return math.hypot(self._sigma_ns, rate * away_s, drifted_ns / math.sqrt(3.0), self.delay_sigma_ns)

    @property
    def _sigma_ns(self) -> float:
        """1-sigma at the newest end of the line [ns]: scatter through the fit, plus that of the correction."""
        n = max(len(self._blocks), 1)
        return self._scatter_ns * math.sqrt(4.0 / n + 0.25)

    @property
    def _sigma_rate(self) -> float:
        n = max(len(self._blocks), 1)
        fitted = self._scatter_ns * 1e-9 * math.sqrt(12.0 / n) / self._span_s if self._span_s else math.inf
        return min(fitted, self.tolerance)

    @property
    def solution(self) -> ClockSolution:
        """Solution at the last arrival used."""
        return self.solution_at(self._tick)

    def solution_at(self, tick: float) -> ClockSolution:
        """The solution referred to ``tick``."""
        return ClockSolution(
            tick,
            self._reference_ns - self.delay_ns + (tick - self._tick) * self._period_ns,
            self._period_ns,
            self.sigma_ns(tick),
            self._sigma_rate * self.nominal_period_ns,
            self._scatter_ns,
            self.marks,
            self.state,
        )
