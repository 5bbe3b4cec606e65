"""Smoothed channels at an estimator's ticks."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason


class ChannelAtTicks(NamedTuple):
    """A channel at n ticks."""

    derivatives: tuple[FloatArray, ...]  # each (n, columns): the signal, its rate of change, ...
    sigma: tuple[FloatArray, ...]  # each (n, columns): noise of the above
    refused: NDArray[np.int64]  # (n,) GateReason
    cyclic: FloatArray | None = None  # (n, derivatives, 2 x errors) smoothed cosine and sine of each cyclic error
    of_samples: tuple[FloatArray, ...] = ()  # each (n, columns): share of the noise's variance by independent samples


def nothing(columns: int, ticks: int, derivatives: int, reason: GateReason) -> ChannelAtTicks:
    """Ticks that are all refused for a reason."""
    none = (np.full((ticks, columns), np.nan),) * (derivatives + 1)
    return ChannelAtTicks(none, none, np.full(ticks, int(reason)), of_samples=none)


def side_by_side(parts: Sequence[ChannelAtTicks]) -> ChannelAtTicks:
    """Channels at the same ticks as one; a tick that one refuses is refused."""
    if len(parts) == 1:
        return parts[0]
    values, sigma, of_samples = (
        tuple(np.hstack(columns) for columns in zip(*sides, strict=True))
        for sides in zip(*((part.derivatives, part.sigma, part.of_samples) for part in parts), strict=True)
    )
    refused = np.bitwise_or.reduce([part.refused for part in parts])
    return ChannelAtTicks(values, sigma, refused, of_samples=of_samples)
