"""Change detection: chi-squared test on sums of innovations over several windows, at a stated false alarm rate.

Without a change the whitened innovations of a filter are independent with unit variance, so their sum of squares over
any window is chi-squared. An alarm is a sum over the newest 1, 2, 4 .. batches whose chance probability is below the
stated rate. The contribution of a single tick is bounded, so that one outlier does not raise an alarm.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import REFUSE

_WINDOWS = (1, 2, 4, 8)
_GLITCH = 10.0  # bound on one tick: chance probability of an alarm times this


class Detection(NamedTuple):
    """Test result of one batch of innovations."""

    glitches: NDArray[np.bool_]  # (n,) ticks that are outliers on their own
    suspect: bool  # hold this batch back until the next ones are tested
    alarm: bool
    score: float  # sum of squares per degree of freedom of the least likely window
    batches: int  # in that window


class ChangeDetector:
    """Tests the innovations of a filter batch by batch.

    Args:
        false_alarms_per_hour: upper bound while the filter's model holds.
        batches_per_hour: rate of calls of :meth:`check`.
        width: components of a tick's innovation.
    """

    def __init__(self, false_alarms_per_hour: float, batches_per_hour: float, width: int) -> None:
        self._chance = false_alarms_per_hour / (batches_per_hour * len(_WINDOWS))
        self._width = width
        self._glitch = float(chdtri(width, _GLITCH * self._chance))
        self._recent: deque[tuple[float, int]] = deque(maxlen=max(_WINDOWS))

    def forget(self) -> None:
        """Clear the history after a reset of the filter."""
        self._recent.clear()

    def check(self, squares: FloatArray) -> Detection:
        """Tests the next batch.

        Args:
            squares: of the whitened innovation of each tick, summed over its channels, (n,).
        """
        glitches = squares > self._glitch
        bounded = np.minimum(squares, self._glitch)
        self._recent.append((float(bounded.sum()), self._width * len(squares)))
        sums, freedom = np.array(self._recent)[::-1].cumsum(axis=0).T
        spans = [k for k in _WINDOWS if k <= len(sums)]
        chances = np.array([chdtrc(freedom[k - 1], sums[k - 1]) for k in spans])
        worst = int(chances.argmin())
        span = spans[worst]
        rest = bounded[~glitches] if glitches.sum() == 1 else bounded
        suspect = rest.size > 0 and bool(chdtrc(self._width * rest.size, rest.sum()) < REFUSE)
        alarm = bool(chances[worst] < self._chance)
        return Detection(glitches, suspect, alarm, float(sums[span - 1] / freedom[span - 1]), span)
