"""Recursive digital filters: their design and their application, one sample after another.

They do what the functions of ``scipy.signal`` of the same names do, without the second of CPU time that its import
takes of every start. What comes out does not depend on where the samples are cut into batches.
Sources: Oppenheim and Schafer, Discrete-Time Signal Processing (bilinear transform, direct form II transposed);
Orfanidis, Introduction to Signal Processing (11.3.7 and 11.3.21, the peak filter).
"""

import cmath
import math
from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from scipy.linalg.blas import dtbsv

from hil_sim.arrays import FloatArray

_BLOCK = 64  # samples

Section = tuple[FloatArray, FloatArray]  # numerator and denominator, (3,) each, powers of 1/z


def bilinear(b: Sequence[float], a: Sequence[float], rate_Hz: float) -> Section:
    """Second-order section of ``b(s) / a(s)``, highest power first; s = 2 rate (z - 1) / (z + 1).

    Args:
        b: at most three numbers.
        a: three numbers.
        rate_Hz: of the samples.
    """
    k = 2.0 * rate_Hz
    (b2, b1, b0), (a2, a1, a0) = ([0.0] * (3 - len(b)) + list(b)), a
    top = np.array([b2 * k * k + b1 * k + b0, 2.0 * (b0 - b2 * k * k), b2 * k * k - b1 * k + b0])
    bottom = np.array([a2 * k * k + a1 * k + a0, 2.0 * (a0 - a2 * k * k), a2 * k * k - a1 * k + a0])
    return top / bottom[0], bottom / bottom[0]


def peak(frequency_Hz: float, quality: float, rate_Hz: float) -> Section:
    """Passes one frequency with gain 1, and half of the power at ``frequency / quality`` about it."""
    w = 2.0 * math.pi * frequency_Hz / rate_Hz
    gain = 1.0 / (1.0 + math.tan(0.5 * w / quality))
    return (1.0 - gain) * np.array([1.0, 0.0, -1.0]), np.array([1.0, -2.0 * gain * math.cos(w), 2.0 * gain - 1.0])


def band_pass(band_Hz: tuple[float, float], rate_Hz: float) -> tuple[Section, Section]:
    """Butterworth band-pass of order 2 on either side: half of the power at both ends of the band, 1 in the middle."""
    low, high = (2.0 * rate_Hz * math.tan(math.pi * edge / rate_Hz) for edge in band_Hz)  # rad/s, warped
    width, middle = high - low, math.sqrt(low * high)
    shifted = 0.5 * width * cmath.exp(0.75j * math.pi)  # the prototype's pole in the upper half plane
    root = cmath.sqrt(shifted * shifted - middle * middle)
    first, second = (
        bilinear([width, 0.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rate_Hz)
        for pole in (shifted + root, shifted - root)
    )
    return first, second


def settled(section: Section) -> FloatArray:
    """State of a section that has read ones for ever, (4,)."""
    (b0, b1, b2), (_, a1, a2) = section
    recursed = (b0 + b1 + b2) / (1.0 + a1 + a2) - b0
    return np.array([1.0, 1.0, recursed, recursed])


def filtered(section: Section, samples: FloatArray, state: FloatArray) -> FloatArray:
    """A section's output for samples (n, k); ``state``, (4, k), goes on to the next of them.

    The output is b0 times the sample plus what the samples before leave, a recursion solved as a band matrix.
    The state is the last two samples and the last two of what they leave.
    """
    (b0, b1, b2), (_, a1, a2) = section
    read = np.concatenate([state[:2], samples])
    band = np.empty((3, len(read)), order="F")
    band[:] = [[1.0], [a1], [a2]]
    band[1, 0] = 0.0  # the first two are as they were
    left = np.concatenate([state[2:], (b1 - a1 * b0) * read[1:-1] + (b2 - a2 * b0) * read[:-2]])
    for column in left.T:
        column[:] = dtbsv(2, band, column, lower=1, diag=1)
    state[:2], state[2:] = read[-2:], left[-2:]
    out: FloatArray = left[2:] + b0 * samples
    return out


class Passing:
    """Sections in a row, at rest before the first sample; by blocks, as matrices.

    Args:
        sections: that the samples pass one after the other.
        columns: of the samples.
    """

    def __init__(self, sections: Sequence[Section], columns: int) -> None:
        self._made = []  # by each sample of a block, and by the state before; the state after it by the same
        for section in sections:
            state = np.hstack([np.zeros((4, _BLOCK)), np.eye(4)])
            self._made.append((filtered(section, np.eye(_BLOCK, _BLOCK + 4), state), state))
        self._states = [np.zeros((4, columns)) for _ in sections]

    def take(self, samples: FloatArray) -> FloatArray:
        """Output for the next samples, (n, columns); n is whole blocks of 64, but of the last."""
        n, columns = samples.shape
        rest = np.zeros((-n % _BLOCK, columns))
        for k, (made, state) in enumerate(self._made):
            blocks = np.concatenate([samples, rest]).reshape(-1, _BLOCK, columns)
            after = state[:, :_BLOCK] @ blocks
            before = np.zeros((len(blocks) + 1, 4, columns))
            before[0] = self._states[k]
            for block in range(len(blocks)):
                before[block + 1] = state[:, _BLOCK:] @ before[block] + after[block]
            self._states[k] = before[-1]
            samples = (made[:, :_BLOCK] @ blocks + made[:, _BLOCK:] @ before[:-1]).reshape(-1, columns)[:n]
        return samples


def passed(sections: Sequence[Section], samples: FloatArray) -> FloatArray:
    """Output of sections in a row for all samples at once, (n, k), at rest before the first."""
    return Passing(sections, samples.shape[1]).take(samples)


def rms_gain(sections: Sequence[Section], samples: int) -> float:
    """Rms of the output for white noise of rms 1: the norm of the impulse response, so many samples of it."""
    impulse = np.zeros((samples, 1))
    impulse[0] = 1.0
    return float(np.linalg.norm(passed(sections, impulse)))


def remembered(memory: float, steps: FloatArray, last: FloatArray) -> FloatArray:
    """First-order recursion ``y = memory x the last y + step``, (n, k), from the last (k,)."""
    columns = [
        list(accumulate(column, lambda before, step: step + memory * before, initial=start))[1:]
        for column, start in zip(steps.T.tolist(), last.tolist(), strict=True)
    ]
    return np.array(columns).T.reshape(steps.shape)
