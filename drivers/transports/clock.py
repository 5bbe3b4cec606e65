"""Offset between CLOCK_REALTIME (stamps of the kernel) and CLOCK_MONOTONIC (all other times)."""

import time
from collections.abc import Callable

GOOD_BRACKET_NS = 20_000
TRIES = 4


def realtime_minus_monotonic(
    clock: Callable[[], int], realtime: Callable[[], int] = time.time_ns, tries: int = TRIES
) -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC, ns, from a reading of one between two readings of the other.

    Preemption can only widen the bracket, so the narrowest of up to ``tries`` brackets is taken; its half width bounds
    the error. It is measured at every receive, so that a step of the wall clock affects only stamps in flight.

    Args:
        clock: CLOCK_MONOTONIC, ns.
        realtime: CLOCK_REALTIME, ns.
        tries: Brackets to try until one is narrower than ``GOOD_BRACKET_NS``.
    """
    best_width, best = 1 << 62, 0
    for _ in range(tries):
        before = clock()
        wall = realtime()
        after = clock()
        if after - before < best_width:
            best_width, best = after - before, wall - (before + after) // 2
        if best_width < GOOD_BRACKET_NS:
            break
    return best
