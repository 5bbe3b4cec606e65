"""Whether the mission's end phase has come."""

import math
from pathlib import Path

from drivers.records import SampleStatus
from onboard import config
from onboard.ring import RingReader

_LAST_WORDS_S = 0.7  # that the ending phase must last: shorter is a glitch, and an answer may be on its way


class EndOfMission:
    """Watches the phase channel for the phase that ends the flight: it must last, and another one takes it back."""

    def __init__(self, vehicle: config.Vehicle, directory: Path) -> None:
        phases = vehicle.file.estimation.phases
        self._end = phases.end if phases else None
        self._reader = RingReader(directory / f"{phases.channel}.ring") if phases else None
        self._seen_s = math.inf
        self._first: int | None = None

    @property
    def was_over(self) -> bool:
        """Whether the first phase of all was the last of the mission."""
        return self._first is not None and self._first == self._end

    def reached(self, now_s: float) -> bool:
        """Whether the ending phase has come and stayed, so that what was under way has had its time."""
        if self._reader is None or self._end is None:
            return False
        rows, _ = self._reader.read()
        if len(rows) and self._first is None:
            self._first = int(rows["value_raw"][0])
        for row in rows:
            if not row["status"] & SampleStatus.NOT_VALID:
                self._seen_s = min(self._seen_s, now_s) if row["value_raw"] == self._end else math.inf
        return now_s - self._seen_s > _LAST_WORDS_S
