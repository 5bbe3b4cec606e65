"""Finds the wrong instrument of a window that the model does not explain: the window is solved without each of them.

The fits are compared by their strain: the squared corrections over their stated sigmas, and the excess of their
residuals over chance. The noise of the readings, which differs from fit to fit, is not part of that.

A load cell that is accused may be right: it sees a light payload that is caught or let go, which the IMUs hardly do.
Without the cell nothing speaks against the payload as it was. So the window is also solved with all instruments and
the payload changed. Where that explains it, the same readings decide between it and errors of the cell (offset, scale,
delay) of any size: a changed payload must be 10,000 times as likely; else a longer window is asked.

A tracker of the base's pose sees no payload before the IMUs do. One that is frozen agrees with a base that hardly
turns, and what was known then may come from it: the window without it is solved with nothing known of before.
"""

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import REFUSE
from onboard.identification.free_flyer.fusion import Fusion
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.recursion.solved import HeldPayload, Solved

_CLEARLY = -2.0 * math.log(REFUSE)  # squares by which a fit must be less strained than any other


class WindowProblem(NamedTuple):
    """How a window is to be solved."""

    hypotheses: tuple[HeldPayload, ...]
    without: tuple[int, ...] = ()  # instruments
    freed: int | None = None  # an instrument whose errors may be of any size
    anew: bool = False  # with nothing known of before: it may come from what is left out
    stated: bool = False  # as if nothing were free
    free: tuple[int, ...] = ()  # suspects that may be wrong, besides those that are free
    stepped: tuple[int, ...] = ()  # steps inside it that are there
    about: FloatArray | None = None  # (p,) a state with the payload that steps change
    start: FloatArray | None = None  # where a solve begins of something that is not, or all, as stated; None: guesses

    @property
    def wrong(self) -> bool:
        """Something that is not free is not as stated."""
        return bool(self.free or self.stepped)


class Exclusion(NamedTuple):
    """What the trials of a window came to."""

    instrument: int
    found: Solved  # without it
    clear: bool  # without no other the window is explained, or much worse
    others: tuple[int, ...]  # without which the window is explained as well

    def doubt(self, names: Sequence[str]) -> str:
        """Which instruments contradict each other, if it is not clear which is wrong; else empty."""
        both = " and ".join(names[k] for k in sorted((self.instrument, *self.others)))
        return "" if self.clear else f"{both} contradict each other, and nothing tells which is wrong"


def unchanged(hypotheses: tuple[HeldPayload, ...]) -> tuple[HeldPayload, ...]:
    """Those of a payload as before, if there are any: an instrument that is wrong does not change it."""
    return tuple(one for one in hypotheses if one is not HeldPayload.NEW) or hypotheses


def without_memory(hypotheses: tuple[HeldPayload, ...]) -> tuple[HeldPayload, ...]:
    """The same where nothing is known of a payload that was held before."""
    return tuple(dict.fromkeys(HeldPayload.NEW if one is HeldPayload.SAME else one for one in hypotheses))


class WindowFits:
    """The fits of one window.

    Args:
        doubted: instruments without which it is to be solved.
        hypotheses: under which.
        trackers: instruments that hold all that is known to one motion of the base, so that nothing is left of it.
    """

    changed: Solved | None = None  # no other payload is tried

    def __init__(
        self, doubted: Sequence[int], hypotheses: tuple[HeldPayload, ...], trackers: Sequence[int] = ()
    ) -> None:
        self._left, self._hypotheses, self._trackers = list(doubted), hypotheses, trackers
        self._found: list[tuple[int, Solved]] = []

    def next(self) -> WindowProblem | None:
        """The next fit to be made, without an instrument; None: none is left."""
        if not self._left:
            return None
        if self._left[0] in self._trackers:
            return WindowProblem(without_memory(self._hypotheses), without=(self._left[0],), anew=True)
        return WindowProblem(self._hypotheses, without=(self._left[0],))

    def take(self, found: Solved | None) -> None:
        """The window without that instrument; None if it is not explained."""
        instrument = self._left.pop(0)
        if found is not None:
            self._found.append((instrument, found))

    @property
    def choice(self) -> Exclusion | None:
        """The instrument without which the fit is the least strained; None if the window is explained without none."""
        if not self._found:
            return None
        (best, found), *rest = sorted(self._found, key=lambda one: one[1].strained)
        clear = not rest or rest[0][1].strained - found.strained > _CLEARLY
        return Exclusion(best, found, clear, tuple(instrument for instrument, _ in rest))


