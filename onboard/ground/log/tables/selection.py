"""Selects a part of a log by channels, times and phases."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.ground.log.tables.phases import phases_of
from onboard.recording.reader import LogReader


@dataclass(frozen=True)
class Selection:
    """Selection of a part of a log.

    Args:
        channels: only these; None: all.
        start_s: start, s since the log's first record.
        end_s: end, likewise.
        phases: only these phases, by name or code; empty: all.
    """

    channels: tuple[str, ...] | None = None
    start_s: float | None = None
    end_s: float | None = None
    phases: tuple[str, ...] = ()

    def windows(self, log: LogReader, vehicle: config.Vehicle | None) -> list[tuple[int, int]] | None:
        """Intervals ``[start, end)`` of the host's clock, ns; None for all of the log.

        Args:
            log: the log.
            vehicle: that flew, which says what its phases are; None where it is not known.

        Raises:
            ValueError: unknown phase, a log without phases, or an end before the start.
        """
        if self.start_s is None and self.end_s is None and not self.phases:
            return None
        if self.start_s is not None and self.end_s is not None and self.start_s >= self.end_s:
            raise ValueError(f"--from {self.start_s:g} is not before --until {self.end_s:g}; exchange them")
        first_ns, last_ns = span_of(log)
        low = first_ns if self.start_s is None else first_ns + round(self.start_s * 1e9)
        high = last_ns + 1 if self.end_s is None else first_ns + round(self.end_s * 1e9)
        if not self.phases:
            return [(low, high)]
        if vehicle is None:
            why = "carries no vehicle file that says what its phases are; give it with --vehicle"
            raise ValueError(f"{log.path} {why}")
        known = phases_of(log, vehicle.file.estimation.phases, last_ns + 1)
        wanted = [phase for phase in known if {phase.name, str(phase.code)} & set(self.phases)]
        names = {name for phase in wanted for name in (phase.name, str(phase.code))}
        if missing := sorted(set(self.phases) - names):
            there = ", ".join(dict.fromkeys(phase.name for phase in known)) or "no phases"
            raise ValueError(f"{log.path} has no phase {', '.join(missing)}; it has {there}")
        return [(max(low, p.start_ns), min(high, p.end_ns)) for p in wanted if p.start_ns < high and p.end_ns > low]


def inside(at_ns: NDArray[np.int64], windows: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which of ``at_ns`` (n,) lie in any of ``windows``."""
    found = np.zeros(len(at_ns), np.bool_)
    for start_ns, end_ns in windows:
        found |= (at_ns >= start_ns) & (at_ns < end_ns)
    return found


def span_of(log: LogReader) -> tuple[int, int]:
    """First and last ``host_ns`` over all channels, by a pass over the log; zeros if it is empty."""
    first_ns, last_ns = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for batch in log.batches():
        first_ns = min(first_ns, int(batch.rows["host_ns"].min()))
        last_ns = max(last_ns, int(batch.rows["host_ns"].max()))
    return (first_ns, last_ns) if first_ns <= last_ns else (0, 0)
