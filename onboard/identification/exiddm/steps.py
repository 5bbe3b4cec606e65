"""Steps of a load cell's scale or zero in flight, each from a time on, weighed beside what may be wrong all flight.

The true state is ``x + D t``: D is how far a filter that does not know of a step of one sigma is off, t of unit normal
prior. D is the step at its time, goes through the filter's corrections and predictions, and shows in its innovations as
``G = H D`` (Willsky and Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in
linear systems, 1976). With the whitened innovations e the information of t is ``J = sum G'G`` and the gradient
``d = sum G'e``; evidence, mean and covariance follow as those of every hypothesis (:mod:`..evidence.bank`). The
filter's state does not grow.

A window that begins anew has constants that do not change, and steps begin after it. One that replaces the filter's
steps solves the same ticks: what they have told of a step stays.
"""

from collections.abc import Iterator

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.evidence.bank import Changed, Suspect
from onboard.identification.evidence.bodies import EACH
from onboard.identification.evidence.policy import LIKELY_SIZE, STEPS_PER_HOUR
from onboard.identification.exiddm.prediction.further import FurtherCell
from onboard.identification.exiddm.prediction.imu_prediction import ImuPredictor
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS

_EVERY = 10  # batches between candidate times of a step: the motion changes in no less than a second
_TIMES = 8  # candidate times that are kept: the newest, and the likeliest of the others


class Steps:
    """Of one filter.

    Args:
        predictor: of its instruments.

    Attributes:
        changed: D, d and J of each step.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._predictor, self._every_s = predictor, _EVERY * BATCH_TICKS * predictor.period_s
        self._what, self._batches = tuple(_steps_of(predictor, self._every_s)), 0
        self.forget()

    def forget(self) -> None:
        """The filter goes on from a window, after which they may be others."""
        self._batches, self._numbers = 0, np.zeros(0, np.intp)  # of each step among what they are of
        self.changed = Changed.none(len(self._predictor.names))
        self._may_be()

    @property
    def suspects(self) -> list[Suspect]:
        """What each step is of."""
        return [self._what[k] for k in self._numbers.tolist()]

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
        self.changed = Changed(D, d + seen.T @ e, J + (seen * seen).sum(axis=0))
        self._batches += 1
        if self._batches % _EVERY == 0:
            self._may_be()

    def _may_be(self) -> None:
        (D, d, J), each = self.changed, len(self._what)
        kept = np.ones(len(d), np.bool_)
        if each and len(d) == _TIMES * each:
            least = int(self.changed.nats.reshape(-1, each).max(axis=1)[:-1].argmin())
            kept[least * each : (least + 1) * each] = False
        new = np.zeros((len(D), each))
        for k, one in enumerate(self._what):
            new[one.at, k] = one.along[:, 0]
        none = np.zeros(each)
        self.changed = Changed(np.hstack([D[:, kept], new]), np.append(d[kept], none), np.append(J[kept], none))
        self._numbers = np.append(self._numbers[kept], np.arange(each))


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
