"""Which encoders have jumped, and the events that report it; ``onboard.estimation.jumps`` decides."""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, Severity
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.jumps import AngleJumps, Jump
from onboard.estimation.stuck import NONE
from onboard.flight.estimate.readings.stuck import StuckEvent, breaks

_EVERY = 1 << 31  # samples: more than are kept
_ROUNDING = 1.0 / math.sqrt(12.0)  # counts, rms


class JumpWatch:
    """Watches the channel of a joint's angle.

    Args:
        signal: what is known of it.

    Attributes:
        jumped: whether its angle jumped after rows were used: none is made of what came until it jumped back.
    """

    def __init__(self, signal: SmoothedChannel) -> None:
        self._signal = signal
        self._jumps: AngleJumps | None = None  # its counts are not known before the first rows
        self._sequence: int | None = None  # of the last row
        self._since: Jump | None = None  # its encoder is another one
        self.jumped = False

    def watch(
        self, rows: Rows, angle: FloatArray, times_ns: NDArray[np.int64] | None, in_use: bool
    ) -> tuple[NDArray[np.bool_], slice, list[StuckEvent]]:
        """Judge the next rows, at least one.

        Args:
            rows: of the channel, in order.
            angle: (n,) rad; NaN where it may not be used.
            times_ns: (n,) vehicle time of each; None: not known, and none is judged.
            in_use: rows of the estimator were made of those before.

        Returns:
            Which are of another encoder, (n,); which of those before them are, counted from the first of these; what
            the event reports.
        """
        if self._jumps is None:
            count = self._signal.quantum_counts * abs(
                float(rows["scale"][0]) * self._signal.si.get(rows["unit"][0], 0.0)
            )
            self._jumps = AngleJumps(max(self._signal.noise[0], _ROUNDING * count))
        starts, found = breaks(rows, self._sequence), list[Jump]()
        self._sequence = int(rows["sequence"][-1])
        times = np.full(len(rows), np.nan) if times_ns is None else times_ns.astype(np.float64)
        arrived = rows["host_ns"].astype(np.float64)
        for first, last in itertools.pairwise(sorted({0, *starts, len(rows)})):
            if first in starts:
                self._jumps.forget()
            part = slice(first, last)
            found += [
                one._replace(at=first + one.at) for one in self._jumps.watch(angle[part], times[part], arrived[part])
            ]
        wrong, before = np.full(len(rows), self._since is not None), NONE
        said = list[StuckEvent]()
        for one in found:
            jumps = f"by {math.degrees(one.size):+.3g} deg between two samples"
            if self._since is not None:
                if one.undoes(self._since):
                    self._since, wrong[max(one.at, 0) :] = None, False
                    text = f"its angle jumps back {jumps}: it reads as before; rows are used again"
                    said.append(StuckEvent(Severity.INFO, "angle_jumped_back", text))
                continue
            text = f"its angle jumps {jumps}, as no motion does: its zero, scale or delay has changed"
            if not in_use:
                wrong[: max(one.at, 0)], before = True, slice(-_EVERY, min(one.at, 0))
                said.append(StuckEvent(Severity.WARNING, "angle_jumped", f"{text}; no row before that is used"))
                continue
            self.jumped, self._since, wrong[max(one.at, 0) :] = True, one, True
            before = slice(min(one.at, 0), 0)
            said.append(StuckEvent(Severity.ERROR, "angle_jumped", f"{text}; no row from there on is used"))
        return wrong, before, said
