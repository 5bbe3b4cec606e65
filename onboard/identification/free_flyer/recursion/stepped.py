"""While the payload is poorly known, replaces a window and the filter steps after it by one longer window.

A step is linearised about the estimate of its time. While that is far off, each step adds false information in
unobservable directions, which later steps do not remove. So the window and the steps since are solved as one window, of
8 s or of twice the window, and again at twice that length where the mass was not known to a few percent, as of a light
vehicle that caught a heavy payload. It is solved sooner where steps are linearised about different states
(:mod:`.linearised`), as when a part of the drawing is wrong: the steps together then have information in unobservable
directions. With a base 7 % and a gyro 1 % off, steps of 11 s had evidence of 430 nats against two bodies that were
right, and an answer 6.7 sigmas off; one window of the same ticks has 46 nats.

Without a payload the base's rate may be poorly known: at rest it cannot be separated from large zeros of the gyros. In
a short window the rate has several sharp minima, so it is solved again up to 8 s in any case. Steps about a rate that
is a tenth of a rad/s off are wrong within a second, at rest too. So the information of an arm at rest is discarded when
it begins to move, except its last second: a new window begins with that second and the state known before.

Known limit: in a window the drift of a bias is constant, in steps it is a random walk.
"""

import numpy as np

from onboard.estimation.policy import AGAIN, FARTHEST_SIZE, LIKELY_SIZE
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.further import TURNING_rad_s, left_of
from onboard.identification.free_flyer.prediction.imu_prediction import RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.solved import HeldPayload, LONGEST_s, Solved, WINDOWS_s
from onboard.identification.free_flyer.recursion.trials import WindowProblem
from onboard.identification.quantities import SUPPORTED_SHRINKAGE

_FIRST_s = WINDOWS_s[-1]  # of a window of the steps, at least
_AT_REST_s = WINDOWS_s[0]  # time at rest that is kept
_WELL = LIKELY_SIZE / FARTHEST_SIZE  # relative sigma of a mass that is off by no likely error: linearised well enough
_WELL_rad_s = SUPPORTED_SHRINKAGE * TURNING_rad_s  # and sigma of the base's rate, which the zeros of a gyro bound


class SteppedTicks:
    """Ticks of a window and of the steps since.

    Args:
        ticks: of the window.
        length_s: at which they are solved again.
        held: a payload is.
        first: none of the steps has been replaced yet, and the window before them had not grown.
        well: they are linearised well enough, and only kept: if something is freed, they are solved again.
    """

    def __init__(self, ticks: Ticks, length_s: float, *, held: bool, first: bool, well: bool = False) -> None:
        self._parts, self._length_s, self.held, self.first = [ticks], length_s, held, first and not well
        self._well = well
        self._again_s = AGAIN * self._now_s
        self._rests = not held and ticks.rest  # the arm, in all of them

    @staticmethod
    def since(
        ticks: Ticks, solved: Solved, predictor: ImuPredictor, known: Known, *, grown: bool
    ) -> "SteppedTicks | None":
        """Of a window; None if steps are linearised well enough, or it would be too long.

        Args:
            ticks: of the window.
            solved: its solution.
            predictor: of the instruments.
            known: before the window.
            grown: it has.
        """
        length_s, held = (2.0 * float(ticks.time_s[-1] - ticks.time_s[0]), solved.hypothesis is not HeldPayload.NOTHING)
        well = solved.hypothesis is HeldPayload.SAME or (not held and _knows_zeros(predictor, known))
        # noise drives the bends of flexible joints: steps count that, a window does not
        if well or not _reaches(LONGEST_s, length_s) or predictor.bends.size:
            return None
        return SteppedTicks(ticks, max(_FIRST_s if held else 0.0, length_s), held=held, first=held and not grown)

    def add(self, ticks: Ticks, predictor: ImuPredictor, known: Known) -> tuple[Known, Ticks | None]:
        """Take in the ticks of a step, of which the first two are known.

        Args:
            ticks: of the step.
            predictor: of the instruments.
            known: before the first of all ticks.

        Returns:
            The same of those that are kept; where the arm begins to move, these ticks, with which a window begins.
        """
        self._parts.append(ticks.part(slice(2, None)))
        if not self._rests:
            return known, None
        if not ticks.rest:
            self._rests = False
            return known, self.ticks
        dropped = max(0, len(self.ticks.time_s) - round(_AT_REST_s / predictor.period_s) - 2)
        self._parts = [self.ticks.part(slice(dropped, None))]
        return _later(predictor, known, dropped), None

    @property
    def _now_s(self) -> float:
        return float(self._parts[-1].time_s[-1] - self._parts[0].time_s[0])

    def due(self, *, apart: bool) -> bool:
        """They are to be solved again; ``apart``: steps since the last time are linearised about different states."""
        length_s = min(self._again_s, self._length_s) if apart else self._length_s
        return not self._well and _reaches(self._now_s, length_s)

    @property
    def over(self) -> bool:
        """They are kept no longer."""
        return self._well and _reaches(self._now_s, self._length_s)

    @property
    def ticks(self) -> Ticks:
        """All of them."""
        self._parts = [Ticks.joined(self._parts)]
        return self._parts[0]

    @property
    def asked(self) -> tuple[Ticks, WindowProblem]:
        """How they are to be solved again."""
        return self.ticks, WindowProblem((HeldPayload.NEW if self.held else HeldPayload.NOTHING,))

    def after(self, solved: Solved) -> "SteppedTicks | None":
        """What is to be solved after the window of all is; None if nothing is, or it was long."""
        rate = float(np.sqrt(np.diag(solved.covariance)[RATE].max()))
        well = solved.mass_sigma < _WELL if self.held else rate < _WELL_rad_s and _reaches(self._length_s, _FIRST_s)
        early = not _reaches(self._now_s, self._length_s)
        length_s = self._length_s if early else 2.0 * self._length_s
        if (well and not self.held) or not _reaches(LONGEST_s, length_s):
            return None
        return SteppedTicks(self.ticks, length_s, held=self.held, first=self.first and early, well=well)


def _reaches(now_s: float, length_s: float) -> bool:
    """Whether a window is as long as another, but for a tick or two at its ends."""
    return now_s > 0.99 * length_s


def _later(predictor: ImuPredictor, known: Known, ticks: int) -> Known:
    """What is known of all but the rate so many ticks later, if these tell nothing."""
    (mean, covariance), after_s = (part.copy() for part in known), ticks * predictor.period_s
    for bias_at, drift_at in [*predictor.biases, *predictor.pushes]:
        mean[bias_at] += after_s * mean[drift_at]
        covariance[bias_at] += after_s * covariance[drift_at]
        covariance[:, bias_at] += after_s * covariance[:, drift_at]
    left = left_of(predictor.fading, after_s, len(mean))
    return mean * left, predictor.aged(left[:, None] * covariance * left, ticks)


def _knows_zeros(predictor: ImuPredictor, known: Known) -> bool:
    """Whether the zeros of one gyro at least are known so well that it tells the rate."""
    at = [k for k, name in enumerate(predictor.names) if name.startswith("gyro_bias_rad_s")]
    if len(at) < 3 * len(predictor.imu_frames):  # one has none
        return True
    worst = np.sqrt(np.diag(known[1])[at]).reshape(-1, 3).max(axis=1)
    return bool(worst.min() < _WELL_rad_s)
