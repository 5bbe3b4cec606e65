"""Collects a device's batches between two calls: rows, gaps, and rate-limited events."""

from drivers.records import Batch, Rows, Severity, event, gap

REPEAT_NS = 1_000_000_000
BACKOFF_NS, LONGEST_BACKOFF_NS = 20_000_000, 1_000_000_000


class Reporter:
    """Queue of batches, in order.

    The same event (code and source) is emitted at most once per ``REPEAT_NS``; suppressed ones are counted in the next
    one or in ``flush``.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self._batches: list[Batch] = []
        self._told_ns: dict[tuple[str, str], int] = {}
        self._held: dict[tuple[str, str], int] = {}

    def event(self, now_ns: int, severity: Severity, code: str, text: str, source: str | None = None) -> None:
        """Emit an event, or count it if the same one was emitted less than ``REPEAT_NS`` ago.

        Args:
            now_ns: CLOCK_MONOTONIC, ns.
            severity: Severity.
            code: Short name of the kind of event, up to 31 ASCII characters.
            text: A sentence with the remedy; cut at 160 bytes.
            source: Name of the device; None: the reporter's own.
        """
        source = self.source if source is None else source
        key = (code, source)
        told_ns = self._told_ns.get(key)
        if told_ns is not None and now_ns - told_ns < REPEAT_NS:
            self._held[key] = self._held.get(key, 0) + 1
            return
        held = self._held.pop(key, 0)
        self._told_ns[key] = now_ns
        if held:
            text = f"(+{held} before) {text}"
        self._batches.append(event(now_ns, severity, code, source, text))

    def gap(
        self,
        now_ns: int,
        channel: str,
        first_missing: int,
        last_missing: int,
        duration_ns: int,
        cause: str,
        *,
        counted: bool = False,
    ) -> None:
        """Record samples ``first_missing..last_missing`` of ``channel`` as lost. Gaps are never suppressed.

        ``counted`` as of ``drivers.records.gap``.
        """
        self._batches.append(gap(now_ns, channel, first_missing, last_missing, duration_ns, cause, counted=counted))

    def rows(self, channel: str, rows: Rows) -> None:
        """Add rows; an empty array is ignored."""
        if len(rows):
            self._batches.append(Batch(channel, rows))

    def flush(self, now_ns: int) -> None:
        """Emit the counts of suppressed events."""
        for (code, source), held in self._held.items():
            text = f"{held} more of this event since it was last reported"
            self._batches.append(event(now_ns, Severity.INFO, code, source, text))
        self._held.clear()

    def take(self) -> list[Batch]:
        """All batches since the last call."""
        batches, self._batches = self._batches, []
        return batches


class Absence:
    """A device that does not answer: why is reported once, and when it answers again; it is tried ever less often."""

    def __init__(self, report: Reporter) -> None:
        self._report = report
        self.forget()

    def forget(self) -> None:
        """It is not away, and nothing was reported."""
        self._since_ns: int | None = None
        self._told, self._backoff_ns = "", BACKOFF_NS

    def begin(self, now_ns: int, code: str, text: str, kind: str = "") -> int:
        """It is away, or still so; CLOCK_MONOTONIC ns of the next attempt, after a back-off that doubles up to 1 s.

        ``kind``: reasons of one kind are reported once; without it, reasons of one text.
        """
        if (kind or text) != self._told:
            self._report.event(now_ns, Severity.ERROR, code, text)
            self._told = kind or text
        if self._since_ns is None:
            self._since_ns = now_ns
        next_ns = now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, LONGEST_BACKOFF_NS)
        return next_ns

    def end(self, now_ns: int) -> bool:
        """It answers; whether it was away."""
        since_ns = self._since_ns
        self.forget()
        if since_ns is not None:
            text = f"answers again after {(now_ns - since_ns) // 1_000_000} ms"
            self._report.event(now_ns, Severity.INFO, "bus_recovered", text)
        return since_ns is not None
