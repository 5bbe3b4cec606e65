"""Which pulse of the published code is this edge? From the intervals alone, with misses and spurious edges between."""

from collections import deque
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from drivers.sync_pulse import code


class PulsePlace(NamedTuple):
    """A pulse of the code: it rose ``dither_ns`` after the start of SYNC number ``sync_count``."""

    sync_count: int
    dither_ns: int


class PulseTrain:
    """Identifies edges of the coded pulse line.

    Every pulse rises in a sync period that a de Bruijn sequence picks (``drivers.sync_pulse.code``), so four
    consecutive edges name themselves. Once named, each further edge is placed by counting periods from the last good
    one, and an edge that falls on no pulse of the code is spurious. The known dither of up to a millisecond after the
    start of its period makes pulses fall everywhere in the sample periods of a recorder whose clock beats with the
    sync period.

    Args:
        sync_period_ns: nominal length of a sync period.
        tolerance_ns: how far an edge may lie from its place (jitter; the two oscillators' drift since the last edge
            is allowed for besides).
    """

    EDGES_TO_NAME = 4
    CYCLES = 12  # of the code that are told apart once a pulse has been named: a day
    STRANGERS_TO_FORGET = 4

    def __init__(self, sync_period_ns: float, tolerance_ns: float = 200_000.0) -> None:
        self.period_ns, self.tolerance_ns = sync_period_ns, tolerance_ns
        cycles = np.arange(self.CYCLES)[:, None]
        self._count_of = (code.sync_numbers() + cycles * code.cycle_sync_periods()).reshape(-1)
        self._dither_ns = np.tile(code.dither_ns(), self.CYCLES)
        self._rise_ns = self._count_of * sync_period_ns + self._dither_ns
        self._last: tuple[int, int] | None = None  # (number of the pulse, edge_ns)
        self._recent: deque[int] = deque(maxlen=self.EDGES_TO_NAME)
        self._strangers = 0
        self.spurious = 0

    def edge(self, edge_ns: int) -> PulsePlace | None:
        """The pulse that made this edge, or None while (or if) it cannot be told."""
        if self._last is not None:
            number = self._follow(*self._last, edge_ns)
            if number is not None:
                return self._found(number, edge_ns)
            self.spurious += 1
            self._strangers += 1
            if self._strangers < self.STRANGERS_TO_FORGET:
                return None
            self._last = None
            self._recent.clear()
        return self._name(edge_ns)

    def _follow(self, last: int, last_ns: int, edge_ns: int) -> int | None:
        """Number of the pulse that rises ``edge_ns - last_ns`` after pulse ``last``, if one does."""
        elapsed_ns = edge_ns - last_ns
        if elapsed_ns <= 0:
            return None
        expected_ns = self._rise_ns[last] + elapsed_ns
        after = int(np.searchsorted(self._rise_ns, expected_ns))
        near = [number for number in (after - 1, after) if last < number < len(self._rise_ns)]
        allowed_ns = self.tolerance_ns + 100e-6 * elapsed_ns  # two crystals, 50 ppm each
        return next((number for number in near if abs(self._rise_ns[number] - expected_ns) < allowed_ns), None)

    def _found(self, number: int, edge_ns: int) -> PulsePlace:
        self._last, self._strangers = (number, edge_ns), 0
        return PulsePlace(int(self._count_of[number]), int(self._dither_ns[number]))

    def _name(self, edge_ns: int) -> PulsePlace | None:
        self._recent.append(edge_ns)
        if len(self._recent) < self.EDGES_TO_NAME:
            return None
        steps = list(pairwise(self._recent))
        number = code.pulse_number([round((b - a) / self.period_ns) for a, b in steps])
        if number is None:
            return None
        firsts = range(number - len(steps), number)
        if any(self._follow(first, a, b) != first + 1 for first, (a, b) in zip(firsts, steps, strict=True)):
            return None
        return self._found(number, edge_ns)
