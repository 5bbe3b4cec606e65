"""What noise of the joints' samples adds to the gradient of predicted less measured.

See :mod:`onboard.identification.exiddm.prediction.joint_noise`. Zero by delays: a rate of change of noise is as often
along it as against. Zero of a tracker's pose, in which rates are summed, and of lines of rates.
"""

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.exiddm.prediction.imu_prediction import PIECE, ImuPredictor
from onboard.identification.exiddm.prediction.joint_noise import in_turn
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS, TickPrediction, Ticks

_NOISELESS = 1e-3  # of the variance of a line: what noise of the joints below that does to an estimate is left out


def noise_added(
    predictor: ImuPredictor,
    ticks: Ticks,
    sigma: FloatArray,
    use: BoolArray,
    state: FloatArray,
    turn: int = 0,
    noise: FloatArray | None = None,
) -> FloatArray:
    """Of all lines, (p,); zero where the noise is next to nothing beside that of every line.

    Args:
        predictor: of the instruments.
        ticks: b + 2 of them.
        sigma: of what was measured, (b, m).
        use: which lines count, (b, m).
        state: (p,) at the first tick.
        turn: whose turn it is first, a count.
        noise: one sigma of each line, (b + 2, m), where it is known.
    """
    added = np.zeros(len(state))
    noise = predictor.joint_noise(ticks.q, ticks.sample_sigma, state) if noise is None else noise
    if not is_noisy(noise[1:-1], sigma, use):
        return added
    for first in range(0, len(sigma), PIECE):
        own, here = ticks.part(slice(first, first + PIECE + 2)), slice(first, first + PIECE)
        by_line, state = added_by_line(predictor, own, sigma[here], use[here], state, turn + first // BATCH_TICKS)
        added += by_line.sum(axis=0)
    return added


def is_noisy(noise: FloatArray, sigma: FloatArray, use: BoolArray) -> bool:
    """Whether noise of the joints, (b, m), is more than next to nothing in some line; see :func:`noise_added`."""
    share = np.divide(noise, sigma, out=np.zeros(sigma.shape), where=use)
    return bool(share.max(initial=0.0) ** 2 >= _NOISELESS)


def added_by_line(
    predictor: ImuPredictor,
    ticks: Ticks,
    sigma: FloatArray,
    use: BoolArray,
    state: FloatArray,
    turn: int,
    right: TickPrediction | None = None,
) -> tuple[FloatArray, FloatArray]:
    """The same of each line, (m, p), of ticks that are predicted at once; and the state at the last tick but one.

    ``right``: their prediction without an error, where it is there.
    """
    counts = np.zeros_like(use)
    counts[:, predictor.of_forces] = use[:, predictor.of_forces]
    weight = np.divide(1.0, sigma**2, out=np.zeros(sigma.shape), where=counts)
    error = in_turn(ticks.sample_sigma, BATCH_TICKS, turn)
    error[0] = 0.0  # the momentum is that of the first tick
    wrong = predictor.predict(
        ticks.q, ticks.dq + error[:, 0], ticks.ddq + error[:, 1], state, ticks.cyclic, ticks.thrust
    )
    if right is None:
        right = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)
    added = np.einsum("bm,bmp->mp", weight * (wrong.values - right.values), wrong.jacobian - right.jacobian)
    added[:, predictor.of_delays] = 0.0
    return added, right.state
