"""The solves of one window: as it is asked for, as stated, and with what is likelier than that.

What a hypothesis makes of a window is told by the linear model about a solution. That is wrong where the payload is
half or twice as heavy by it: of 80 flights of a twin with a step of a tenth in the scales of its IMU, and 20 or 60
times its noise, 42 had the mass outside of its 99.9 % interval, and one where the window is solved under the
hypothesis, from guesses. Its evidence is that of two solutions, not of the linear model.

A window that is not explained is solved with what contradicts it most, unless something touched the vehicle. After a
change that only another payload explains it is solved with that of before, a part of which has come off or been added.
"""

from collections.abc import Callable, Iterator

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import FARTHEST_SIZE, LEAST_WEIGHT
from onboard.identification.evidence.bodies import changes
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.recursion.solved import EXPLAINED, HeldPayload, Solved
from onboard.identification.free_flyer.recursion.trials import WindowProblem
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.identification.free_flyer.suspects import Rivals

_NOTHING = WindowProblem(())
_Taken = tuple[WindowSolve, WindowProblem]


class WindowRounds:
    """Of one window after the other.

    Args:
        rivals: what may not be as stated.

    Attributes:
        result: the solve that counts, of a window that is not settled yet.
    """

    result: WindowSolve

    def __init__(self, rivals: Rivals) -> None:
        self._rivals = rivals
        self._first: WindowSolve | None = None  # of the window, while others of it are under way
        self._stated: Solved | None = None  # the window as stated
        self._left = list[WindowProblem]()  # yet to be solved
        self._tried = list[tuple[WindowProblem, WindowSolve]]()
        self.forget()
        self._wrong, self._odds = _NOTHING, 1.0  # what is not as stated in the result, and its odds

    @property
    def wrong(self) -> bool:
        """An instrument or the drawing is not as stated in the result."""
        return bool(self._wrong.free) or self._altered != self._wrong.stepped

    @property
    def altered(self) -> bool:
        """The payload changes in the result."""
        return bool(self._altered)

    @property
    def _altered(self) -> tuple[int, ...]:
        return self._rivals.steps.of_payload(self._wrong.stepped)

    def forget(self) -> None:
        """The next window has another first tick."""
        # of a solve with something free, and as stated; None: by guesses, as another explanation may be far off
        self._start: FloatArray | None = None
        self._stated_start: FloatArray | None = None

    def next(self, trial: WindowProblem, solve: WindowSolve, *, disturbed: bool) -> WindowProblem | None:
        """What is to be solved after this solve; None: nothing, there is a result.

        Args:
            trial: what was solved.
            solve: what came of it.
            disturbed: something touched the vehicle, which may be why the window is not explained as it is asked for.
        """
        first = self._first or solve
        asked = first.nearest if _exchanged(first) else first.found or (None if disturbed else first.nearest)
        if trial.wrong:
            self._tried.append((trial, solve))
            if not self._left:
                self.result, self._wrong = self._of_a_change(first) if _exchanged(first) else self._of_an_error(first)
            return self._left.pop(0) if self._left else None
        self.result, self._wrong = first, _NOTHING
        if asked is None:
            return None
        if self._first is None and self._rivals.freed:
            self._first = solve
            return WindowProblem((asked.hypothesis,), stated=True, start=self._stated_start)
        self._first, self._stated = first, None if solve is first and _exchanged(first) else solve.found
        self._stated_start = self._stated_start if self._stated is None else self._stated.start
        problems = {(one.free, one.stepped): one for one in self._with_what_is_likelier(first, asked)}
        self._left = list(problems.values())
        return self._left.pop(0) if self._left else None

    def _with_what_is_likelier(self, first: WindowSolve, asked: Solved) -> Iterator[WindowProblem]:
        """The window with what is likelier than what it was solved for; after a change also with an instrument's alone.

        And with the payload of before, a part of which has come off or been added.
        """
        if asked.hypothesis is HeldPayload.NOTHING:  # an empty arm that seems heavy may hold something
            return
        exchanged = _exchanged(first)
        for payload in (True, False) if exchanged else (True,):
            known = asked.known, asked.steps
            freed, stepped, self._odds = self._rivals.wrong(*known, changed=exchanged, payload=payload)
            if stepped or (freed and asked.tells_mass):  # else too much fits, and what is free tells even less
                wrong = WindowProblem((asked.hypothesis,), free=freed, stepped=stepped, start=self._start)
                yield wrong._replace(about=asked.start)
        if exchanged:
            yield WindowProblem((HeldPayload.SAME,), stepped=self._rivals.steps.altering, about=first.prior[0])

    def _of_an_error(self, first: WindowSolve) -> _Taken:
        """The window with something not as stated, if that is likelier, its odds counted.

        The window is not explained as it was asked for, or has less evidence: the linear model about its solution does
        not know other minima.
        """
        for trial, solve in self._tried:
            if (found := solve.found) is not None and found.has_mass:
                asked = first.found
                if asked is None or found.evidence + np.log(self._odds) > asked.evidence:
                    return solve, trial
        return first, _NOTHING

    def _of_a_change(self, first: WindowSolve) -> _Taken:
        """What a change was that only another payload explains as stated.

        That the payload has changed is as likely beforehand as that an instrument has: the one that is far likelier
        counts, or both where they were solved together. A payload of which a part has come off must be likelier than
        any other payload.
        """
        assert first.found is not None
        kinds: dict[bool | None, tuple[float, _Taken]] = {}  # payload's alone, instrument's alone, both
        for trial, solve in self._tried:
            if (found := solve.found) is None or not found.has_mass:
                continue
            of_payload = self._rivals.steps.of_payload(trial.stepped)
            both = bool(of_payload) and of_payload != trial.stepped
            if of_payload and not (found.evidence > first.found.evidence and _is_part(found, first)):
                continue
            kind = None if both else bool(of_payload)
            if kind not in kinds or found.evidence > kinds[kind][0]:
                kinds[kind] = found.evidence, (solve, trial)
        none = -np.inf, (first, _NOTHING)
        (part, altered), (error, instrument) = kinds.get(True, none), kinds.get(False, none)
        if error + np.log(LEAST_WEIGHT) > max(_if_changed(first), part):
            return instrument
        return altered if part > error - np.log(LEAST_WEIGHT) else kinds.get(None, none)[1]

    def settle(self) -> Callable[[Known], Known]:
        """Take in the result; what the constants that are not as stated make of what was known before the window."""
        free = self._rivals.taken(self._wrong.free, self._wrong.stepped)
        if (found := self.result.found) is not None:
            unexplained = self._stated is None  # as stated
            nats = -np.log(EXPLAINED) if self._stated is None else found.evidence - self._stated.evidence
            if self.wrong or not self.altered:  # else nothing becomes free
                self._rivals.solved(found.known, float(nats), at_least=unexplained)
            self._start = found.start if self._rivals.freed else None
        self._first = self._stated = None
        self._tried = []
        del self.result  # megabytes, which every checkpoint would write
        return free


