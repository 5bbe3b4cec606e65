"""Has something changed? Innovations that are too large for too long, at a stated rate of false alarms.

As long as nothing has changed the whitened innovations of a filter are independent and of unit variance, so their sum
of squares over any window is chi-squared. An alarm is a sum over the newest 1, 2, 4 .. batches that would be exceeded
by chance no more often than stated. One tick alone never alarms: what a single one can add is bounded, since a glitch
is no change.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from onboard.estimation.arrays import FloatArray

_WINDOWS = (1, 2, 4, 8)
_SUSPICION = 1e-4  # by chance, of one batch
_GLITCH = 10.0  # times as likely by chance as an alarm: what a single tick counts for at most


class Detection(NamedTuple):
    """What one batch of innovations says."""

    glitches: NDArray[np.bool_]  # (n,) ticks that are beyond belief alone
    suspect: bool  # keep this batch out of the estimate until more is known
    alarm: bool
    score: float  # sum of squares per degree of freedom, of the window that is least likely
    batches: int  # in that window


class ChangeDetector:
    """Watches the innovations of a filter.

    Args:
        false_alarms_per_hour: at most, while the filter is what it says.
        batches_per_hour: how often :meth:`check` is called.
        width: of a tick's innovation.
    """

    def __init__(self, false_alarms_per_hour: float, batches_per_hour: float, width: int) -> None:
        self._chance = false_alarms_per_hour / (batches_per_hour * len(_WINDOWS))
        self._width = width
        self._glitch = float(chdtri(width, _GLITCH * self._chance))
        self._recent: deque[tuple[float, int]] = deque(maxlen=max(_WINDOWS))

    def forget(self) -> None:
        """Begin anew: the filter did."""
        self._recent.clear()

    def check(self, squares: FloatArray) -> Detection:
        """Takes in the next batch.

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
        suspect = rest.size > 0 and bool(chdtrc(self._width * rest.size, rest.sum()) < _SUSPICION)
        alarm = bool(chances[worst] < self._chance)
        return Detection(glitches, suspect, alarm, float(sums[span - 1] / freedom[span - 1]), span)
