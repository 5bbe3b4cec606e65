"""Applies oscillator faults to a device's clock: slow, clock jump."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.faults.plan import DeviceFaults
from hil_sim.faults.vocabulary import FaultError, FaultKind
from hil_sim.sensing.analog import ChipClock


class _Segment(NamedTuple):
    """From ``healthy_ns`` of the healthy clock on, the faulty one continues from ``shown_ns`` at ``rate``."""

    healthy_ns: float
    shown_ns: float
    rate: float

    def shown_at(self, healthy_ns: float) -> float:
        return self.shown_ns + self.rate * (healthy_ns - self.healthy_ns)


class FaultyClock:
    """A ``ChipClock`` with the faults ``slow`` and ``clock_jump``.

    A reading skipped by a forward jump maps to the instant of the jump.

    Args:
        clock: The healthy oscillator.
        faults: Faults of its device.

    Raises:
        FaultError: two of them overlap, or one that makes it run backwards.
    """

    def __init__(self, clock: ChipClock, faults: DeviceFaults) -> None:
        self._clock = clock
        self._segments: list[_Segment] = []
        for window in faults.windows:
            if window.kind not in (FaultKind.SLOW, FaultKind.CLOCK_JUMP):
                continue
            start_ns, end_ns, rate, ahead_ns = window.start_ns, window.end_ns, 1.0 - window.value, 0.0
            if window.kind is FaultKind.CLOCK_JUMP:
                ahead_ns = max(window.value, 0.0) * 1e9
                rate, end_ns = 0.0, start_ns + max(-round(window.value * 1e9), 0)
            if rate < 0.0:
                raise FaultError(f"{faults.device} is slow by {window.value}: a clock stands still at 1; give less.")
            begins = float(clock.chip_ns(start_ns))
            if not self._segments:
                self._segments.append(_Segment(-math.inf, -math.inf, 1.0))
                shown = begins
            elif begins < self._segments[-1].healthy_ns:
                raise FaultError(f"The clock faults of {faults.device} overlap; set them apart.")
            else:
                shown = self._segments[-1].shown_at(begins)
            if end_ns > start_ns:
                self._segments.append(_Segment(begins, shown + ahead_ns, rate))
                begins, shown = float(clock.chip_ns(end_ns)), self._segments[-1].shown_at(float(clock.chip_ns(end_ns)))
                self._segments.append(_Segment(begins, shown, 1.0))
            else:
                self._segments.append(_Segment(begins, shown + ahead_ns, 1.0))

    def time_ns(self, chip_ns: int) -> int:
        """See ``ChipClock``."""
        return self._clock.time_ns(round(self._healthy(chip_ns)) if self._segments else chip_ns)

    def chip_ns(self, time_ns: int) -> int:
        """See ``ChipClock``."""
        healthy_ns = self._clock.chip_ns(time_ns)
        for segment in reversed(self._segments[1:]):
            if healthy_ns >= segment.healthy_ns:
                return round(segment.shown_at(healthy_ns))
        return healthy_ns

    def times_s(self, chip_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        """See ``ChipClock``."""
        if not self._segments:
            return self._clock.times_s(chip_ns)
        return self._clock.times_s(np.array([self._healthy(value) for value in chip_ns.tolist()], np.float64))

    def _healthy(self, shown_ns: float) -> float:
        """The healthy clock's time when this one first shows ``shown_ns``."""
        for segment, following in zip(self._segments, [*self._segments[1:], None], strict=True):
            if following is None or shown_ns < following.shown_ns:
                if segment.shown_ns == -math.inf:
                    return min(shown_ns, math.inf if following is None else following.healthy_ns)
                healthy = segment.healthy_ns
                if segment.rate > 0.0:
                    healthy += (shown_ns - segment.shown_ns) / segment.rate
                return healthy if following is None else min(max(healthy, segment.healthy_ns), following.healthy_ns)
        raise AssertionError("the last segment has no end")
