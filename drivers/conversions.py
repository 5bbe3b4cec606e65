"""Numbers the conversions of a chip that has an oscillator and a ready signal, and does not count.

A conversion ended between the look that did not find it and the one that did; how many were missed follows from the
period fitted to these times. Where that number is not sure, the driver marks its row AFTER_RESET: clocks begin anew
there. A sample that a late look found, and that may be this conversion or the next, is dropped.
"""

import numpy as np

from drivers.records import SCALAR, SampleStatus
from drivers.reporter import Reporter

FEWEST, MOST = 16, 1000  # conversions that a period is fitted to; then the fit begins anew, from half of them on
DRIFT_S = 5e-6  # of its oscillator, relative: 0.05 K/s of a chip that warms, at 100 ppm/K
SURE = 0.25  # conversions: error of a count below which the clock goes on


class ConversionCount:
    """Numbers conversions by the times at which they were seen to have ended.

    Args:
        period_ns: Nominal period.
        oscillator: Relative bound of its error, until the period is fitted.

    Attributes:
        number: Of the last conversion seen; -1 before the first.
        ended_ns: About when it ended.
    """

    def __init__(self, period_ns: float, oscillator: float) -> None:
        self.number = -1
        self.ended_ns = 0.0
        self.period_ns = self._nominal_ns = period_ns
        self._error = self._oscillator = oscillator  # relative, of the period
        self._blur_ns = 0.0  # bound of the error of ``ended_ns``: what all looks leave, one after the other
        self._first: tuple[int, float, float] | None = None  # number, end and bound of the first one of the fit
        self._later = (0, 0.0, 0.0)  # from which the next fit begins

    def seen(self, not_before_ns: int, at_ns: int) -> tuple[int, bool] | None:
        """A conversion was found at ``at_ns`` that was not there at ``not_before_ns``.

        Returns:
            How many were missed before it, and whether that is sure; None: it ended at about the time of a late look,
            and may be this one or the one after it.
        """
        width_ns = float(max(at_ns - not_before_ns, 0))
        ended_ns = at_ns - 0.5 * width_ns
        if self.number < 0:
            since = 1
        elif width_ns <= 0.5 * self.period_ns:
            since = max(round((ended_ns - self.ended_ns) / self.period_ns), 1)
        else:  # a late look finds the newest of several: the last that has ended by then
            since = max(self.passed(at_ns), 1)
            phase = (at_ns - self.ended_ns) / self.period_ns - since
            if (
                self._first is not None
                and min(phase, 1.0 - phase) < self._blur_ns / self.period_ns + since * self._error
            ):
                return None
            ended_ns = self.ended_ns + since * self.period_ns
        sure = self.number < 0 or since * self._error < SURE
        if width_ns <= 0.5 * self.period_ns:
            ended_ns, self._blur_ns = self._narrowed(ended_ns, 0.5 * width_ns, since)
        else:
            self._blur_ns += since * self._error * self.period_ns
        self.number, self.ended_ns = self.number + since, ended_ns
        if self._first is None or not sure:
            self._first = self._later = self.number, ended_ns, self._blur_ns
        counted = self.number - self._first[0]
        if counted >= FEWEST:
            spanned_ns = ended_ns - self._first[1]
            if abs(spanned_ns / counted / self._nominal_ns - 1.0) < 2.0 * self._oscillator:
                self.period_ns = spanned_ns / counted
                wide_ns = self._first[2] + self._blur_ns
                self._error = min(self._oscillator, wide_ns / spanned_ns + 1e-9 * DRIFT_S * spanned_ns)
        if self.number - self._later[0] >= MOST // 2:
            self._first, self._later = self._later, (self.number, ended_ns, self._blur_ns)
        return (0 if self.number == 0 else since - 1), sure

    def _narrowed(self, ended_ns: float, blur_ns: float, since: int) -> tuple[float, float]:
        """When it ended and the bound of that, by its own look and by those before it, where these agree."""
        if self._first is None:
            return ended_ns, blur_ns
        expected_ns = self.ended_ns + since * self.period_ns
        wide_ns = self._blur_ns + since * self._error * self.period_ns
        first_ns = max(ended_ns - blur_ns, expected_ns - wide_ns)
        last_ns = min(ended_ns + blur_ns, expected_ns + wide_ns)
        return (ended_ns, blur_ns) if first_ns > last_ns else (0.5 * (first_ns + last_ns), 0.5 * (last_ns - first_ns))

    def is_early(self, now_ns: int) -> bool:
        """Whether none can have ended since the last one seen."""
        earliest_ns = self.ended_ns - 2.0 * self._blur_ns + (1.0 - self._error) * self.period_ns
        return self._first is not None and now_ns < earliest_ns

    def passed(self, now_ns: int) -> int:
        """Conversions that have ended since the last one seen."""
        return int((now_ns - self.ended_ns) // self.period_ns)

    def anew(self) -> None:
        """The chip began anew: the phase of its conversions is another."""
        self._first = None


class ConvertedForce(ConversionCount):
    """Conversions as SCALAR rows in N, numbered, with the gaps before them.

    Args:
        report: Takes the rows, on the channel of its source.
        scale: N per count.
        period_ns: Nominal period.
        oscillator: Relative bound of its error, until the period is fitted.
    """

    def __init__(self, report: Reporter, scale: float, period_ns: float, oscillator: float) -> None:
        super().__init__(period_ns, oscillator)
        self._report, self._scale = report, scale
        self._after_reset = False

    def anew(self) -> None:
        """See ``ConversionCount``; the next row is marked AFTER_RESET."""
        self._after_reset = self.number >= 0
        super().anew()

    def hand_over(self, not_before_ns: int, host_ns: int, counts: int, status: int, cause: str) -> str:
        """Record a reading found at ``host_ns`` that was not there at ``not_before_ns``.

        Args:
            not_before_ns: Last look that did not find it.
            host_ns: Look that found it.
            counts: Of the converter.
            status: ``SampleStatus``.
            cause: Why conversions before it are missing; "": not known.

        Returns:
            The cause of what is missing from now on: "" when this was recorded.
        """
        following = self.number + 1
        seen = self.seen(not_before_ns, host_ns)
        if seen is None:
            return cause or "missed"
        missed, sure = seen
        if missed:
            duration_ns = round(missed * self.period_ns)
            self._report.gap(host_ns, self._report.source, following, self.number - 1, duration_ns, cause or "missed")
        if self._after_reset or not sure:
            status |= SampleStatus.AFTER_RESET
            self._after_reset = False
        row = np.zeros(1, SCALAR)
        row[0] = (self.number, host_ns, self.number, counts, self._scale, b"N", 0, 0, status)
        self._report.rows(self._report.source, row)
        return ""

    def finish(self, now_ns: int, cause: str) -> None:
        """Record what is missing at the end because of ``cause``."""
        missed = self.passed(now_ns) if cause and self.number >= 0 else 0
        if missed > 0:
            duration_ns = round(missed * self.period_ns)
            self._report.gap(now_ns, self._report.source, self.number + 1, self.number + missed, duration_ns, cause)
            self.number += missed
            self.ended_ns += duration_ns

    def next_look_ns(self, now_ns: int, poll_ns: int, within_ns: int) -> int:
        """Wait until shortly before the next conversion ends, but ``within_ns`` at the most: no look is ever late."""
        until_ns = self.ended_ns + self.period_ns - now_ns - 1.5 * poll_ns
        return max(int(min(until_ns, within_ns) // poll_ns), 1) * poll_ns
