"""Blocks of time whose errors repeat, because the motion does: they are one block of the jackknife.

What a model leaves (friction, gears, a flexible joint) is a function of the motion. A motion that is repeated, as a
period of a Fourier series is, leaves the same again: the repetitions are no independent witnesses of that error, and
the scatter of blocks, each of which has its like among those kept, shows neither its size nor its leverage.

The scores of two blocks, in units of the formal covariance, have a cosine. Of blocks that have nothing in common its
sign is random and its mean square v that of all pairs; the sum over the n pairs of one lag is then normal with the
variance n v. The shortest lag where it is larger than chance makes of so many is the period; blocks of one phase are
added up. Where errors are noise, nothing repeats, and repetitions do count.
"""

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.policy import DOUBT, of_each, sigmas

_FEWEST = 3  # blocks in a period: neighbours are alike for other reasons, and two phases have no scatter


def phases(numbers: FloatArray, scores: FloatArray) -> IndexArray:
    """Group of each block, (b,): one a block, or one a phase of each recording.

    Recordings are as far apart as all blocks together are long, or farther.

    Args:
        numbers: of the blocks in time, whole, (b,).
        scores: of the blocks at the estimate, in units in which the formal covariance is the identity, (b, p).
    """
    alone, length = np.arange(len(numbers)), np.linalg.norm(scores, axis=1)
    if len(numbers) < 2 * _FEWEST or not length.all():
        return alone
    order = np.argsort(numbers)
    begins = np.append(True, np.diff(numbers[order]) > len(numbers))
    recording = np.empty_like(alone)
    recording[order] = np.cumsum(begins) - 1
    since = numbers - numbers[order][begins][recording]
    one, other = np.triu_indices(len(numbers), 1)
    one, other = np.array([one, other])[:, recording[one] == recording[other]]
    cosine = np.einsum("ip,ip->i", scores[one], scores[other]) / (length[one] * length[other])
    lag = np.rint(np.abs(since[one] - since[other])).astype(np.intp)
    pairs = np.maximum(np.bincount(lag, minlength=_FEWEST + 1), 1)
    total = np.bincount(lag, cosine, len(pairs))
    away = total / np.sqrt(pairs * np.mean(cosine**2))
    away[:_FEWEST] = 0.0
    looks = len(np.unique(lag[lag >= _FEWEST]))
    beyond = away > sigmas(of_each(DOUBT, looks))
    if not beyond.any():
        return alone
    period = int(beyond.argmax())
    period += int(away[period : period + 2].argmax())
    around = np.arange(period - 1, min(period + 2, len(pairs)))
    period_blocks = float(np.average(around, weights=np.maximum((total / pairs)[around], 0.0)))
    phase = np.rint(since % period_blocks * period / period_blocks).astype(np.intp) % period
    return np.asarray(np.unique(recording * period + phase, return_inverse=True)[1], np.intp)


def added_up(group: IndexArray, parts: FloatArray) -> FloatArray:
    """Sums of the blocks of each group, (g, ...), of (b, ...)."""
    made = np.zeros((int(group.max(initial=-1)) + 1, *parts.shape[1:]))
    np.add.at(made, group, parts)
    return made
