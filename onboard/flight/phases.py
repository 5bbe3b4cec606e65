"""Mission phases from a phase channel, and the payload state and IMU zeroing that follow from them.

Phase changes are events on a bus, stamped on arrival with an error of some milliseconds, which the settling time
covers. A change of the payload is permanent, so it requires two successive readings (the driver of event-driven objects
reads each change back).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard import config


class PhaseTrack:
    """Phase changes so far. Without a phase channel there is a single phase with the payload held."""

    def __init__(self, settings: config.Phases | None) -> None:
        self._settings = settings
        self._times_ns: list[int] = []
        self._codes: list[int] = []
        self._taken_ns: int | None = None
        self._gone_ns: list[int] = []  # reported releases, without the rejected ones

    def update(self, batches: Mapping[str, Rows]) -> list[str]:
        """Process the rows of a step, except NOT_VALID ones; returns a line of text for each change."""
        rows = batches.get(self._settings.channel) if self._settings else None
        said = []
        for row in rows if rows is not None else ():
            if row["status"] & SampleStatus.NOT_VALID:
                continue
            code = int(row["value_raw"])
            if not self._codes or code != self._codes[-1]:
                self._times_ns.append(int(row["host_ns"]))
                self._codes.append(code)
                said.append(f"phase {code}")
            elif self._settings and code == self._settings.payload_gone:
                if self._times_ns[-1] not in self._gone_ns:
                    self._gone_ns.append(self._times_ns[-1])
            elif self._settings and code == self._settings.payload_taken and self._taken_ns is None:
                self._taken_ns = self._times_ns[-1]
        return said

    @property
    def changes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Times [ns] and codes of the changes, (k,) each."""
        return np.array(self._times_ns, np.int64), np.array(self._codes, np.int64)

    def at(self, at_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The phase at each tick, (n,); -1 before the first is known."""
        times_ns, codes = self.changes
        index = np.searchsorted(times_ns, at_ns, side="right")
        return np.append(-1, codes)[index]

    def reject_release(self) -> None:
        """Removes the first reported release."""
        self._gone_ns.pop(0)

    def attached(self, at_ns: NDArray[np.int64], *, but_first: bool = False) -> NDArray[np.bool_]:
        """Whether the payload is held at each tick, (n,); ``but_first``: without the first reported release."""
        held = np.ones(len(at_ns), np.bool_)
        if self._settings and self._settings.payload_taken is not None:
            held[:] = False if self._taken_ns is None else at_ns >= self._taken_ns
        gone_ns = self._gone_ns[but_first:]
        if gone_ns:
            held &= at_ns < gone_ns[0]
        return held