def _exchanged(solve: WindowSolve) -> bool:
    """Whether the window is explained by another payload than the one before, which no gripper takes up unseen."""
    new = solve.found is not None and solve.found.hypothesis is HeldPayload.NEW
    return new and solve.nearest is not None and solve.nearest.hypothesis is HeldPayload.SAME


def _is_part(found: Solved, first: WindowSolve) -> bool:
    """Whether the payload changes by no more than a part of it does."""
    by = found.state[PAYLOAD] - found.start[PAYLOAD]
    return bool(np.abs(np.linalg.lstsq(changes(first.prior[0][PAYLOAD]), by)[0]).max() < FARTHEST_SIZE)


def _if_changed(solve: WindowSolve) -> float:
    """Evidence of another payload, if it is the one of before, changed by a tenth; infinite where that is not known."""
    assert solve.found is not None
    told, spread = solve.found.state[PAYLOAD], solve.found.covariance[PAYLOAD, PAYLOAD]
    mean, before = solve.prior[0][PAYLOAD], solve.prior[1][PAYLOAD, PAYLOAD]
    if not mean[0] > 0.0:
        return np.inf
    by = changes(mean)
    like = _log_density(told - mean, spread + before + by @ by.T)
    return solve.found.evidence + like - _log_density(told, spread + np.diag(solve.payload_sigma**2))


def _log_density(x: FloatArray, covariance: FloatArray) -> float:
    """Of a Gaussian of mean zero, but for what its size gives."""
    return -0.5 * float(x @ np.linalg.solve(covariance, x) + np.linalg.slogdet(covariance)[1])
