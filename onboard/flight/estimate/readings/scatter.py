"""Measures the noise of the encoders' samples, by their scatter about the smoothed angles.

What noise does to an estimate is taken out in proportion to its power (:mod:`onboard.regressor.signals`). A file often
states more than there is: where 5e-5 rad were stated of an encoder without any, a payload was moved by ten sigmas. And
messages that wait for others on their bus are late by a time that varies: while the joint turns, that is noise.

The cyclic errors of a gear scatter, too. They have a noise of their own (:mod:`.cyclic`): an encoder with such has no
more noise than is stated. Of free-flyers only: to rows, what is not of samples is an error that lasts.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import READING, sigmas
from onboard.estimation.smoothing import SmoothingWindow


class SampleScatter:
    """Of all encoders of a vehicle.

    Args:
        cyclic: by the names of their channels, whether each has cyclic errors.
    """

    def __init__(self, cyclic: Mapping[str, bool]) -> None:
        self._most = {name: 1.0 if own else np.inf for name, own in cyclic.items()}
        self._squares = dict.fromkeys(cyclic, 1.0)  # over what is stated; what is stated counts as one sample
        self._count = dict.fromkeys(cyclic, 1)

    def take(self, names: Sequence[str], window: SmoothingWindow, values: FloatArray, noise: FloatArray) -> None:
        """Take in the samples of one window.

        Args:
            names: of channels of one column each; those that are no encoders are left out.
            window: of the samples.
            values: theirs, (k, c).
            noise: stated, of a sample, (c,).
        """
        off = window.residuals(values) / noise
        squares = np.minimum(off[np.isfinite(off[:, 0])] ** 2, sigmas(READING) ** 2)
        for name, own in zip(names, squares.T, strict=True):
            if name in self._squares:
                self._squares[name] += float(own.sum())
                self._count[name] += len(own)

    def power(self, names: Sequence[str]) -> FloatArray:
        """Of the noise of channels, over what is stated, (c,)."""
        own = {name: min(squares / self._count[name], self._most[name]) for name, squares in self._squares.items()}
        return np.array([own.get(name, 1.0) for name in names])
