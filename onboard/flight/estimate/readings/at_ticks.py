"""Channels at an estimator's ticks: smoothed, or as means over each of them, by the compiled core."""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.readings.history import RecentSamples
from onboard.native import library, structures


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


def tick_means(
    channel: SmoothedChannel, recent: RecentSamples | GateReason, at_ns: NDArray[np.int64], period_ns: int
) -> ChannelAtTicks:
    """Of a channel, as :meth:`SignalSmoother.means`.

    Args:
        channel: as the vehicle file has it.
        recent: its samples, or why there are none.
        at_ns: middles of the ticks.
        period_ns: of a tick.
    """
    n, columns = len(at_ns), len(channel.noise)
    if isinstance(recent, GateReason):
        return nothing(columns, n, 0, recent)
    k, half_s = len(recent.times_s), 0.5e-9 * period_ns
    noise = channel.inflation * np.array(channel.noise)
    samples = structures.SamplesStruct(
        *(k, n, columns, int(GateReason.GAP)),
        *(library.given(recent.times_s, k), (at_ns - at_ns[0]) * 1e-9, library.given(recent.values, k, columns)),
        *(library.given(np.array(channel.delays_s, np.float64), columns), library.given(noise, columns)),
        np.ascontiguousarray(recent.wrong, np.int64),
    )
    out = np.empty(n * (2 * columns + 1))
    library.call("heft_tick_means", ctypes.byref(samples), half_s, half_s / channel.period_s, out=out)
    values, sigma, refused = library.carved(out, [(n, columns), (n, columns), (n,)])
    return ChannelAtTicks((values,), (sigma,), refused.astype(np.int64), of_samples=(np.ones_like(values),))
