"""Tests a filter's corrections against their stated sigmas, once for each state of the filter.

Each is tested by itself, except constants that the bank of hypotheses covers in every direction; and all together.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.corrections import Together, expected_sigma, together
from onboard.identification.evidence.bank import Weighed
from onboard.identification.free_flyer.fusion import Fusion
from onboard.identification.free_flyer.prediction.imu_prediction import DRIFT_MEMORY_s, ImuPredictor


class Corrections(NamedTuple):
    """Corrections of what is in use, in two measures."""

    known: IndexArray  # places in the state of those with a stated sigma, of which each is held
    in_stated: FloatArray  # their sizes in these
    steady: IndexArray  # places of those of them that do not change during the flight
    in_told: FloatArray  # their sizes in sigmas of what the data tell of each
    at_once: Together  # all that do not change, the weighed ones too


class HeldAgainst:
    """Holds the corrections against what is stated.

    Args:
        predictor: states it.
        fusion: what is in use.
        weighed: places in the state of what is not to be held against anything one by one.
    """

    def __init__(self, predictor: ImuPredictor, fusion: Fusion, weighed: IndexArray) -> None:
        self._predictor, self._fusion, self._weighed = predictor, fusion, weighed
        self._of: tuple[Weighed, list[int]] | None = None
        self._told: Corrections | None = None

    def of(self, weighed: Weighed) -> Corrections:
        """The corrections if the likeliest hypothesis is true, but of what it says is wrong."""
        left_out, of = self._fusion.left_out, self._of
        if self._told is None or of is None or of[0] is not weighed or of[1] != left_out:
            self._of, self._told = (weighed, [*left_out]), self._hold(weighed)
        return self._told

    def _hold(self, weighed: Weighed) -> Corrections:
        (state, covariance), suspect = weighed.known(weighed.likeliest), weighed.likeliest.suspect
        predictor, stated = self._predictor, stated_after(self._predictor, self._fusion.running_s)
        known = np.isfinite(stated) & (stated > 0.0)
        for k in self._fusion.left_out:
            known[predictor.of_each[k]] = False
        if suspect is not None:
            known[suspect.at] = False
        steady = known.copy()
        steady[[*(k for pair in predictor.biases for k in pair), *(k for k, _ in predictor.wandering)]] = False
        at = steady.nonzero()[0]
        sigma, P = stated[at], covariance.take(at, 0).take(at, 1)
        P /= sigma[:, None] * sigma
        in_all = together(state[at] / sigma, P)
        known[self._weighed] = steady[self._weighed] = False
        every, each = known.nonzero()[0], steady.nonzero()[0]
        in_told = state[each] / expected_sigma(stated[each] ** 2, covariance[each, each])
        return Corrections(every, state[every] / stated[every], each, in_told, in_all)


def stated_after(predictor: ImuPredictor, time_s: float) -> FloatArray:
    """What is stated of all constants after so long a flight, (p,): a bias drifts by its drift's sigma all the time."""
    stated, (biases, drifts) = predictor.stated.copy(), np.array(predictor.biases, np.intp).reshape(-1, 2).T
    stated[biases] = np.hypot(predictor.sigma[biases], max(time_s, DRIFT_MEMORY_s) * predictor.sigma[drifts])
    return stated
