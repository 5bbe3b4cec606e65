"""Noise of lines: of each by itself, and of the joints, one of whose errors is in all lines of a tick.

Taken for independent, along some directions of the payload the gradient scattered by two to four times its variance.
Whitened by a Cholesky root, the first lines stay as they are but for their size: what an IMU's lines have in common
with a cell's is taken off the cell's.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray


class LineNoise(NamedTuple):
    """Of n ticks and m lines."""

    sigma: FloatArray  # (n, m) all together
    by_joint: FloatArray  # (n, 2 joints, m) by one sigma of each joint's rate and acceleration

    @staticmethod
    def of(own: FloatArray, by_joint: FloatArray) -> "LineNoise":
        """Of that of each line by itself, (n, m), and that of the joints."""
        return LineNoise(np.hypot(own, sigma_of(by_joint)), by_joint)

    @staticmethod
    def alone(sigma: FloatArray) -> "LineNoise":
        """Of lines that have nothing in common, (n, m)."""
        return LineNoise(sigma, np.zeros((len(sigma), 0, sigma.shape[1])))

    def part(self, which: slice) -> "LineNoise":
        """Of some ticks."""
        return LineNoise(self.sigma[which], self.by_joint[which])

    def together(self, use: BoolArray) -> FloatArray:
        """Covariance of a tick's lines over their sigmas, (n, m, m); those not in use, (n, m), are by themselves."""
        share = np.divide(self.by_joint, self.sigma[:, None], out=np.zeros(self.by_joint.shape), where=use[:, None])
        covariance = share.swapaxes(1, 2) @ share
        at = np.arange(self.sigma.shape[1])
        covariance[:, at, at] = 1.0
        return np.asarray(covariance, np.float64)

    def whitening(self, use: BoolArray) -> FloatArray:
        """What the lines of a tick are multiplied by, (n, m, m); zero of those not in use, (n, m)."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.together(use)))
        return np.divide(inverse, self.sigma[:, None], out=np.zeros_like(inverse), where=use[:, None] & use[:, :, None])


def sigma_of(by_joint: FloatArray) -> FloatArray:
    """Of each line, (n, m), by what one sigma of each joint does to it, (n, 2 joints, m)."""
    return np.asarray(np.sqrt(np.einsum("njm,njm->nm", by_joint, by_joint)), np.float64)
