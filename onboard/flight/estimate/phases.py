"""Mission phases from a phase channel, and the payload state and IMU zeroing that follow from them.

Phase changes are events on a bus, stamped on arrival with an error of some milliseconds, which the settling time
covers. A change of the payload is permanent, so it requires two successive readings (the driver of event-driven objects
reads each change back).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard import config


class KnownPhases(NamedTuple):
    """How far the mission has come."""

    phase: int
    begun: bool  # there has been a phase for identification
    taken: bool  # the payload has been taken, where the mission takes one
    gone: bool  # and released


class PhaseTrack:
    """Phase changes so far. Without a phase channel there is a single phase with the payload held.

    A flight that was resumed after a loss of power begins with what was known before it.
    """

    def __init__(self, settings: config.Phases | None) -> None:
        self._settings = settings
        self._times_ns: list[int] = []
        self._codes: list[int] = []
        self._taken_ns: int | None = None
        self._gone_ns: list[int] = []  # reported releases, without the rejected ones
        if settings is not None and settings.resumed is not None:
            before_ns = 0  # host time begins when the computer does
            self._times_ns, self._codes = [before_ns], [settings.resumed.phase]
            self._taken_ns = before_ns if settings.resumed.taken else None
            self._gone_ns = [before_ns] if settings.resumed.gone else []

    def update(self, batches: Mapping[str, Rows]) -> list[str]:
        """Process the rows of a step, except NOT_VALID ones; returns a line of text for each change."""
        settings, said = self._settings, list[str]()
        rows = batches.get(settings.channel) if settings else None
        if settings is None or rows is None:
            return said
        rows = rows[rows["status"] & SampleStatus.NOT_VALID == 0]
        for code, host_ns in zip(rows["value_raw"].tolist(), rows["host_ns"].tolist(), strict=True):
            if not self._codes or code != self._codes[-1]:
                self._times_ns.append(host_ns)
                self._codes.append(code)
                said.append(f"phase {code}")
            elif code == settings.payload_gone:
                if self._times_ns[-1] not in self._gone_ns:
                    self._gone_ns.append(self._times_ns[-1])
            elif code == settings.payload_taken and self._taken_ns is None:
                self._taken_ns = self._times_ns[-1]
        return said

    @property
    def known(self) -> KnownPhases | None:
        """How far the mission has come; None before the first phase is known, and without a phase channel."""
        if self._settings is None or not self._codes:
            return None
        resumed = self._settings.resumed
        begun = any(code in self._settings.identify for code in self._codes) or bool(resumed and resumed.begun)
        return KnownPhases(self._codes[-1], begun, self._taken_ns is not None, bool(self._gone_ns))

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
