"""Sync line device: edges in, PULSE rows out, lost edges recorded as gaps."""

from dataclasses import dataclass

import numpy as np

from drivers.device import COALESCED_NS
from drivers.ports import Edge, PulsePort
from drivers.records import PULSE, Batch, Severity
from drivers.reporter import Reporter

RETRY_NS = 20_000_000
LONGEST_REST_NS = 1_000_000_000  # ten edges or so, of the queue's many
_WRAP = 1 << 32


@dataclass(frozen=True)
class SyncPulseConfig:
    """Configuration of the sync line.

    Attributes:
        sync_period_ms: SYNC period, ms: pulse intervals are whole numbers of it.
    """

    sync_period_ms: float = 5.0


class SyncPulse:
    """Rising edges of the sync line as PULSE rows; its channel carries its name.

    ``sequence`` follows the line's number, so edges dropped by the kernel appear as a jump and a GAP row with cause
    ``edge_lost``. A line number that goes back means that the line was requested again: an event, and a GAP row with
    cause ``line_lost`` whose number of edges is estimated from the mean interval.
    """

    def __init__(self, name: str, port: PulsePort) -> None:
        self.name = name
        self._port = port
        self._report = Reporter(name)
        self._sequence = 0
        self._first: Edge | None = None  # since the line was requested
        self._last: Edge | None = None
        self._intervals = 0  # between these two
        self._mean_ns = 0.0  # between edges, as known when the line was lost
        self._failing = False

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: ``pump`` waits on the line. Non-zero only while the line fails."""
        return RETRY_NS if self._failing else 0

    @property
    def coalesces_ns(self) -> int:
        """See ``drivers.device.Coalesces``: edges have the kernel's stamps."""
        return 0 if self._failing else COALESCED_NS

    def start(self, now_ns: int) -> list[Batch]:
        """No set-up: edges since the line was opened are queued and returned by the first pump."""
        del now_ns
        return []

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Return the waiting edges as one batch; waits up to ``timeout_s`` for the first."""
        edges = self._receive(now_ns, timeout_s)
        rows = np.zeros(len(edges), PULSE)
        for place, edge in enumerate(edges):
            rows[place] = (self._number(edge), edge.host_ns, edge.edge_ns, edge.line_sequence)
        self._report.rows(self.name, rows)
        return self._report.take()

    def rests_until(self, now_ns: int) -> int:
        """See ``drivers.device.Rests``: edges wait, with their stamps, until they are read."""
        return now_ns if self._failing else now_ns + LONGEST_REST_NS

    def stop(self, now_ns: int) -> list[Batch]:
        """Return the remaining edges."""
        batches = self.pump(now_ns)
        self._report.flush(now_ns)
        return batches + self._report.take()

    def _receive(self, now_ns: int, timeout_s: float) -> list[Edge]:
        try:
            edges = self._port.receive(timeout_s)
        except OSError as error:
            if not self._failing:
                text = f"sync line cannot be read ({error}): check its chip and line number"
                self._report.event(now_ns, Severity.ERROR, "bus_error", text)
            self._failing = True
            return []
        if self._failing:
            self._failing = False
            self._report.event(now_ns, Severity.INFO, "bus_recovered", "sync line can be read again")
        return edges

    def _number(self, edge: Edge) -> int:
        """Sequence number of this edge, after recording lost ones before it."""
        last, self._last = self._last, edge
        if last is not None:
            lost = (edge.line_sequence - last.line_sequence) % _WRAP - 1
            if 0 <= lost < _WRAP // 2:
                self._intervals += lost + 1
                if lost:
                    first = self._sequence
                    duration_ns = edge.edge_ns - last.edge_ns
                    self._report.gap(
                        edge.host_ns, self.name, first, first + lost - 1, duration_ns, "edge_lost", counted=True
                    )
                    self._sequence += lost
            else:
                text = f"line number {edge.line_sequence} after {last.line_sequence}: the line was requested again"
                self._report.event(edge.host_ns, Severity.WARNING, "line_restarted", text)
                self._restarted(last, edge)
        self._first = self._first or edge
        self._sequence += 1
        return self._sequence - 1

    def _restarted(self, last: Edge, edge: Edge) -> None:
        """Record a gap of the edges while the line was not there, their number by the mean interval."""
        if self._first is not None and self._intervals:
            self._mean_ns = (last.edge_ns - self._first.edge_ns) / self._intervals
        self._first, self._intervals = None, 0
        away_ns = edge.edge_ns - last.edge_ns
        lost = round(away_ns / self._mean_ns) - 1 if self._mean_ns > 0.0 else 0
        if lost > 0:
            self._report.gap(edge.host_ns, self.name, self._sequence, self._sequence + lost - 1, away_ns, "line_lost")
            self._sequence += lost
