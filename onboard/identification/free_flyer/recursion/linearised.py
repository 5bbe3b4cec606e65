"""Linearisation point of a filter's steps: constants as the last window estimated them, not the newest estimate.

Some directions of the state are not observable: all masses times one factor; a joint's place along its own axis
together with all links beyond it. The directions depend on the state. A filter that linearises every step about its
newest estimate therefore counts its own corrections as information along them: of an arm of 0.6 kg, whose masses are
known to 1 %, the sigma of a gripper's place was a third of that which the same ticks give in one window, and an answer
was 4 sigmas off. About one state the directions stay the same, and the steps have the information of the window of all
ticks (first-estimates Jacobians: Huang, Mourikis and Roumeliotis, A First-Estimates Jacobian EKF for Improving SLAM
Consistency, 2009; values are linear here, too, which costs one prediction instead of two).

The neglected terms are of second order, products of unobservable and of unknown components: at most 0.015 of a sigma of
one tick along six flights of that arm. Where the estimate has moved so far that a prediction changes by more than a
sigma of a tick, the prediction is also made about the newest estimate; where the two differ by more than a tenth of a
sigma, as when a motion of a new kind begins, later steps are linearised about the newest estimate. Not sooner: when a
gyro's axes were corrected by three sigmas, predictions changed by one sigma, all but 0.012 of it linearly. Steps that
are always linearised anew gave all masses of a free-flyer without a cell with a sigma of 6 %, although the ticks
contain no information on them.
"""

import numpy as np

from onboard.dynamics.model.inertia import elements
from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import TickPrediction, Ticks

_MOVED = 1.0  # rms change of a batch's prediction, sigmas of a tick, beyond which the batch is predicted again
_LINEAR = 0.02  # unless the non-linear part, extrapolated by the square of the change, is smaller than this
_BENT = 0.1  # non-linear part beyond which the batch is linearised again


class Linearised:
    """Predicts the batches of a filter.

    Args:
        predictor: of its instruments.

    Attributes:
        apart: batches since the last window are linearised about different states.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._predictor, self.apart = predictor, False
        self._about: FloatArray | None = None  # (p,) of which the constants count
        self._bent = np.inf  # what is not linear of a change, over its square
        self._known_about: FloatArray | None = None  # (p,) of the batches before
        self._base = np.zeros(len(predictor.names))  # (p,) by which the logarithm of its masses changes
        if (base := predictor.vehicle.spec.base_link) in predictor.drawn:
            (at, half), first = predictor.drawn[base], 10 * predictor.vehicle.links.index(base)
            drawn = np.linalg.solve(half, predictor.vehicle.chi[first : first + 10])
            self._base[at] = drawn / (drawn @ drawn)
        self._place, self._axis = _of_last_joint(predictor)

    def forget(self) -> None:
        """The next batch is linearised about its own state, as that of a window just solved."""
        self._about = self._known_about = None
        self.apart = False

    def begin_anew(self) -> None:
        """The next batch is linearised about its own state, and what is known was so about another."""
        self._about, self.apart = None, True

    def known(self, covariance: FloatArray) -> FloatArray:
        """Information of the batches before, (p, p), as it would be about the state of the last prediction.

        They determine the payload's parameters over the base's masses, and where it is along the last joint's axis, not
        its place in its own frame: a payload found to be larger is one more where the base is heavier, and has a first
        moment less where that joint is placed farther out.
        """
        before, now = self._known_about, self._about
        self._known_about = now
        if before is None or now is None or before is now:
            return covariance
        factor, change = float(np.exp(self._base @ (now - before))), np.eye(len(now))
        change[PAYLOAD, PAYLOAD] *= factor
        change[PAYLOAD] += np.outer(now[PAYLOAD] - factor * before[PAYLOAD], self._base)
        farther = _displaced(now[PAYLOAD], self._axis) - factor * _displaced(before[PAYLOAD], self._axis)
        change[PAYLOAD] += np.outer(farther, self._place)
        return np.asarray(change @ covariance @ change.T, np.float64)

    def predict(self, ticks: Ticks, state: FloatArray) -> tuple[FloatArray, TickPrediction, FloatArray]:
        """Of a batch, from a state at the first of its b + 2 ticks, (p,).

        Returns:
            The state about which it is linearised, (p,): these constants, and what changes as it is now. The
            prediction: its values are those of ``state`` to first order, what it carries is that of the former. And the
            values there, (b, lines).
        """
        if self._about is not None:
            about, changing = self._about.copy(), self._predictor.changing
            about[changing] = state[changing]
            found = self._of(ticks, about)
            if found.moderate:
                moved = found.jacobian @ (state - about)  # (b, lines)
                far = _rms(moved, ticks)
                if far <= _MOVED or self._bent * far**2 <= _LINEAR:
                    return about, found._replace(values=found.values + moved), found.values
                anew = self._of(ticks, state)
                bent = _rms(anew.values - found.values - moved, ticks)
                if bent <= _BENT:
                    self._bent = bent / far**2
                    return about, found._replace(values=anew.values), found.values
            self.apart = True
        self._about, self._bent = state.copy(), np.inf
        found = self._of(ticks, state)
        return state, found, found.values

    def _of(self, ticks: Ticks, state: FloatArray) -> TickPrediction:
        return self._predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)


def _rms(change: FloatArray, ticks: Ticks) -> float:
    """Of a change of a batch's values, (b, lines), in sigmas of a tick."""
    sigmas = (change / ticks.sigma[1:-1])[np.isfinite(ticks.measured[1:-1])]
    return float(np.sqrt(sigmas @ sigmas / max(sigmas.size, 1)))


def _displaced(chi: FloatArray, axis: FloatArray) -> FloatArray:
    """Change of a body's standard parameters, (10,), for a metre by which its frame is moved along a unit vector, (3,).

    By the parallel-axis theorem: first moments by ``-m a``, inertia by ``-2 (h.a) 1 + h a' + a h'``.
    """
    h = chi[1:4]
    across = np.outer(h, axis)
    return np.concatenate([[0.0], -chi[0] * axis, elements(across + across.T - 2.0 * (h @ axis) * np.eye(3))])


def _of_last_joint(predictor: ImuPredictor) -> tuple[FloatArray, FloatArray]:
    """What its place along its own axis is of a state, (p,), and that axis in the payload's frame, (3,)."""
    vehicle, along = predictor.vehicle, np.zeros(len(predictor.names))
    held = vehicle.model.frames[vehicle.frame_id(str(vehicle.spec.payload_link))]
    if held.parentJoint < 2:  # fixed to the base
        return along, np.zeros(3)
    joint = vehicle.joints[held.parentJoint - 2]
    for axis, part in zip("xyz", joint.axis, strict=True):
        if (name := f"place_{axis}_{joint.name}") in predictor.names:
            along[predictor.names.index(name)] = part
    return along, np.asarray(held.placement.rotation.T @ joint.axis, np.float64)
