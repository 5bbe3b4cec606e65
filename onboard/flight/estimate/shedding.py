"""Which rows an estimator that cannot keep up leaves out: it thins them, then skips the oldest.

- Late by more than 2 s, and no less than 2 s before: after each step of 0.5 s it leaves out the next 0.5 s, until it is
  late by less than 1 s.
- Late by more than 4 s while it thins, or by more than 8 s in any case (the rings hold 12 s): it goes on 1 s before the
  present.

Phases, pulses and other channels of few rows are never left out. A pause that it works off by itself costs no row. The
answers hold rows of less time, and are as much wider. Each TICK record says how much was left out before it, so that a
replay does the same; the log has the rows.
"""

LATE_NS = 2_000_000_000
LOOK_NS = 2_000_000_000  # between two looks at whether it is catching up
THIN_NS = 500_000_000
SKIP_THINNED_NS, SKIP_NS, LEFT_NS = 4_000_000_000, 8_000_000_000, 1_000_000_000
KEPT_HZ = 20.0  # channels that come no more often lose no row


class Shedding:
    """Decides what one estimator leaves out.

    Attributes:
        thins: it cannot keep up, and leaves out every other half second.
    """

    def __init__(self) -> None:
        self.thins = False
        self._looked_ns: int | None = None
        self._was_behind_ns = 0

    def next_ns(self, now_ns: int, behind_ns: int) -> int:
        """How much of the oldest rows to leave out before the step at ``now_ns``.

        Args:
            now_ns: time of the step.
            behind_ns: from the last row that has been consumed to now.
        """
        if behind_ns > SKIP_NS or (self.thins and behind_ns > SKIP_THINNED_NS):
            self.thins = True
            return behind_ns - LEFT_NS
        if behind_ns <= LATE_NS:
            self._looked_ns = None
            self.thins &= behind_ns > LEFT_NS
        elif self._looked_ns is None:
            self._looked_ns, self._was_behind_ns = now_ns, behind_ns
        elif now_ns - self._looked_ns >= LOOK_NS:
            self.thins |= behind_ns >= self._was_behind_ns
            self._looked_ns, self._was_behind_ns = now_ns, behind_ns
        return THIN_NS if self.thins else 0
