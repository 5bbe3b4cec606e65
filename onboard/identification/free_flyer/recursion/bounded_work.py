"""Ticks and announcements that wait for a filter, and the bound on what it does in one call.

Per tick taken in, :data:`WORK` ticks are predicted, and what is left of a window's solve is done in the calls that
follow; ticks wait meanwhile, and are processed in the same order as without the bound. A call that comes late brings
more ticks, but no more work than their filter steps: else it would be the reason why the next one is later. A window is
solved by :meth:`BoundedWork.work`, so that what ticks give without it is reported first; ticks that waited for it are
processed there, too.
"""

from abc import ABC, abstractmethod
from collections import deque
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import gaps
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, JointGaps, Ticks
from onboard.identification.free_flyer.recursion.trials import WindowProblem
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.regressor.signals import EncoderJump

WORK = 40  # ticks predicted (90 to 150 us each, a piece at a time) per tick taken in: two thirds of a core at most
_FLEXIBLE = 7  # cost of a tick with flexible joints over that without, measured with five
_FLEXIBLE_WORK = 80  # as WORK, of a vehicle that has some: three quarters of a core
LAST_WORK_s = 6.0  # the same when a flight ends; an estimator that has not ended 10 s after it was asked to is killed
_TICK_s, _JOINT_s = 11e-6, 21e-6  # of a tick's prediction, and of each joint of it: measured with one and with five
STEP_WORK = 80  # cost of a filter step without flexible joints, in predicted ticks: measured with five joints


def last_work(joints: int) -> int:
    """Ticks that may be predicted when a flight ends, by the joints of the vehicle, none of them flexible."""
    return int(LAST_WORK_s / (_TICK_s + _JOINT_s * joints))


class _Announcement(NamedTuple):
    held: bool
    time_s: float


class _Jumped(NamedTuple):
    joint: str
    jump: EncoderJump


class BoundedWork(ABC):
    """What waits, and how much of it may be done now.

    Args:
        call_ticks: ticks of a call that does not come late.
        period_s: between ticks.
        none: no ticks, of this vehicle.
        flexible: some of the vehicle's joints are.
    """

    def __init__(self, call_ticks: int, period_s: float, none: Ticks, *, flexible: bool = False) -> None:
        self._gaps = JointGaps(period_s, none)
        self._period_s, self._pending = period_s, none  # taken, and not yet of a step or a window
        self._cost, self._work = (_FLEXIBLE, _FLEXIBLE_WORK) if flexible else (1, WORK)
        # not yet processed: ticks, announcements, encoders that are others from there on
        self._inbox: deque[Ticks | _Announcement | _Jumped] = deque()
        self._call_ticks, self._due = call_ticks, 0  # due: ticks that may be predicted now; negative after an excess
        self._asked: tuple[Ticks, WindowProblem] | None = None  # to be solved next
        self._solve: WindowSolve | None = None  # under way

    @property
    def _step_work(self) -> int:
        """Ticks in whose prediction's time a filter step is done."""
        return STEP_WORK * self._cost

    @property
    def solving(self) -> bool:
        """A window's solve is under way; ticks wait for it."""
        return self._solve is not None or self._asked is not None

    @abstractmethod
    def _announced(self, held: bool, time_s: float) -> None:
        """Take in an announcement."""

    @abstractmethod
    def _jumped(self, joint: str, jump: EncoderJump) -> None:
        """Take in that an encoder is another one from now on."""

    @abstractmethod
    def _wanted(self) -> int:
        """Ticks until there is something to do."""

    @abstractmethod
    def _ready(self) -> None:
        """Do or begin it."""

    @abstractmethod
    def _interrupted(self) -> None:
        """Go on after a gap between the ticks that are pending and those to come."""

    @abstractmethod
    def _posed(self, ticks: Ticks, trial: WindowProblem) -> WindowSolve:
        """The solve of a window that was asked for."""

    @abstractmethod
    def _end_of(self, solve: WindowSolve) -> None:
        """Take in the result of a window."""

    def _take(self, ticks: Ticks) -> None:
        """Take ticks up to the next filter step or window, and do or begin it; the others go back to the inbox."""
        before = self._pending.time_s[-1:]
        breaks = gaps(np.append(before, ticks.time_s), self._period_s).nonzero()[0] + (1 - len(before))
        if 0 in breaks:
            self._interrupted()
        last = min(self._wanted(), *breaks[breaks > 0], len(ticks.time_s))
        self._pending = self._pending.and_then(ticks.part(slice(0, last)))
        if last < len(ticks.time_s):
            self._inbox.appendleft(ticks.part(slice(last, None)))
        if self._wanted() == 0:
            self._ready()

    def _go_on(self) -> None:
        """Begin to solve the window that is asked for, or do one prediction of it."""
        if self._solve is None:
            assert self._asked is not None
            asked, self._asked = self._asked, None
            self._solve = self._posed(*asked)
        else:
            self._due -= self._cost * self._solve.advance()
        if self._solve.over:
            solve, self._solve = self._solve, None
            self._end_of(solve)

    def update(self, ticks: Ticks) -> None:
        """Takes ticks, in so many calls as they make that do not come late, and does the work."""
        for first in range(0, len(ticks.time_s), self._call_ticks):
            self.take(ticks.part(slice(first, first + self._call_ticks)))
            self.work()

    def take(self, ticks: Ticks) -> None:
        """Takes ticks; processes them in whole batches, the newest tick after its successor, up to a window.

        Over a short gap of the joints these are interpolated; after a longer one the momentum is estimated anew.
        """
        known = self._gaps.take(ticks)
        if len(known.time_s):
            self._inbox.append(known)
        steps = self._step_work * len(ticks.time_s) // BATCH_TICKS  # of as many ticks as these
        self._due += max(self._work * min(len(ticks.time_s), self._call_ticks), steps)
        self._do(max(self._due - steps, 0), solves=False)

    def announce(self, held: bool, time_s: float) -> None:
        """Take the announcement of a capture or a release, after the ticks taken in so far; no effect if known.

        It is a claim that the motion can contradict (:mod:`onboard.identification.free_flyer.recursion.solved`).
        """
        self._inbox.append(_Announcement(held, time_s))
        self._do(0, solves=False)

    def jumped(self, joint: str, jump: EncoderJump) -> None:
        """Take in that the encoder of a joint is another one after the ticks taken in so far."""
        self._inbox.append(_Jumped(joint, jump))
        self._do(0, solves=False)

    def work(self) -> None:
        """Solve the window that is due, and take the ticks that wait for it, as far as :data:`WORK` goes."""
        self._do(0, solves=True)
        self._due = min(self._due, 0)

    @property
    def lets_go(self) -> bool:
        """A release is announced that is not taken in yet, and no capture after it."""
        told = [one.held for one in self._inbox if isinstance(one, _Announcement)]
        return bool(told) and not told[-1]

    def finish(self, most: float = np.inf) -> bool:
        """Do all that is left to be done, or so many ticks' predictions; True if that was all."""
        self._do(min(self._due, 0) - most, solves=True)
        return not self.solving and not self._inbox

    def _do(self, least_due: float, *, solves: bool) -> None:
        while self.solving or self._inbox:
            oldest = None if self.solving else self._inbox[0]
            if oldest is not None and not isinstance(oldest, Ticks):
                self._inbox.popleft()
                self._announced(*oldest) if isinstance(oldest, _Announcement) else self._jumped(*oldest)
            elif self._due <= least_due or (self.solving and not solves):
                return
            elif oldest is None:
                self._go_on()
            else:
                self._inbox.popleft()
                self._take(oldest)
