"""What the mission is doing, as a channel tells it; and what follows: is the payload held, is the IMU zeroed.

Phase changes are events on a bus, stamped on arrival: good to some milliseconds, which the settling time covers.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard import config


class PhaseTrack:
    """Phase changes seen so far. Without a phase channel everything is one long phase with the payload held."""

    def __init__(self, settings: config.Phases | None) -> None:
        self._settings = settings
        self._times_ns: list[int] = []
        self._codes: list[int] = []

    def update(self, batches: Mapping[str, Rows]) -> list[str]:
        """Take in what a step consumed; returns a line of text for each change."""
        rows = batches.get(self._settings.channel) if self._settings else None
        said = []
        for row in rows if rows is not None else ():
            code = int(row["value_raw"])
            if not self._codes or code != self._codes[-1]:
                self._times_ns.append(int(row["host_ns"]))
                self._codes.append(code)
                said.append(f"phase {code}")
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

    def attached(self, at_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether the payload is held at each tick, (n,)."""
        gone = self._settings.payload_gone if self._settings else None
        if gone is None or gone not in self._codes:
            return np.ones(len(at_ns), np.bool_)
        return np.asarray(at_ns < self._times_ns[self._codes.index(gone)], np.bool_)
