"""Which instruments a filter uses: each one's innovation given the others, and those left out as contradicting them.

A batch's lines are ordered by instrument, those in use before those left out, so that by the Cholesky factor of the
innovation's covariance each instrument's whitened innovation is that given all instruments before it, and an instrument
at the end takes no part. An instrument whose innovation is improbable is refused for that batch; after several batches
in a row it is accused. A payload that is caught looks alike, and a cell sees it before the first IMU does, so the
filter leaves the accused out only if the same payload explains a window without it; one that was refused is used again
when it has agreed for ``_AGREES_BATCHES`` in a row, once; a tracker never, as any pose agrees where the one it should
show is not known. What errors of scale do over longer times the bank of hypotheses weighs. The reference, the first IMU
in use, is not tested so: what contradicts the model there is a change, which the filter detects. Where it is itself the
wrong one, a window is explained without it (:mod:`onboard.identification.free_flyer.recursion.trials`), and the next
IMU becomes the reference. One that gives no readings for a second is left out as well.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from onboard.dynamics.tracked_pose import LINES
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.policy import MOSTLY, READING
from onboard.identification.online import Change

_PATIENCE_BATCHES = 5  # refused, or accused, in a row: those in which a change is detected
_AGREES_BATCHES = 100  # in a row: it is used again
_ABSENT_BATCHES = 10  # in a row: it is left out


class Accusation(NamedTuple):
    """An instrument in use that contradicts the others."""

    instrument: int
    batches: int  # for how many; 0: since the start
    for_good: bool  # if it is left out

    @property
    def back(self) -> int | None:
        """Batches before this one of which the estimates are not to be used either; None: since the start."""
        return self.batches + 1 if self.batches else None


class Fusion:
    """The instruments of one filter.

    Args:
        names: of the instruments, the first IMU first.
        lines: of each in a tick's measurement.

    Attributes:
        left_out: instruments that contradict the others or are absent, in the order in which they were found.
        absent: those left out that give no readings.
        trackers: of the base's pose.
        refused: one in use that was refused for several batches in a row; None if none was.
        running_s: since the first ticks.
    """

    def __init__(self, names: Sequence[str], lines: Sequence[slice]) -> None:
        self.names, self._lines = tuple(names), tuple(lines)
        self.left_out: list[int] = []
        self._imus = [k for k, own in enumerate(lines) if own.stop - own.start == lines[0].stop]
        self.trackers = [k for k, own in enumerate(lines) if own.stop - own.start == LINES]
        self._began_s, self.running_s = np.nan, 0.0
        self._agreed = [0] * len(self.names)
        self.forget()
        self.absent: set[int] = set()
        self._missing = 0  # batches in a row without the reference
        self._barred: set[int] = set()  # never used again
        self._news: list[Change] = []

    def run(self, until_s: float) -> None:
        """Ticks up to a time are processed."""
        self._began_s = until_s if np.isnan(self._began_s) else self._began_s
        self.running_s = until_s - self._began_s

    @property
    def imus(self) -> list[int]:
        """IMUs in use."""
        return [k for k in self._imus if k not in self.left_out]

    @property
    def reference(self) -> int:
        """The IMU that is always used, whose innovations are tested for changes: the first one in use."""
        return self.imus[0]

    @property
    def order(self) -> list[int]:
        """Instruments, those in use first."""
        return [k for k in range(len(self.names)) if k not in self.left_out] + self.left_out

    @property
    def contradicting(self) -> tuple[str, ...]:
        """Names of what is left out."""
        return tuple(self.names[k] for k in self.left_out if k not in self.absent)

    def rivals(self, accused: int) -> list[int]:
        """Instruments of which one is wrong: of IMUs that contradict each other it can be either."""
        return [accused, *(k for k in self.imus if k != accused)] if accused in self.imus else [accused]

    def doubted(self, *, longer: bool) -> list[int]:
        """Instruments that may be wrong where a window, or a longer one than before, is not explained by all."""
        imus = self.imus if len(self.imus) > 1 else []
        others = [k for k in self.order if k not in self.left_out and k not in self._imus]
        return imus + [k for k in others if longer or k in self.trackers]

    def expect(self, measured: FloatArray) -> None:
        """Do without IMUs that have measured in less than half of some ticks, (n, lines), if another has in more."""
        there = {k: float(np.isfinite(measured[:, self._lines[k].start]).mean()) for k in self.imus}
        absent = [k for k in there if there[k] < MOSTLY]
        for k in absent if len(absent) < len(there) else ():
            self.leave_out(k, for_good=False, kind="absent")

    def forget(self) -> None:
        """Clear the windows after a reset of the filter."""
        self.refused: Accusation | None = None
        self._refused, self._accusing = [0] * len(self.names), 0  # batches in a row

    def standing(self, accused: Accusation | None) -> Accusation | None:
        """An accusation that has been made in every batch for long enough; count a batch, None: nothing is accused."""
        self._accusing = 0 if accused is None else self._accusing + 1
        if accused is None or self._accusing <= _PATIENCE_BATCHES:
            return None
        return accused._replace(batches=accused.batches and accused.batches + _PATIENCE_BATCHES)

    def leave_out(self, instrument: int, *, for_good: bool = True, kind: str = "left_out") -> None:
        """Do not use an instrument from now on, or until it has agreed for long enough; ``kind``: of the event."""
        if for_good or instrument in self.trackers:
            self._barred.add(instrument)
        if instrument not in self.left_out:
            self.left_out.append(instrument)
            self._refused[instrument] = self._agreed[instrument] = 0
            if kind == "absent":
                self.absent.add(instrument)
            self._news.append(Change(kind, np.nan, np.nan, np.nan, self.names[instrument]))

    def rows(self, order: Sequence[int], ticks: int) -> IndexArray:
        """Places of a batch's lines, (ticks x lines,), instrument by instrument."""
        return _rows(tuple((own.start, own.stop) for own in (self._lines[k] for k in order)), ticks)

    def without(self, left_out: Sequence[int], measured: FloatArray) -> FloatArray:
        """Ticks without what some instruments measured, (n, lines)."""
        measured = measured.copy() if left_out else measured
        for k in left_out:
            measured[:, self._lines[k]] = np.nan
        return measured

    def whole(self, measured: FloatArray) -> BoolArray:
        """Which lines are there, (n, lines): all of an instrument at a tick, or none."""
        there = np.isfinite(measured)
        for own in self._lines:
            there[:, own] = there[:, own].all(axis=1, keepdims=True)
        return there

    def improbable(
        self, order: Sequence[int], innovation: FloatArray, there: BoolArray, known: Sequence[int] = ()
    ) -> int | None:
        """The first of the instruments in ``order``, but the reference, whose innovation is improbable.

        Args:
            order: in which the innovation has them.
            innovation: whitened, of a batch, in that order.
            there: which lines were measured, (n, lines).
            known: instruments that are not asked for.
        """
        at = 0
        for k in order:
            own = self._lines[k]
            e = innovation[at : (at := at + len(there) * (own.stop - own.start))]
            freedom = int(there[:, own].sum())
            if k != self.reference and k not in known and freedom and chdtrc(freedom, float(e @ e)) < READING:
                return k
        return None

    def judged(self, refused: Sequence[int], seen: NDArray[np.bool_]) -> None:
        """Count a batch for and against each instrument.

        Args:
            refused: instruments with an improbable innovation.
            seen: which instruments measured at all, (instruments,).
        """
        reference, others = self.reference, any(seen[k] for k in self.imus)
        self._missing = self._missing + 1 if others and not seen[reference] else 0
        if self._missing >= _ABSENT_BATCHES:
            self._missing = 0
            self.leave_out(reference, for_good=False, kind="absent")
        for k in range(len(self.names)):
            if k == self.reference or not seen[k]:
                continue
            self._refused[k] = self._refused[k] + 1 if k in refused else 0
            self._agreed[k] = 0 if k in refused else self._agreed[k] + 1
            if self._refused[k] >= _PATIENCE_BATCHES and k not in self.left_out:
                self.refused = Accusation(k, self._refused[k], for_good=False)
            elif k in self.left_out and k not in self._barred and self._agreed[k] >= _AGREES_BATCHES:
                self.left_out.remove(k)
                self.absent.discard(k)
                self._barred.add(k)  # the next time it stays out
                self._news.append(Change("taken_back", np.nan, np.nan, np.nan, self.names[k]))

    def news(self) -> list[Change]:
        """Instruments left out and taken back since the last call."""
        news, self._news = self._news, []
        return news


@lru_cache
def _rows(order: tuple[tuple[int, int], ...], ticks: int) -> IndexArray:
    """Places of the lines of instruments, from the one to before the other, in ticks that have them all."""
    width = max(stop for _, stop in order)
    each = [width * np.arange(ticks)[:, None] + np.arange(*own) for own in order]
    found: IndexArray = np.concatenate([own.ravel() for own in each])
    found.setflags(write=False)
    return found
