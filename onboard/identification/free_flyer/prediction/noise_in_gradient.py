"""What noise of the joints' samples adds to gradient and information of predicted less measured.

See :mod:`onboard.identification.free_flyer.prediction.joint_noise`. By delays the gradient is zero: a rate of change of
noise is as often along it as against. What they add to the information is theirs alone, and two to eight times what
noise adds, as the errors change their signs from tick to tick: a delay is known by more than noise, or as stated. Of a
tracker's pose, in which rates are summed, nothing is added.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.free_flyer.prediction.imu_prediction import PIECE, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NOISELESS, PRODUCT, LineNoise, NoiseAdded, at_once
from onboard.identification.free_flyer.prediction.ticks import TickPrediction, Ticks

_NONE = np.zeros((0, 0, 0))


class AddedByLine(NamedTuple):
    """What errors of the joints do, over the sigmas of b ticks."""

    effect: FloatArray  # (b, m) on each line
    slopes: FloatArray  # (b, m, p) and on its derivatives
    state: FloatArray  # (p,) at the last tick but one
    alike: FloatArray  # (b,) see :class:`.Ticks`
    of_delays: BoolArray  # (p,) what are delays
    of_lines: FloatArray  # (m, p) information of each line, noise in it

    def of(self, lines: slice, which: slice = slice(None)) -> NoiseAdded:
        """What some lines add to gradient and information of a part of the state."""
        effect, n = self.effect[:, lines], len(self.effect)
        slopes, scatter = self.slopes[:, lines, which].reshape(effect.size, -1), PRODUCT * self.alike @ (effect**2)
        gradient, information, late = effect.ravel() @ slopes, slopes.T @ slopes, self.of_delays[which]
        gradient[late], information[late[:, None] != late] = 0.0, 0.0
        return NoiseAdded(gradient, information, float(scatter.sum()), n, self.of_lines[lines, which].sum(axis=0))


class NoiseInPieces:
    """Of all lines, a piece of a window at a time; nothing where the noise is next to nothing beside that of each line.

    Args:
        predictor: of the instruments.
        ticks: b + 2 of them.
        lines: noise of what was measured, of b ticks.
        use: which lines count, (b, m).
        state: (p,) at the first tick.
        tick: number of the first.
        noise: one sigma of each line, (b + 2, m), where it is known.
        at: of a batch, a prediction without an error and its state, (p,), about which what is added is linear.
        each: the gradient of each tick is wanted.

    Attributes:
        added: by the pieces so far.
        by_tick: that gradient, (b, p); zero of what is not predicted yet.
        over: that is all.
    """

    def __init__(
        self,
        predictor: ImuPredictor,
        ticks: Ticks,
        lines: LineNoise,
        use: BoolArray,
        state: FloatArray,
        tick: int = 0,
        noise: FloatArray | None = None,
        at: tuple[FloatArray, TickPrediction] | None = None,
        *,
        each: bool = False,
    ) -> None:
        self.added, self.by_tick, self._done = NoiseAdded.none(len(state)), np.zeros((each * len(use), len(state))), 0
        self._predictor, self._ticks, self._state, self._tick, self._at = predictor, ticks, state, tick, at
        noise = predictor.joint_noise(ticks.q, ticks.sample_sigma, state) if noise is None else noise
        self.over = not is_noisy(noise[1:-1], lines.sigma, use)
        self._whitening = lines.whitening(use & ~predictor.of_poses) if not self.over else _NONE

    def advance(self) -> int:
        """Predict a piece, with errors of the joints and, if that is not given, without; how many ticks that were."""
        here = slice(self._done, min(self._done + PIECE, len(self._whitening)))
        own, (about, right) = self._ticks.part(slice(here.start, here.stop + 2)), self._at or (self._state, None)
        whitening = self._whitening[here]
        by_line = added_by_line(self._predictor, own, whitening, about, self._tick + here.start, right)
        if about is not self._state:
            by_line.effect[:] += by_line.slopes @ (self._state - about)
        self.added, self._state = self.added.plus(by_line.of(slice(None))), by_line.state
        if len(self.by_tick):
            self.by_tick[here] = np.einsum("bm,bmp->bp", by_line.effect, by_line.slopes)
        self._done, self.over = here.stop, here.stop == len(self._whitening)
        return len(whitening) * (2 if right is None else 1)

    def whole(self) -> NoiseAdded:
        """All of it at once."""
        while not self.over:
            self.advance()
        return self.added


def is_noisy(noise: FloatArray, sigma: FloatArray, use: BoolArray) -> bool:
    """Whether noise of the joints, (b, m), is more than next to nothing in some line; see :class:`NoiseInPieces`."""
    share = np.divide(noise, sigma, out=np.zeros(sigma.shape), where=use)
    return bool(share.max(initial=0.0) ** 2 >= NOISELESS)


def added_by_line(
    predictor: ImuPredictor,
    ticks: Ticks,
    whitening: FloatArray,
    state: FloatArray,
    tick: int,
    right: TickPrediction | None = None,
) -> AddedByLine:
    """The same of ticks that are predicted at once.

    Args:
        predictor: of the instruments.
        ticks: b + 2 of them.
        whitening: of their lines, (b, m, m), zero of those that do not count.
        state: (p,) at the first tick.
        tick: number of the first.
        right: their prediction without an error, where it is there.
    """
    error = _of_means(at_once(ticks.sample_sigma, tick), float(np.median(predictor.weight[~predictor.of_poses])))
    error[0, 0] = 0.0  # the momentum is that of the first tick
    joints = ticks.q, ticks.dq + error[:, 0], ticks.ddq + error[:, 1]
    wrong = predictor.predict(*joints, state, _misread(predictor, ticks.cyclic, error), ticks.thrust)
    if right is None:
        right = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)
    slopes = np.subtract(wrong.jacobian, right.jacobian, out=wrong.jacobian)
    late = np.zeros(slopes.shape[2], np.bool_)
    late[predictor.of_delays] = True
    effect = (whitening @ (wrong.values - right.values)[:, :, None])[:, :, 0]
    told = whitening @ right.jacobian
    of_lines = np.einsum("bmp,bmp->mp", told, told)
    return AddedByLine(effect, whitening @ slopes, right.state, ticks.alike[1:-1], late, of_lines)


def _of_means(error: FloatArray, weight: float) -> FloatArray:
    """Errors at the middle of each tick of which the ticks' means are these, (n, 2, joints): see :func:`.tick_mean`.

    Those of samples hardly change from one tick to the next. Of errors that change their sign, a mean is a sixth less:
    what they add was 20 to 30 % less than what drawn noise of encoders adds.
    """
    n = len(error)
    return np.asarray((_middles(n, weight) @ error.reshape(n, -1)).reshape(error.shape), np.float64)


@lru_cache(maxsize=8)
def _middles(n: int, weight: float) -> FloatArray:
    """What makes values at the middle of n ticks of their means, (n, n); the first and the last are as they are."""
    means = np.eye(n)
    means[1:-1] += weight * np.diff(means, 2, axis=0)
    return np.asarray(np.linalg.inv(means), np.float64)


def _misread(predictor: ImuPredictor, cyclic: FloatArray, error: FloatArray) -> FloatArray:
    """Functions of cyclic errors, (n, 3, m), where rates and accelerations are read with an error, (n, 2, joints).

    They are of the angle that is read, so that their derivatives change by their slopes times that.
    """
    if not cyclic.shape[2]:
        return cyclic
    wrong, others = cyclic.copy(), cyclic[:, 0].reshape(len(cyclic), -1, 2)[:, :, ::-1].reshape(len(cyclic), 1, -1)
    wrong[:, 1:] += error @ predictor.cyclic_slopes * others
    return wrong
