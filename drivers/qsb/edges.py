"""Sync edges from the CAPTURE and DIGIO lines that one edge causes.

CAPTURE is streamed when the latched count changed, DIGIO when the level did. A moving joint causes both lines; a joint
at rest causes only the second, and the capture is unchanged.
"""

from typing import NamedTuple

from drivers.qsb.registers import CAPTURE, DIGIO

SAME_EDGE_TICKS = 2  # 4 ms; pulses are 150 ms apart


class LatchedEdge(NamedTuple):
    """One edge: tick and arrival of its first line, and the count latched, modulo 2^32."""

    tick: int
    host_ns: int
    capture: int


class SyncEdges:
    """Joins the lines of one edge.

    Args:
        rising: The edge that latches is the rising one.
    """

    def __init__(self, rising: bool = True) -> None:
        self._active = int(rising)
        self._capture = 0
        self._level = 1 - self._active
        self._pending: LatchedEdge | None = None
        self._ready: list[LatchedEdge] = []

    def preset(self, register: int, data: int) -> None:
        """Set the initial content of a streamed register."""
        if register == CAPTURE:
            self._capture = data
        else:
            self._level = data & 1

    def line(self, register: int, data: int, tick: int, host_ns: int) -> None:
        """Take a line of the CAPTURE or the DIGIO stream."""
        if register == CAPTURE:
            if data != self._capture:
                self._capture = data
                self._edge(tick, host_ns)
        elif register == DIGIO:
            before, self._level = self._level, data & 1
            if before != self._level == self._active:
                self._edge(tick, host_ns)

    def take(self, tick: int | None = None) -> list[LatchedEdge]:
        """Edges that are complete at ``tick``; all of them when it is None."""
        if self._pending is not None and (tick is None or tick - self._pending.tick > SAME_EDGE_TICKS):
            self._ready.append(self._pending)
            self._pending = None
        ready, self._ready = self._ready, []
        return ready

    def _edge(self, tick: int, host_ns: int) -> None:
        if self._pending is not None and abs(tick - self._pending.tick) <= SAME_EDGE_TICKS:
            self._pending = self._pending._replace(capture=self._capture)
            return
        if self._pending is not None:
            self._ready.append(self._pending)
        self._pending = LatchedEdge(tick, host_ns, self._capture)
