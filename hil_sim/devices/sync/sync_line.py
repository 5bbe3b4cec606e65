"""The flight computer's end of the pulse line: edges as its kernel stamps and numbers them."""

import heapq

import numpy as np

from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultError, FaultKind

_MOST_CHATTER = 1e4  # edges a second
_LATENCY_NS = 3_000  # fixed part of the latency


class EdgeCapture:
    """A GPIO line with edge detection.

    A stamp is later than its edge by a fixed latency and an exponential one. Edges are numbered from 1 in the order of
    their stamps; a dropped edge leaves no hole in the numbers, as the kernel never saw it.

    Args:
        seed: Of the jitter.
        jitter_ns: Mean of the random part.
    """

    def __init__(self, seed: int = 0, *, jitter_ns: int = 2_000) -> None:
        self.missed = 0
        self.spurious = 0
        self._rng = np.random.default_rng([seed, 0x9E])
        self._jitter_ns = jitter_ns
        self._faults = NO_FAULTS
        self._chatter: list[int] = []
        self._stamps: list[int] = []
        self._sequence = 0
        self._now_ns: int | None = None

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that the line cannot have.
        """
        self._faults = faults.require(
            FaultKind.PULSE_DROP, FaultKind.PULSE_SPURIOUS, FaultKind.INTERMITTENT, FaultKind.DELAYED, FaultKind.GARBAGE
        )
        for window in faults.windows:
            if window.kind is FaultKind.GARBAGE and not (0.0 < window.value <= _MOST_CHATTER and window.end_ns < NEVER):
                needed = f"an end, and `value`, the edges a second, above 0 and up to {_MOST_CHATTER:g}"
                raise FaultError(f"Fault garbage of {faults.device} needs {needed}.")
        rng = faults.rng()
        self._chatter = sorted(
            round(time_ns)
            for window in faults.windows
            if window.kind is FaultKind.GARBAGE
            for time_ns in rng.uniform(
                window.start_ns, window.end_ns, rng.poisson(window.value * (window.end_ns - window.start_ns) * 1e-9)
            )
        )

    def edge(self, edge_ns: int, high_ns: int) -> None:
        """The line goes high at ``edge_ns``."""
        del high_ns
        if self._faults.active(FaultKind.PULSE_DROP, edge_ns) is not None or self._faults.is_away(edge_ns):
            self.missed += 1
        else:
            self._stamp(edge_ns)

    def advance(self, now_ns: int) -> list[tuple[int, int]]:
        """(stamp in ns, line sequence) of the edges stamped up to ``now_ns``, in order."""
        since_ns = now_ns if self._now_ns is None else self._now_ns
        for extra_ns in self._extra_edges(since_ns, now_ns):
            self.spurious += 1
            self._stamp(extra_ns)
        self._now_ns = now_ns
        seen = []
        while self._stamps and self._stamps[0] <= now_ns:
            self._sequence += 1
            seen.append((heapq.heappop(self._stamps), self._sequence))
        return seen

    def _stamp(self, edge_ns: int) -> None:
        late_ns = _LATENCY_NS + round(self._rng.exponential(self._jitter_ns))
        delayed = self._faults.active(FaultKind.DELAYED, edge_ns)
        late_ns += 0 if delayed is None else round(delayed.value * 1e9)
        heapq.heappush(self._stamps, edge_ns + late_ns)

    def _extra_edges(self, since_ns: int, now_ns: int) -> list[int]:
        edges = self._faults.spurious_edges(since_ns, now_ns) if self._faults else []
        while self._chatter and self._chatter[0] <= now_ns:
            edges.append(self._chatter.pop(0))
        return edges
