"""Identifies the pulses of the published code from edge intervals, with missed and spurious edges."""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.sync_pulse import code

EdgeTimes = NDArray[np.int64]


class PulsePlace(NamedTuple):
    """A pulse of the code; it rose ``dither_ns`` after the start of SYNC ``sync_count`` of its code cycle."""

    sync_count: int
    dither_ns: int


class PulseTrain:
    """Identifies edges of the coded pulse line.

    An edge is identified when the newest four fit four pulses of the code, with any number missed between them, and no
    other four nearly as well; with spurious edges among them, when five of the last eight fit. After that each edge is
    identified by the time since the last one; an edge that fits no pulse is spurious.

    The code repeats after some two hours: a place is one within a cycle, and the cycle is unknown.

    Args:
        sync_period_ns: nominal length of a sync period.
    """

    EDGES_TO_NAME = 4
    EDGES_TO_NAME_AMONG_SPURIOUS = 5
    EDGES_HELD = 8
    STRANGERS_TO_FORGET = 4
    CLEARLY_WORSE, JITTER_NS = 3.0, 30e3  # factor by which any other place must fit worse
    TOLERANCE_NS = 200e3  # largest distance of an edge from its place by jitter; drift since the last edge is added
    CRYSTALS = 100e-6  # two of them, 50 ppm each
    LONGEST_SILENCE_NS = 60_000_000_000  # longer silences: the drift exceeds the spacing that identifies a pulse

    def __init__(self, sync_period_ns: float) -> None:
        self._cycle_ns = code.cycle_sync_periods() * sync_period_ns
        rise_ns = code.sync_numbers() * sync_period_ns + code.dither_ns()
        self._rise_ns = np.concatenate([rise_ns, rise_ns + self._cycle_ns])
        self._rise_ns.setflags(write=False)  # half a megabyte that checkpoints need not hold
        self._last: tuple[int, int] | None = None  # (number of the pulse, edge_ns)
        self._recent: deque[int] = deque(maxlen=self.EDGES_HELD)
        self._strangers = 0
        self.spurious = 0

    def edge(self, edge_ns: int) -> PulsePlace | None:
        """The pulse of this edge; None if it is not (yet) identified."""
        if self._last is not None and edge_ns - self._last[1] > self.LONGEST_SILENCE_NS:
            self._last = None
            self._recent.clear()
        if self._last is not None:
            number = self._follow(*self._last, edge_ns)
            if number is not None:
                return self._found(number, edge_ns)
            self.spurious += 1
            self._strangers += 1
            if self._strangers < self.STRANGERS_TO_FORGET:
                return None
            self._last, self._strangers = None, 0
            self._recent.clear()
        self._recent.append(edge_ns)
        number = self._name(np.array(self._recent, np.int64))
        return None if number is None else self._found(number, edge_ns)

    def _found(self, number: int, edge_ns: int) -> PulsePlace:
        self._last, self._strangers = (number, edge_ns), 0
        return PulsePlace(int(code.sync_numbers()[number]), int(code.dither_ns()[number]))

    def _follow(self, last: int, last_ns: int, edge_ns: int) -> int | None:
        """Number of the pulse ``edge_ns - last_ns`` after pulse ``last``; None if there is none."""
        elapsed_ns = edge_ns - last_ns
        if elapsed_ns <= 0:
            return None
        number, is_pulse = self._pulses(np.array([last]), elapsed_ns)
        return int(number[0]) % code.CODE_LENGTH if is_pulse[0] and number[0] > last else None

    def _pulses(self, first: NDArray[np.intp], after_ns: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """The pulses nearest to ``after_ns`` after pulses ``first`` (n,), and whether they are near enough."""
        expected_ns = self._rise_ns[first] + after_ns
        after = np.minimum(np.maximum(self._rise_ns.searchsorted(expected_ns), 1), len(self._rise_ns) - 1)
        before = after - 1
        later = self._rise_ns[after] - expected_ns < expected_ns - self._rise_ns[before]
        nearest = np.where(later, after, before)
        allowed_ns = self.TOLERANCE_NS + self.CRYSTALS * after_ns
        return nearest, np.abs(self._rise_ns[nearest] - expected_ns) < allowed_ns

    def _name(self, edges: EdgeTimes) -> int | None:
        """Number of the pulse of the last of ``edges`` (n,), if unambiguous."""
        best: dict[int, tuple[int, float]] = {}  # pulse number: edges explained, rms distance
        for anchor in range(len(edges) - self.EDGES_TO_NAME + 1):
            firsts = np.arange(code.CODE_LENGTH)
            newest, possible = self._pulses(firsts, int(edges[-1] - edges[anchor]))
            firsts, newest = firsts[possible], newest[possible]
            explained = np.ones((len(firsts), len(edges)), np.bool_)
            explained[:, :anchor] = False
            for other in range(anchor + 1, len(edges) - 1):
                explained[:, other] = self._pulses(firsts, int(edges[other] - edges[anchor]))[1]
            count = explained.sum(axis=1)
            enough = explained[:, -self.EDGES_TO_NAME :].all(axis=1) | (count >= self.EDGES_TO_NAME_AMONG_SPURIOUS)
            for row in np.flatnonzero(enough):
                number = int(newest[row]) % code.CODE_LENGTH
                found = int(count[row]), self._off_ns(int(firsts[row]), edges[explained[row]])
                best[number] = max(best.get(number, (0, 0.0)), found, key=lambda one: (one[0], -one[1]))
        ordered = sorted(best, key=lambda number: (-best[number][0], best[number][1]))
        if len(ordered) > 1:
            (most, off_ns), (next_most, next_off_ns) = best[ordered[0]], best[ordered[1]]
            if most == next_most and next_off_ns < self.CLEARLY_WORSE * off_ns + self.JITTER_NS:
                return None
        return ordered[0] if ordered else None

    def _off_ns(self, first: int, edges: EdgeTimes) -> float:
        """Rms distance of ``edges`` (n,) from their pulses after a fit of the rate; the first is pulse ``first``."""
        since = (edges - edges[0]).astype(np.float64)
        rises = np.array([self._rise_ns[self._pulses(np.array([first]), int(ns))[0][0]] for ns in since])
        off = rises - self._rise_ns[first] - since
        off -= off.mean()
        since -= since.mean()
        rate = float(np.clip(since @ off / (since @ since), -self.CRYSTALS, self.CRYSTALS))
        return float(np.sqrt(np.mean((off - rate * since) ** 2)))
