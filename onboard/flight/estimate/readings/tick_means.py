"""Means of a channel over ticks, by the compiled core."""

import ctypes

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import SmoothedChannel
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks, nothing
from onboard.flight.estimate.readings.history import RecentSamples
from onboard.native import library, structures


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
