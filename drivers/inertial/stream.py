"""Numbers the samples of a chip: rows out, lost samples recorded as gaps."""

import numpy as np

from drivers.inertial.sample_clock import SampleClock
from drivers.records import Rows, SampleStatus
from drivers.repeats import Repeats
from drivers.reporter import Reporter

MARKED = 32  # samples with the mark of a sync pulse: from then on their times hang on no arrival


class SampleStream:
    """Numbers samples from the first start on, lost samples included.

    Args:
        name: Channel.
        nominal_period_ns: Sample period as configured.
        repeats: Watches for samples that repeat.
        report: Where rows and gaps go.

    Attributes:
        clock: Total of samples as a function of host time.
        next: Number of the next sample.
        cause: Cause of a possible gap before the next sample; empty while the stream is complete.
        after_reset: The chip restarted: the next row is marked AFTER_RESET.
        marks: Samples of this run with the mark of a sync pulse.
    """

    def __init__(self, name: str, nominal_period_ns: int, repeats: Repeats, report: Reporter) -> None:
        self._name = name
        self._nominal_period_ns = nominal_period_ns
        self._report = report
        self._repeats = repeats
        self.clock = SampleClock(nominal_period_ns)
        self.next = 0
        self.cause = ""
        self.after_reset = False
        self.marks = 0

    def begin(self) -> None:
        """Begin a run; the time since an earlier stop is not a gap."""
        self.clock = SampleClock(self._nominal_period_ns)
        self.after_reset = self.next > 0
        self.marks = 0

    def hand_over(self, rows: Rows, host_ns: int) -> int:
        """Number the rows and pass them on; returns their count."""
        if not len(rows):
            return 0
        rows["sequence"] = rows["tick"] = np.arange(self.next, self.next + len(rows), dtype=np.uint64)
        rows["host_ns"] = host_ns
        if self.after_reset:
            rows["status"][0] |= SampleStatus.AFTER_RESET
            self.after_reset = False
        self._repeats.watch(rows, host_ns)
        self.next += len(rows)
        self.marks += int(np.count_nonzero(rows["sync"]))
        self._report.rows(self._name, rows)
        return len(rows)

    def lose(self, now_ns: int, up_to: int) -> None:
        """Record samples ``next`` to ``up_to`` - 1 as lost and continue from ``up_to``."""
        if up_to > self.next:
            duration_ns = round((up_to - self.next) * self.clock.period_ns())
            self._report.gap(now_ns, self._name, self.next, up_to - 1, duration_ns, self.cause)
            self.next = up_to
        self.cause = ""
