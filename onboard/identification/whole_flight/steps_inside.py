"""Steps of instruments in a flight that was fitted as if there were none, from its normal equations.

With N and g the information and the gradient of all blocks after a time, A what one sigma of a step changes of the
constants, and P the covariance of the fit, a step from that time on is off, and tells of itself, by

    D = -P N A,   J = A' N A - A' N P N A,   d = -A' g

as in a window of the filter (:mod:`onboard.identification.free_flyer.steps`). Of two steps the first N is that of the
blocks after the later one. Times are those between two blocks.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.evidence.bank import Changed, Hypothesis, Suspect, columns_of
from onboard.identification.free_flyer.prediction.imu_prediction import RATE
from onboard.identification.free_flyer.steps import OtherError, steps_of
from onboard.identification.whole_flight.blocks import FlightFit
from onboard.identification.whole_flight.fit import WholeFlight


class StepsInside(NamedTuple):
    """Of every kind at every time, those of a time together."""

    times_s: FloatArray  # (t,)
    kinds: tuple[Suspect, ...]  # places as in the flight's names
    changed: Changed

    @staticmethod
    def of(flight: WholeFlight, found: FlightFit) -> "StepsInside":
        """Those of a flight by its fit."""
        middles = np.unique([block.middle_s for block in found.blocks])
        times_s = 0.5 * (middles[:-1] + middles[1:])
        every_s = float(np.diff(middles).mean()) if times_s.size else 0.0
        kinds = [one._replace(at=one.at - RATE.stop) for one in steps_of(flight.predictor, every_s)]
        along = np.zeros((len(found.names), sum(one.along.shape[1] for one in kinds)))
        for one, own in zip(kinds, columns_of(kinds), strict=True):
            along[one.at, own[0]] = one.along[:, 0]
        sums, told = np.zeros((len(middles), *along.shape)), np.zeros((len(middles), along.shape[1]))
        for block in found.blocks:
            at, changes = int(np.searchsorted(middles, block.middle_s)), along[block.columns]
            sums[at, block.columns] += block.normal.information @ changes
            told[at] -= changes.T @ block.normal.gradient
        sums, told = (part[::-1].cumsum(axis=0)[::-1][1:] for part in (sums, told))  # of the blocks after each time
        each, m = np.arange(len(times_s)), told.size
        later = np.maximum(each[:, None], each)
        NA = sums.transpose(1, 0, 2).reshape(len(along), m)
        both = np.einsum("pi,tpj->tij", along, sums)[later].transpose(0, 2, 1, 3).reshape(m, m)
        D = -found.fit.covariance @ NA
        return StepsInside(times_s, tuple(kinds), Changed(D, told.ravel(), both + NA.T @ D, 0.0 * along))

    def hypotheses(self, changed: Changed) -> list[Hypothesis]:
        """Each, and each two; ``changed``: as above, with something else free or not."""
        return changed.hypotheses([*self.kinds] * len(self.times_s))

    def taken(self, which: int) -> tuple[OtherError, tuple[float, float, float]]:
        """What one of them changes, by its number, places as in the predictor's state; its time, between two others.

        It may be at any of the ticks between these.
        """
        time, kind = divmod(which, len(self.kinds))
        one, times_s = self.kinds[kind], np.concatenate([[-np.inf], self.times_s, [np.inf]])
        first_s, at_s, last_s = times_s[time : time + 3].tolist()
        return OtherError(one.name, one.at + RATE.stop, one.along[:, 0]), (first_s, at_s, last_s)
