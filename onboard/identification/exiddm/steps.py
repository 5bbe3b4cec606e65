"""Steps of a load cell's scale or zero in flight, each from a time on, weighed beside what may be wrong all flight.

Each alone, and each two, for what steps may go back.

The true state is ``x + D t``: D is how far a filter that does not know of a step of one sigma is off, t of unit normal
prior. D is the step at its time, goes through the filter's corrections and predictions, and shows in its innovations as
``G = H D`` (Willsky and Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in
linear systems, 1976). With the whitened innovations e the information of t is ``J = sum G'G`` and the gradient
``d = sum G'e``; evidence, mean and covariance follow as those of every hypothesis (:mod:`..evidence.bank`). The
filter's state does not grow.

Of a window, which is solved as a whole with constants that do not change, they follow from its normal equations: with
the unknowns at its first tick, their covariance P after it, whitened derivatives H by these and G by a step, residuals
r of the solution and the transition F to its end,

    D = step - F P H'G,   J = G'G - G'H P H'G,   d = G'r

A time that is no longer kept, the one of the least likely hypotheses, leaves its odds to the one after it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.policy import LIKELY_SIZE, STEPS_PER_HOUR
from onboard.identification.evidence.bank import Changed, Suspect
from onboard.identification.evidence.bodies import EACH
from onboard.identification.exiddm.prediction.further import FurtherCell
from onboard.identification.exiddm.prediction.imu_prediction import ImuPredictor
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS

_EVERY = 2  # batches between times of a step: 0.25 s beside it, a step of 2 % had half of its 60 nats within a second
_TIMES = 8  # that are kept; with twelve, five flights with a step told the same


class Inside(NamedTuple):
    """Steps of one sigma each at times inside a window."""

    lines: IndexArray  # of the load cells
    at: IndexArray  # (m,) places in the state
    size: FloatArray  # (m,)
    first: IndexArray  # (m,) ticks of the window from which on they are there

    def seen(self, rows: FloatArray, tick: int) -> FloatArray:
        """What they do to the cells' readings, (n, lines, m); ``rows``: derivatives of these from a tick on."""
        there = np.arange(tick, tick + len(rows))[:, None] >= self.first
        return np.asarray(rows[..., self.at] * (self.size * there)[:, None], np.float64)

    def changed(self, size: int) -> FloatArray:
        """What they do to a state of so many elements, (p, m)."""
        return np.asarray((np.arange(size)[:, None] == self.at) * self.size, np.float64)


class Adds(NamedTuple):
    """What a step adds to a state that is estimated as if there were none."""

    at: IndexArray  # places of what stepped
    shift: FloatArray  # (p,)
    root: FloatArray  # (p, r) of what is added to the covariance


_NONE: IndexArray = np.zeros(0, np.intp)
NO_STEPS = Inside(_NONE, _NONE, np.zeros(0), _NONE)


class Steps:
    """Of one filter.

    Args:
        predictor: of its instruments.

    Attributes:
        changed: D, d and J of each step.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._predictor, self._every_s = predictor, _EVERY * BATCH_TICKS * predictor.period_s
        self._what = tuple(_steps_of(predictor, self._every_s))
        self.forget()

    def forget(self) -> None:
        """Nothing is known of any before now."""
        self.begin(Changed.none(len(self._predictor.names)))

    def inside(self, ticks: int) -> Inside:
        """Those that are looked for in a window of so many ticks, in the order in which :meth:`begin` takes them."""
        times = np.arange(0, ticks, _EVERY * BATCH_TICKS)[1:]
        at = np.array([one.at[0] for one in self._what], np.intp)
        size = np.array([one.along[0, 0] for one in self._what], np.float64)
        predictor = self._predictor
        lines = [
            own.start
            for one, own in zip(predictor.further, predictor.lines[1:], strict=True)
            if isinstance(one, FurtherCell)
        ]
        steps = np.tile(at, len(times)), np.tile(size, len(times)), np.repeat(times, len(at))
        return Inside(np.array(lines, np.intp), *steps)

    def begin(self, inside: Changed) -> None:
        """The filter goes on from a window with these steps."""
        self._batches, self.changed = 0, inside
        self._stands = np.ones(len(inside.d) // max(len(self._what), 1))  # times that each time stands for
        self._may_be()

    @property
    def suspects(self) -> list[Suspect]:
        """What each step is of."""
        return [one._replace(odds=one.odds * times) for times in self._stands.tolist() for one in self._what]

    def step(self, told: tuple[FloatArray, FloatArray, FloatArray], transition: FloatArray) -> None:
        """To the end of a batch; every so often, the constants may be others from there on.

        Args:
            told: of its lines ``L^-1 H P``, (lines, p), whitened innovations, (lines,), and ``L^-1 H D``, (lines, m).
            transition: of what changes, (c, p).
        """
        (D, d, J), changing = self.changed, self._predictor.changing
        W, e, seen = told
        D = D - W.T @ seen
        D[changing] = transition @ D
        self.changed = Changed(D, d + seen.T @ e, J + seen.T @ seen)
        self._batches += 1
        if self._batches % _EVERY == 0:
            self._may_be()

    def _may_be(self) -> None:
        """From now on, too; of too many times the least likely but the newest is left to the one after it."""
        (D, d, J), each = self.changed, len(self._what)
        if not each:
            return
        logs, kept = self.changed.logs(self.suspects), np.arange(len(self._stands))
        logs = logs.max(axis=1, initial=-np.inf).reshape(-1, each).max(axis=1, initial=-np.inf)
        while len(kept) >= _TIMES:
            least = int(logs[kept][:-1].argmin())
            self._stands[kept[least + 1]] += self._stands[kept[least]]
            kept = np.delete(kept, least)
        steps, new = (each * kept[:, None] + np.arange(each)).ravel(), np.zeros((len(D), each))
        for k, one in enumerate(self._what):
            new[one.at, k] = one.along[:, 0]
        d, J = np.append(d[steps], np.zeros(each)), np.pad(J[np.ix_(steps, steps)], (0, each))
        self.changed = Changed(np.hstack([D[:, steps], new]), d, J)
        self._stands = np.append(self._stands[kept], 1.0)


def _steps_of(predictor: ImuPredictor, every_s: float) -> Iterator[Suspect]:
    odds = STEPS_PER_HOUR * every_s / 3600.0
    for one in predictor.further:
        for kind in ("scale", "bias") if isinstance(one, FurtherCell) else ():
            if (name := f"{kind}_{one.name}") in predictor.names:
                at = np.array([predictor.names.index(name)])
                along = np.full((1, 1), LIKELY_SIZE if kind == "scale" else EACH * predictor.sigma[at[0]])
                for part in (at, along):
                    part.setflags(write=False)  # a checkpoint names it
                yield Suspect(f"a step of {one.name}", at, along, odds)
