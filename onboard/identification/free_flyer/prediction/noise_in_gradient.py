"""What noise of the joints' samples adds to gradient and information of predicted less measured.

See :mod:`onboard.identification.free_flyer.prediction.joint_noise`. Zero by delays: a rate of change of noise is as
often along it as against. Zero of a tracker's pose, in which rates are summed.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.free_flyer.prediction.imu_prediction import PIECE, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NOISELESS, NoiseAdded, in_turn
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, TickPrediction, Ticks


class AddedByLine(NamedTuple):
    """What errors of the joints do, each in its turn, over the sigmas of b ticks."""

    effect: FloatArray  # (b, m) on each line
    slopes: FloatArray  # (b, m, p) and on its derivatives
    state: FloatArray  # (p,) at the last tick but one

    def of(self, lines: slice, which: slice = slice(None)) -> NoiseAdded:
        """What some lines add to gradient and information of a part of the state."""
        slopes = self.slopes[:, lines, which].reshape(self.effect[:, lines].size, -1)
        return NoiseAdded(self.effect[:, lines].ravel() @ slopes, slopes.T @ slopes)


def noise_added(
    predictor: ImuPredictor,
    ticks: Ticks,
    sigma: FloatArray,
    use: BoolArray,
    state: FloatArray,
    turn: int = 0,
    noise: FloatArray | None = None,
    by_tick: FloatArray | None = None,
) -> NoiseAdded:
    """Of all lines; nothing where the noise is next to nothing beside that of every line.

    Args:
        predictor: of the instruments.
        ticks: b + 2 of them.
        sigma: of what was measured, (b, m).
        use: which lines count, (b, m).
        state: (p,) at the first tick.
        turn: whose turn it is first, a count.
        noise: one sigma of each line, (b + 2, m), where it is known.
        by_tick: zeros, (b, p), that become the gradient of each tick.
    """
    added = NoiseAdded.none(len(state))
    noise = predictor.joint_noise(ticks.q, ticks.sample_sigma, state) if noise is None else noise
    if not is_noisy(noise[1:-1], sigma, use):
        return added
    for first in range(0, len(sigma), PIECE):
        own, here = ticks.part(slice(first, first + PIECE + 2)), slice(first, first + PIECE)
        some = own, sigma[here], use[here], state, turn + first // BATCH_TICKS
        by_line = added_by_line(predictor, *some)
        added, state = added.plus(by_line.of(slice(None))), by_line.state
        if by_tick is not None:
            by_tick[here] = np.einsum("bm,bmp->bp", by_line.effect, by_line.slopes)
    return added


def is_noisy(noise: FloatArray, sigma: FloatArray, use: BoolArray) -> bool:
    """Whether noise of the joints, (b, m), is more than next to nothing in some line; see :func:`noise_added`."""
    share = np.divide(noise, sigma, out=np.zeros(sigma.shape), where=use)
    return bool(share.max(initial=0.0) ** 2 >= NOISELESS)


def added_by_line(
    predictor: ImuPredictor,
    ticks: Ticks,
    sigma: FloatArray,
    use: BoolArray,
    state: FloatArray,
    turn: int,
    right: TickPrediction | None = None,
) -> AddedByLine:
    """The same of ticks that are predicted at once; ``right``: their prediction without an error, where it is there."""
    weight = np.divide(1.0, sigma**2, out=np.zeros(sigma.shape), where=use & ~predictor.of_poses)
    error = in_turn(ticks.sample_sigma, BATCH_TICKS, turn)
    error[0] = 0.0  # the momentum is that of the first tick
    joints = ticks.q, ticks.dq + error[:, 0], ticks.ddq + error[:, 1]
    wrong = predictor.predict(*joints, state, _misread(predictor, ticks.cyclic, error), ticks.thrust)
    if right is None:
        right = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)
    slopes = np.subtract(wrong.jacobian, right.jacobian, out=wrong.jacobian)
    slopes[:, :, predictor.of_delays] = 0.0
    weight = np.sqrt(weight)
    slopes *= weight[:, :, None]
    return AddedByLine(weight * (wrong.values - right.values), slopes, right.state)


def _misread(predictor: ImuPredictor, cyclic: FloatArray, error: FloatArray) -> FloatArray:
    """Functions of cyclic errors, (n, 3, m), where rates and accelerations are read with an error, (n, 2, joints).

    They are of the angle that is read, so that their derivatives change by their slopes times that.
    """
    if not cyclic.shape[2]:
        return cyclic
    wrong, others = cyclic.copy(), cyclic[:, 0].reshape(len(cyclic), -1, 2)[:, :, ::-1].reshape(len(cyclic), 1, -1)
    wrong[:, 1:] += error @ predictor.cyclic_slopes * others
    return wrong
