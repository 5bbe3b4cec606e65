"""Segments of a flight that are too long to be predicted, in windows."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from onboard.identification.whole_flight.fit import SHORTEST_TICKS, KINK_s, Segment


def in_windows(segments: Sequence[Segment], period_s: float) -> list[Segment]:
    """The same ticks in segments of ``KINK_s`` or less, each with a rate of its own at its start.

    A base that tumbles while its arm moves is chaotic: what a guess of the payload or the first rate is off by grows
    until the prediction has no more to do with the readings, and no step of a fit leads nearer.

    Args:
        segments: in the order of their times.
        period_s: between ticks.
    """
    size = max(SHORTEST_TICKS, round(KINK_s / period_s))
    found = list[Segment]()
    for one in segments:
        n = len(one.ticks.time_s)
        edges = np.linspace(0, n, max(1, -(-n // size)) + 1).round().astype(int).tolist()
        found += [Segment(one.ticks.part(slice(*ends)), one.held) for ends in pairwise(edges)]
    return found
