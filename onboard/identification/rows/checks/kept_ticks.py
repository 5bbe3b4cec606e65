"""Ticks of rows that are kept, in constant memory, so that rows can be made again about another estimate."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray

MOST_TICKS = 400  # of signals smoothed over 0.2 s, what is independent in 80 s


class SmoothedTicks(NamedTuple):
    """Smoothed signals at t ticks of an arm on a fixed base with j joints, and m rows of each."""

    time_s: FloatArray  # (t,)
    q: FloatArray  # (t, j)
    dq: FloatArray  # (t, j)
    ddq: FloatArray  # (t, j)
    jerk: FloatArray  # (t, j)
    cyclic: FloatArray  # (t, 3, c) functions of the encoders' cyclic errors, and two derivatives
    friction: FloatArray  # (t, motors) Coulomb friction of each over its level
    force: FloatArray  # (t, 3) specific force of the base, m/s^2
    attached: BoolArray  # (t,) whether the payload is held
    measured: FloatArray  # (t, m), 0 where a row was not used
    rate: FloatArray  # (t, m) of what is measured
    weight: FloatArray  # (t, m) one over the variance of each row; 0 where it was not used

    def at(self, which: slice | BoolArray) -> "SmoothedTicks":
        """Some of them."""
        return _of(part[which] for part in self)


def _of(parts: Iterable[NDArray[Any]]) -> SmoothedTicks:
    return SmoothedTicks(*parts)


class KeptTicks:
    """Every n-th of the ticks given, n doubled whenever more than :data:`MOST_TICKS` would be kept.

    Attributes:
        every: n.
        ticks: those kept, if any.
    """

    def __init__(self) -> None:
        self.every, self._given = 1, 0
        self.ticks: SmoothedTicks | None = None

    def add(self, ticks: SmoothedTicks) -> None:
        """Takes further ticks in, later than all before."""
        given = self._given + np.arange(len(ticks.time_s))
        self._given += len(given)
        more = ticks.at(np.asarray(given % self.every == 0))
        if self.ticks is not None:
            more = _of(np.concatenate(pair) for pair in zip(self.ticks, more, strict=True))
        while len(more.time_s) > MOST_TICKS:
            more, self.every = more.at(slice(None, None, 2)), 2 * self.every
        self.ticks = more
