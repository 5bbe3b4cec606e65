"""Offset between CLOCK_REALTIME (stamps of the kernel) and CLOCK_MONOTONIC (all others), and a wait."""

import time
from collections.abc import Callable

GOOD_BRACKET_NS = 20_000
TRIES = 4  # brackets, until one is narrower than GOOD_BRACKET_NS
SPIN_NS = 150_000  # the end of a wait is a busy loop on the clock: a kernel wake-up takes 50 us or more


def wait_until(
    instant_ns: int, clock: Callable[[], int], sleep: Callable[[float], object] = time.sleep, spin_ns: int = SPIN_NS
) -> None:
    """Return at ``instant_ns``, or at once when that has passed; the delay is not returned."""
    left_ns = instant_ns - clock()
    if left_ns > spin_ns:
        sleep((left_ns - spin_ns) * 1e-9)
    while clock() < instant_ns:
        pass


def realtime_minus_monotonic(clock: Callable[[], int], realtime: Callable[[], int] = time.time_ns) -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC, ns, from a reading of one between two readings of the other.

    Preemption can only widen the bracket, so the narrowest of up to :data:`TRIES` brackets is taken; its half width
    bounds the error. It is measured at every receive: a step of the wall clock affects only stamps in flight.

    Args:
        clock: CLOCK_MONOTONIC, ns.
        realtime: CLOCK_REALTIME, ns.
    """
    best_width, best = 1 << 62, 0
    for _ in range(TRIES):
        before = clock()
        wall = realtime()
        after = clock()
        if after - before < best_width:
            best_width, best = after - before, wall - (before + after) // 2
        if best_width < GOOD_BRACKET_NS:
            break
    return best
