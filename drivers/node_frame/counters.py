"""Unwraps a node's frame sequence and clock, 32-bit words on the wire."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.unwrap import steps, unwrapped

TURN = 1 << 32
SLACK_NS = 1_000_000_000  # longest delay of a frame in the kernel's buffer


class FrameTicks(NamedTuple):
    """Unwrapped positions of data frames.

    Attributes:
        ticks: The node's clock, unwrapped, shape (n,).
        lost: Frames missing before each, shape (n,).
        rebooted: The node restarted before this frame, shape (n,).
        jumped: The clock jumped without a restart of the node, shape (n,).
        whole: No loss, restart or jump: each frame continues the one before.
    """

    ticks: NDArray[np.int64]
    lost: NDArray[np.int64 | np.bool_]
    rebooted: NDArray[np.bool_]
    jumped: NDArray[np.bool_]
    whole: bool = False


class NodeCounters:
    """Tracks a node's frame sequence and clock.

    Args:
        tick_hz: Nominal rate of the clock.
        tick: The clock, unwrapped, at ``host_ns``.
        host_ns: CLOCK_MONOTONIC, approximate.
        sequence: Sequence of the frame before the next one; None: unknown, the next is the first; -1: the node has just
            started.
    """

    def __init__(self, tick_hz: int, tick: int, host_ns: int, sequence: int | None) -> None:
        self._tick_ns = 1e9 / tick_hz
        self._tick = tick
        self._host_ns = host_ns
        self._sequence = sequence
        self._fresh = True

    def is_past(self, sequence: int) -> bool:
        """Whether this sequence lies in the past, so that the node must have restarted."""
        return self._sequence is not None and steps(np.array([sequence]), 32, self._sequence)[0] <= 0

    def place(self, sequences: NDArray[np.uint32], words: NDArray[np.uint32], host_ns: int) -> FrameTicks:
        """Place data frames that arrived at ``host_ns``; there is at least one.

        Args:
            sequences: Frame sequences, shape (n,).
            words: Low halves of the clock, shape (n,).
            host_ns: CLOCK_MONOTONIC.
        """
        before = int(sequences[0]) - 1 if self._sequence is None else self._sequence
        elapsed_ns = host_ns - self._host_ns
        expected = self._tick + round(elapsed_ns / self._tick_ns)
        ticks = unwrapped(words, 32, expected, expected)
        if not self._fresh and self._follow(before, sequences.tolist(), ticks.tolist(), elapsed_ns):
            self._sequence, self._tick, self._host_ns = int(sequences[-1]), int(ticks[-1]), host_ns
            none = np.zeros(len(ticks), np.bool_)
            return FrameTicks(ticks, none, none, none, whole=True)
        forward = steps(sequences, 32, before)
        since = steps(words, 32, expected)
        rebooted = forward <= 0
        lost = np.where(rebooted, sequences, forward - 1)  # after a restart: all frames since then
        for place in np.flatnonzero(rebooted):
            ticks[place:] += int(words[place]) - ticks[place]
        advance_ns = since * self._tick_ns
        advance_ns[0] = (int(ticks[0]) - self._tick) * self._tick_ns
        jumped = (advance_ns < 0) | (advance_ns > elapsed_ns + SLACK_NS)
        jumped &= ~rebooted
        jumped[0] &= not self._fresh
        self._fresh = False
        self._sequence, self._tick, self._host_ns = int(sequences[-1]), int(ticks[-1]), host_ns
        return FrameTicks(ticks, lost.astype(np.int64), rebooted, jumped)

    def _follow(self, before: int, sequences: list[int], ticks: list[int], elapsed_ns: int) -> bool:
        """Whether each frame continues the one before: the fast path of the normal case."""
        return (
            sequences == list(range(before + 1, before + 1 + len(sequences)))
            and ticks[0] >= self._tick
            and ticks == sorted(ticks)
            and (ticks[-1] - self._tick) * self._tick_ns <= elapsed_ns + SLACK_NS
        )
