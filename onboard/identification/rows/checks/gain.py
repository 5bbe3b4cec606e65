"""Gain of an instrument: whether its rows show another one than the estimate of all rows takes, and since when.

Every gain is estimated together with all parameters, which take up part of it, by one step of Newton's from the
estimate; the blocks' scores there are those of :mod:`onboard.identification.rows.row_blocks`. It is tested by Student's
t with the variance that these scores show and at least that of the stated noise, and of what is left over besides in
the very blocks that tell of it: a few blocks at an end, alike by chance in what vibration leaves, are no step, and
vibration of a fast sweep hides no step that a slow one shows. What other instruments leave over counts too, as far as
they tell of what takes up part of the gain. A block that carries much of it is given its leverage: one block of noise
at an end is none. Degrees of freedom are twice the blocks that tell of it, in effect ``(sum I_b)^2 / sum I_b^2`` by the
information I_b of each (Kish, Survey Sampling, 1965): a block is two kernels long. After a release few blocks tell of
the gain of the rows without the payload.

- *Step*: a jump of the scale, or an error that begins in the measured motion. Estimated together with a constant error
  of the gain for each time at which it could be; the likeliest is tested, corrected for the number of places tried.
- *Error against the others*: a gain that is wrong from the beginning shows where other instruments read the same
  motion. Parameters that only this instrument tells of take it up whole: then there is none.
- *Effect on the intervals*: an error that too few blocks tell of to be sure may be real all the same. Intervals contain
  what it does to the estimate, beyond what chance does, with the variance by the scatter of all blocks.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from onboard.dynamics.spatial import times
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import DOUBT, HALF, INTERVAL, LIKELY_SIZE, MOST_SHARE, ODDS, of_each

_ABSORBED = 0.01  # of a gain's information: what the parameters leave of a step at the release of a payload
LEAST_STEP = 0.03  # of a gain: instruments creep, and gears ripple; intervals contain smaller ones


class Blocks(NamedTuple):
    """Blocks of an instrument's rows."""

    times_s: FloatArray  # when each begins, (b,)
    H: FloatArray  # information of each, (b, p, p)
    scores: FloatArray  # derivative of each one's log likelihood at the estimate, (b, p)
    left: FloatArray  # residual sum of each, (b,)
    of_noise: FloatArray  # one over what the stated noise makes of ``left``, (b,)


class GainError(NamedTuple):
    """An error of an instrument's gain: of all its rows, or the likeliest step."""

    size: float  # relative
    chance: float  # probability of as much by the scatter of the blocks that tell of it
    sigmas: float  # of the scatter of all blocks, each relative to what is left over in it
    expected: float  # sigmas that chance exceeds in 5 % of cases
    moved: FloatArray  # (p,) change of the estimate by it
    time_s: float = np.nan  # of a step
    since_s: float = 0.0  # the first of the rows, until the step
    between: bool = False  # it lies between the recording without the payload and that with it
    stated: float = 0.0  # sigma of such an error that the vehicle file states, and that intervals hold

    @property
    def is_significant(self) -> bool:
        """Whether it is larger than what is left to the intervals, and not by chance."""
        return self.chance < of_each(DOUBT) and abs(self.size) > LEAST_STEP

    @property
    def is_as_stated(self) -> bool:
        """Whether it lies between the recordings, and within two of the sigmas stated for that."""
        return self.between and abs(self.size) <= HALF * self.stated

    @property
    def suspected(self) -> FloatArray:
        """What it does to the estimate beyond what chance and the stated sigma explain, (p,); in the intervals."""
        explained = (self.expected / self.sigmas) ** 2 + (HALF * self.stated / self.size) ** 2 if self.size else 1.0
        return np.asarray(self.moved * np.sqrt(max(0.0, 1.0 - explained)), np.float64)


