"""Whitened innovation of a batch of ticks."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.exiddm.imu_errors import whitened
from onboard.identification.exiddm.imu_prediction import Prediction

_IMMODERATE = 1e12  # of a prediction in SI units: the joints' signals are nonsense, and its squares may overflow


class Innovation(NamedTuple):
    """Whitened innovation of a batch; its covariance is ``S = H P H' + 1 = L L'``."""

    W: FloatArray  # L^-1 H P, (m, p)
    e: FloatArray  # L^-1 (measured less predicted), (m,)
    L: FloatArray  # (m, m)


def innovation_of(
    predicted: Prediction, measured: FloatArray, sigma: FloatArray, use: BoolArray, covariance: FloatArray
) -> Innovation:
    """The innovation of a batch of b ticks.

    Args:
        predicted: of the ticks.
        measured: (b, 6).
        sigma: (b, 6) of that.
        use: (b,) the ticks that are used.
        covariance: P, (p, p), of the state that predicted.
    """
    r, H = whitened(predicted.values, predicted.jacobian, measured, sigma, use)
    HP = H @ covariance
    S = HP @ H.T
    S.flat[:: len(S) + 1] += 1.0
    factor = np.asarray(np.linalg.cholesky(S), np.float64)
    solved = solve_triangular(factor, np.column_stack([HP, -r]), lower=True, check_finite=False)
    return Innovation(solved[:, :-1], solved[:, -1], factor)


def moderate(*arrays: FloatArray) -> bool:
    """Whether all values are such that their squares do not overflow."""
    return all(bool((np.abs(array) < _IMMODERATE).all()) for array in arrays)  # False for NaN