class _Outcome(Enum):
    """What the trials of an accused cell came to."""

    WRONG = "the cell is wrong"
    CHANGED = "the payload changed"
    LONGER = "a longer window is needed"
    NEITHER = "the window is not explained without the cell either"


_CHANGED = {HeldPayload.NOTHING: HeldPayload.NEW, HeldPayload.SAME: HeldPayload.NOTHING}


class CellTrials:
    """The fits of one window in which a load cell is accused (this module's head).

    Args:
        cell: its number.
        hypotheses: of the payload as it was.
        last: whether there is no longer window.
    """

    def __init__(self, cell: int, hypotheses: tuple[HeldPayload, ...], *, last: bool) -> None:
        self._cell, self._hypotheses, self._last = cell, hypotheses, last
        self._without: Solved | None = None
        self._changed: Solved | None = None
        other = tuple(_CHANGED[one] for one in hypotheses if one in _CHANGED)
        self._left = [WindowProblem(hypotheses, without=(cell,)), *([WindowProblem(other)] if other else [])]
        self._outcome = _Outcome.NEITHER

    def next(self) -> WindowProblem | None:
        """The next fit to be made; None: none is left."""
        return self._left[0] if self._left else None

    def take(self, found: Solved | None) -> None:
        """The window so solved; None if it is not explained."""
        trial = self._left.pop(0)
        if trial.without:
            self._without, self._outcome = found, _Outcome.NEITHER if found is None else _Outcome.WRONG
            if found is None:
                self._left.clear()
        elif trial.freed is not None:
            assert self._changed is not None
            if found is None or found.cost - self._changed.cost > _CLEARLY:
                self._outcome = _Outcome.CHANGED
            else:
                self._outcome = _Outcome.WRONG if self._last else _Outcome.LONGER
        elif found is not None and (found.hypothesis is HeldPayload.NOTHING or found.state[PAYLOAD][0] > 0.0):
            self._changed, self._outcome = found, _Outcome.LONGER
            self._left.append(WindowProblem(self._hypotheses, freed=self._cell))

    @property
    def choice(self) -> Exclusion | None:
        """The cell, not clear where a longer window is needed; None if it is not left out."""
        if self._without is None or self._outcome is _Outcome.CHANGED:
            return None
        return Exclusion(self._cell, self._without, self._outcome is _Outcome.WRONG, ())

    @property
    def changed(self) -> Solved | None:
        """The window with another payload, or none, if that is by far the likeliest."""
        return self._changed if self._outcome is _Outcome.CHANGED else None


def trials_of(
    fusion: Fusion, hypotheses: tuple[HeldPayload, ...], accused: int | None, window: int, windows: int
) -> WindowFits | CellTrials:
    """The trials of a window.

    Args:
        fusion: the instruments.
        hypotheses: of the window; those of a payload as before, if it is the first one and an IMU may be wrong.
        accused: an instrument; None: the window is not explained by all.
        window: its number, the shortest first.
        windows: how many there are.
    """
    if accused is not None and accused not in (*fusion.imus, *fusion.trackers):
        return CellTrials(accused, hypotheses, last=window + 1 == windows)
    doubted = fusion.doubted(longer=window > 0) if accused is None else fusion.rivals(accused)
    return WindowFits(doubted, hypotheses if window else unchanged(hypotheses), fusion.trackers)
