"""Bias of a payload's estimate by the noise of the joints, and its correction.

The joints' noise eps is in the prediction h and in its derivative alike, so that least squares makes the payload too
light by about the square of the accelerations' noise over the motion (errors in variables; Fuller, Measurement Error
Models, 1987). With ``r = y - h(theta, x + eps)`` the expected gradient of the whitened squares is
``E[h_theta' r / s^2] = -1/2 d(h_x V h_x') / dtheta / s^2``, V the variance of eps: half the derivative by theta of the
variance that the joints add to a line, over that line's whole variance. It is added to the gradient here.
"""

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.imu_prediction import PAYLOAD, ImuPredictor

_BATCHES = 4  # whose noise is accounted for at once, in the posture of the last
_STEP = 1e-3  # of finite differences, kg, kg m, kg m^2


class RegressorNoise:
    """Gradient that the noise of the joints takes from the payload.

    Args:
        predictor: of the instruments.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._predictor, self._inflation = predictor, predictor.inflation
        self.forget()

    def forget(self) -> None:
        """Begin anew after a reset of the filter."""
        self._sums: FloatArray | None = None
        self._count = 0

    def gradient(self, q: FloatArray, joint_sigma: FloatArray, weight: FloatArray, state: FloatArray) -> FloatArray:
        """Of the payload, (10,), from the batches since it was given last; zero while there are too few.

        Args:
            q: joint positions of a batch, (b, joints).
            joint_sigma: of joint rates and accelerations, inflated, (b, 2, joints).
            weight: of each line, one over its variance, zero if it is not used, (b, lines).
            state: (p,).
        """
        sums = np.einsum("nm,nkj->jkm", weight, (joint_sigma / self._inflation) ** 2)
        self._sums = sums if self._sums is None else self._sums + sums
        self._count += 1
        found = np.zeros(10)
        if self._count < _BATCHES or not self._sums.any():
            return found
        for k, at in enumerate(range(PAYLOAD.start, PAYLOAD.stop)):
            sides = []
            for step in (_STEP, -_STEP):
                moved = state.copy()
                moved[at] += step
                effect = self._predictor.joint_effect(q[-1:], moved)[0]
                sides.append(float((effect**2 * self._sums).sum()))
            found[k] = 0.5 * (sides[0] - sides[1]) / (2.0 * _STEP)
        self.forget()
        return found
