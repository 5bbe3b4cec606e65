"""Where the steps of a filter are linearised: about the constants as the last window found them, not as they are now.

Some directions of the state no motion shows: all masses times one factor, a joint's place along its own axis with all
that hangs on it. Which directions these are depends on the state. A filter that linearises every step about its newest
estimate counts what it has moved by as information along them: of an arm of 0.6 kg, whose masses are known to 1 %, the
place of a gripper was told three times as well as the same ticks tell in one window, and an answer was 4 sigmas off.
About one state the directions stay the same, and such steps tell what the window of all ticks tells (first-estimates
Jacobians: Huang, Mourikis and Roumeliotis, A First-Estimates Jacobian EKF for Improving SLAM Consistency, 2009; values
are linear here, too, which costs one prediction instead of two).

What pushes the base is told from all masses by its own size alone: twice the push on twice the masses moves them alike.
It changes with time, so the steps are always linearised about no push, where that direction is one of the masses only.
(About the newest push, 250 s of free flight with nothing held told all masses 7 sigmas off, by ticks that tell nothing
of them.)

What is neglected is of second order, a product of what no motion shows and of what is not yet known: at most 0.015 of a
sigma of one tick along six flights of that arm. Where the estimate has moved so far that a prediction changes by more
than a sigma of a tick, as when a motion begins that shows what none before it has, steps are linearised about the
newest estimate from there on.
"""

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.prediction.imu_prediction import ImuPredictor
from onboard.identification.exiddm.prediction.ticks import Prediction, Ticks

_MOVED = 1.0  # rms change of a batch's prediction, in sigmas of a tick, beyond which it is linearised anew


class Linearised:
    """Predicts the batches of a filter.

    Args:
        predictor: of its instruments.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._predictor = predictor
        self._pushes = np.array(predictor.pushes, np.intp).ravel()
        self._about: FloatArray | None = None  # (p,) of which the constants count

    def forget(self) -> None:
        """The next batch is linearised about its own state, as that of a window just solved."""
        self._about = None

    def predict(self, ticks: Ticks, state: FloatArray) -> tuple[FloatArray, Prediction]:
        """Of a batch, from a state at the first of its b + 2 ticks, (p,).

        Returns:
            The state about which it is linearised, (p,): these constants, what changes as it is now, and no push. And
            the prediction: its values are those of ``state`` to first order, what it carries is that of the former.
        """
        if self._about is not None:
            about, found, moved = self._near(ticks, self._about, state)
            if found.moderate:
                sigmas = (moved / ticks.sigma[1:-1])[np.isfinite(ticks.measured[1:-1])]
                if not sigmas.size or float(sigmas @ sigmas) <= _MOVED**2 * sigmas.size:
                    return about, found
        self._about = state.copy()
        return self._near(ticks, state, state)[:2]

    def _near(
        self, ticks: Ticks, constants: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, Prediction, FloatArray]:
        """Linearised about other constants and no push; and what the constants alone have moved, (b, lines)."""
        about, changing, pushes = constants.copy(), self._predictor.changing, self._pushes
        about[changing] = state[changing]
        moved = state - about
        moved[pushes], about[pushes] = 0.0, 0.0
        found = self._predictor.predict(ticks.q, ticks.dq, ticks.ddq, about, ticks.cyclic, ticks.thrust)
        if not found.moderate:
            return about, found, np.zeros(())
        by_constants = found.jacobian @ moved
        values = found.values + by_constants + found.jacobian[:, :, pushes] @ state[pushes]
        return about, found._replace(values=values), by_constants
