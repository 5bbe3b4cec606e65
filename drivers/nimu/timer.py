"""Unwraps the nIMU's 16-bit timer and counts lost packets.

In an unbroken stream successive packets are one sample period apart and no host time is needed. Where packets are
missing the timer gives the elapsed time modulo 0.142 s, and host time the number of wraps. Only the last packet of a
read with a fresh stamp is compared with host time; earlier ones may have been buffered.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.nimu.packet import TICK_NS
from drivers.unwrap import steps

TURN = 1 << 16
TURN_NS = TURN * TICK_NS
REBOOT_NS = 200e6  # a loss this long may hide a restart of the timer
PERIOD_PACKETS = 8  # contiguous ones, to learn the period from
PERIOD_GAIN = 0.05
MISFIT = 0.25  # fraction of a period: further from a whole number of samples, the timer restarted


class PacketTicks(NamedTuple):
    """Timer positions of the packets of one read.

    Attributes:
        ticks: Timer, unwrapped, shape (n,).
        steps: Samples since the packet before, 1 in an unbroken stream, shape (n,).
        restarted: The timer restarted, or may have, before this packet, shape (n,).
        stuck: The timer has not moved since the packet before, shape (n,).
    """

    ticks: NDArray[np.uint64]
    steps: NDArray[np.int64]
    restarted: NDArray[np.bool_]
    stuck: NDArray[np.bool_]


class PacketTimer:
    """Tracks the timer of one nIMU; the sample period is learnt from the stream."""

    def __init__(self) -> None:
        self._tick: int | None = None
        self._timer = 0
        self._period: float | None = None
        self._first: list[int] = []  # ticks between contiguous packets, until the period is known
        self._reference: tuple[int, int] | None = None  # host ns and tick of the last packet of a fresh read

    @property
    def period_ns(self) -> float | None:
        """Sample period by the nominal tick, ns; None while it is not known."""
        return None if self._period is None else self._period * TICK_NS

    def place(self, timer: NDArray[np.uint16], broken: NDArray[np.bool_], host_ns: int, fresh: bool) -> PacketTicks:
        """Place the packets of one read; there is at least one.

        Args:
            timer: Their timer words, shape (n,).
            broken: Bytes were lost or bad before this packet, shape (n,).
            host_ns: CLOCK_MONOTONIC when the read returned.
            fresh: The last packet had just arrived then.
        """
        first = self._tick is None
        since = steps(timer, 16, int(timer[0]) if first else self._timer) % TURN
        stuck = (since == 0) & ~broken
        stuck[0] &= not first
        self._learn(since[~(broken | stuck)][1 if first else 0 :])
        suspect = broken | ~self._is_one_period(since)
        suspect[0] &= not first
        restarted = np.zeros(len(timer), np.bool_)
        if fresh and not (first or stuck.any()):
            turns = self._missing_turns(int(since.sum()), host_ns)
            at = int(np.argmax(broken if broken.any() else suspect))
            since[at] += turns * TURN
            restarted[at] = bool(turns or suspect[at]) and since[at] * TICK_NS > REBOOT_NS
        samples = self._samples(since, broken)
        if self._period is not None:
            restarted |= suspect & ~stuck & (np.abs(since - samples * self._period) > MISFIT * self._period)
        ticks = (int(timer[0]) if self._tick is None else self._tick) + np.cumsum(since)
        self._tick, self._timer = int(ticks[-1]), int(timer[-1])
        if stuck.any():
            self._reference = None
        elif fresh:
            self._reference = (host_ns, self._tick)
        samples[0] = 1 if first else samples[0]
        return PacketTicks(ticks.astype(np.uint64), samples, restarted, stuck)

    def _missing_turns(self, since: int, host_ns: int) -> int:
        """Number of timer wraps by host time that ``since`` does not contain."""
        if self._reference is None or self._tick is None:
            return 0
        reference_ns, reference_tick = self._reference
        counted_ns = (self._tick + since - reference_tick) * TICK_NS
        return max(0, round((host_ns - reference_ns - counted_ns) / TURN_NS))

    def _learn(self, contiguous: NDArray[np.int64]) -> None:
        if self._period is None:
            self._first += contiguous.tolist()
            if len(self._first) >= PERIOD_PACKETS:
                self._period = float(np.median(self._first))
            return
        single = contiguous[self._is_one_period(contiguous)]
        if len(single):
            self._period += PERIOD_GAIN * (float(single.mean()) - self._period)

    def _is_one_period(self, since: NDArray[np.int64]) -> NDArray[np.bool_]:
        if self._period is None:
            return np.ones(len(since), np.bool_)
        return np.asarray(np.abs(since - self._period) < MISFIT * self._period, np.bool_)

    def _samples(self, since: NDArray[np.int64], broken: NDArray[np.bool_]) -> NDArray[np.int64]:
        if self._period is None:
            return np.where(broken & (since > 0), 2, 1)  # lost bytes mean a lost packet
        return np.maximum(1, np.rint(since / self._period).astype(np.int64))
