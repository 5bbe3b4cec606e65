"""Which rows an estimator that cannot keep up leaves out: late by more than 8 s, all until 1 s before the present.

Rows are left out in one piece, so that the others are contiguous: a change is classified from windows of 1 to 4 s
without a gap. Late rows are as good as recent ones, since the payload is constant.

Phases, pulses and other channels that come no more often than the estimator steps are never left out. A pause of the
estimator after which it catches up costs no row. The answers rest on fewer rows, and their intervals are wider
accordingly. Each TICK record says how much was left out before it, so that a replay does the same; the log has the
rows.
"""

SKIP_NS, LATE_NS = 8_000_000_000, 1_000_000_000  # the rings hold 12 s; that is reported, and left where rows are


def to_skip_ns(behind_ns: int) -> int:
    """How much of the oldest rows to leave out; ``behind_ns``: from the last row that has been consumed to now."""
    return behind_ns - LATE_NS if behind_ns > SKIP_NS else 0
