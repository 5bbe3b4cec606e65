"""A converter that runs by itself: it samples its input at its own rate and holds the last sample till asked."""

import numpy as np

from hil_sim.sensing.analog import ChipClock, ScalarAnalog


class SampledScalar:
    """One converter; its clock starts at power-up.

    Args:
        analog: Its input.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0.
        rate_hz: Samples a second on its own clock.
    """

    def __init__(self, analog: ScalarAnalog, clock: ChipClock, start_ns: int, rate_hz: float) -> None:
        self.value = 0.0
        self.samples = 0
        self._analog = analog
        self._clock = clock
        self._start_ns = start_ns
        self._period_ns = 1e9 / rate_hz
        self._origin_chip_ns = 0
        self._next = 0

    def power_up(self, now_ns: int, rate_hz: float | None = None) -> None:
        """Begin again, with another rate if one is given."""
        if rate_hz is not None:
            self._period_ns = 1e9 / rate_hz
        self._origin_chip_ns = self._clock.chip_ns(now_ns)
        self._next = 0

    def settle(self, now_ns: int) -> list[float]:
        """Samples made since the last call; ``value`` is the newest of all."""
        own_ns = self._clock.chip_ns(now_ns) - self._origin_chip_ns
        n = int(own_ns // self._period_ns) + 1 - self._next
        if n <= 0:
            return []
        ticks_ns = self._origin_chip_ns + (self._next + np.arange(n, dtype=np.float64)) * self._period_ns  # (n,)
        times_s = np.minimum(self._clock.times_s(ticks_ns), (now_ns - self._start_ns) * 1e-9)  # (n,)
        self._next += n
        self.samples += n
        made = [self._analog.value(time_s) for time_s in times_s.tolist()]
        self.value = made[-1]
        return made