class GainTests:
    """Tests of one instrument's gain.

    Args:
        parts: blocks of its rows, with the payload and without.
        others: those of the other instruments, which tell of the parameters that take up part of a gain.
        body: the estimate's parameters of bodies, (p,).
        every: information of all rows and the prior, (p, p).
    """

    def __init__(self, parts: Sequence[Blocks], others: Sequence[Blocks], body: FloatArray, every: FloatArray) -> None:
        self._body, self._others = body, others
        times_s = np.concatenate([part.times_s for part in parts])
        order = np.argsort(times_s, kind="stable")
        self._times_s = times_s[order]
        self._H, self._scores, self._left, self._of_noise = (
            np.concatenate(column)[order] for column in zip(*(part[1:] for part in parts), strict=True)
        )
        of_body = times(self._H, np.broadcast_to(body, self._scores.shape))
        self._later = np.cumsum(of_body[::-1], axis=0)[::-1]  # (k, p) sums over the blocks from a cut on
        unit = 1.0 / np.sqrt(np.diag(every))
        self._a = np.linalg.solve(every * np.outer(unit, unit), (self._later * unit).T).T * unit
        self._of_cut = self._later @ body - np.einsum("kp,kp->k", self._later, self._a)
        self._scored = np.cumsum((self._scores @ body)[::-1])[::-1]

    def error(self) -> GainError | None:
        """Of the gain of all its rows; None where the parameters take it up, or too few blocks tell of it.

        Its information is ``E_00`` of :meth:`step`: what the parameters leave of ``sum_b body' H_b body``.
        """
        information = float(self._of_cut[0])
        if len(self._times_s) < 3 or not information > _ABSORBED * float(self._later[0] @ self._body):
            return None
        size, n = float(self._scored[0]) / information, len(self._times_s)
        return self._tested(np.ones(n), -self._a[0], size, information, 1)

    def step(self, recorded_s: float) -> GainError | None:
        """The likeliest step; None where the blocks are too few to be cut.

        Readings after a cut k are predicted as ``(1 + g + G) Y body``, those before as ``(1 + G) Y body``. All
        parameters are estimated again with g and G, where the scores of all rows add up to zero at the estimate:

            a_k = every^-1 sum_(b >= k) H_b body
            E_jk = sum_(b >= j, b >= k) body' H_b body - a_j' sum_(b >= k) H_b body
            r = E_0k / E_00,  c_b = ([b >= k] - r) body - (a_k - r a_0),  g = sum_b ([b >= k] - r) body' scores_b / I

        with ``I = E_kk - r E_0k``.

        Between two recordings a gain has changed in as many cases as an instrument is wrong (:data:`ODDS`) in others.

        Args:
            recorded_s: when another recording begins.
        """
        times_s, n, later, a = self._times_s, len(self._times_s), self._later, self._a
        if n < 3 or not self._body.any():
            return None
        of_all = later @ self._body - a @ later[0]
        share = of_all / (self._of_cut[0] + LIKELY_SIZE**-2)
        information = self._of_cut - share * of_all
        information = np.where(information > _ABSORBED * (later @ self._body), information, 0.0)
        moved = self._scored - share * self._scored[0]
        information[0] = 0.0
        likely = np.divide(moved * moved, information, out=np.zeros(n), where=information > 0.0)
        k = int(np.argmax(likely))
        apart = [cut for cut in range(1, n) if times_s[cut - 1] < recorded_s <= times_s[cut]]
        between = bool(apart and 0.5 * (likely[k] - likely[apart[0]]) < -np.log(ODDS))
        k = apart[0] if between else k
        if not information[k] > 0.0:
            return None
        of_block, taken_up = (np.arange(n) >= k) - share[k], share[k] * a[0] - a[k]
        tried, size = int(np.count_nonzero(information)), float(moved[k] / information[k])
        tested = self._tested(of_block, taken_up, size, float(information[k]), tried)
        moved_by, at_s = a[k] * size, float(times_s[k])
        return tested._replace(moved=moved_by, time_s=at_s, since_s=at_s - float(times_s[0]), between=between)

    def _tested(
        self, of_block: FloatArray, taken_up: FloatArray, size: float, information: float, tried: int
    ) -> GainError:
        """An error ``of_block`` (b,) times its size in each block, with what the parameters take up of it, (p,)."""
        c = np.outer(of_block, self._body) + taken_up
        shares, told = _squares(self._H, c), (c * self._scores).sum(axis=1)
        others = [(_squares(b.H, np.broadcast_to(taken_up, b.scores.shape)), b.scores @ taken_up) for b in self._others]
        shares = np.concatenate([shares, *(one for one, _ in others)])
        told = np.concatenate([told, *(one for _, one in others)])
        left = np.concatenate([self._left, *(b.left for b in self._others)])
        of_noise = np.concatenate([self._of_noise, *(b.of_noise for b in self._others)])
        unexplained = np.maximum(1.0, (left - 2.0 * size * told + size**2 * shares) * of_noise)  # besides the error
        around = (told - shares * size) ** 2  # of each block, scattered by ``shares`` times what is unexplained
        leverage, tells = np.minimum(shares / information, MOST_SHARE), shares > 0.0
        noise, n = float(shares @ unexplained), len(self._times_s)
        scatter = float((around[tells] / (shares * unexplained * (1.0 - leverage))[tells]).mean())
        told_by_all = abs(size) * information
        surely = told_by_all / np.sqrt(max(float((around / (1.0 - leverage) ** 2).sum()), noise))
        freedom = 2.0 * float(shares.sum() ** 2 / (shares @ shares))
        chance = min(1.0, 2.0 * float(stdtr(freedom, -surely)) * tried)
        sigmas = float(told_by_all / np.sqrt(max(1.0, scatter) * noise))
        expected = -float(stdtrit(n - 2, 0.5 * (1.0 - INTERVAL) / tried))
        return GainError(size, chance, sigmas, expected, -taken_up * size)


def _squares(H: FloatArray, c: FloatArray) -> FloatArray:
    """``c' H c`` of each, (b,): matrices (b, p, p), vectors (b, p)."""
    return np.asarray((times(H, c) * c).sum(axis=1), np.float64)
