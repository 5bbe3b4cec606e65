"""The recording worker: rings to log, a step at a time.

The rings are its buffer. While the disk refuses, nothing is drained, so nothing is lost until a ring overruns; what a
ring has overrun is told by ``GAP`` rows as soon as writing works again. Acquisition notices none of it.

The recorder speaks on two channels of its own, so that its sequence numbers meet nobody else's.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity
from onboard.recording.writer import LogWriter

GAP_CHANNEL = "recorder_gap"
EVENT_CHANNEL = "recorder_event"
OVERRUN = "ring_overrun"
_SOURCE = "recorder"


class Ring(Protocol):
    """What the recorder needs of a reading end of a ring."""

    name: str
    dtype: np.dtype[np.void]

    def read(self, limit: int | None = None) -> tuple[Rows, int]:
        """Rows not read yet, oldest first, and how many were lost since the last call."""


class StepReport(NamedTuple):
    """What a step did: rows accepted, rows that the rings had overrun, and whether the disk refuses."""

    rows: int
    lost: int
    failing: bool


class _Last(NamedTuple):
    """The newest row of a channel that was recorded."""

    sequence: int
    host_ns: int


class Recorder:
    """Drains rings into a log. No method raises for a disk error: it becomes an event and ``StepReport.failing``.

    Args:
        writer: the log; it stays the caller's to attach configuration to.
        rings: drained in this order, each into the channel of its own name.
        units: channel to field to unit, for the definitions in the log.

    Raises:
        SchemaError: the record of a ring cannot be written as a ROS 2 message.
        ChannelError: two rings of one name differ in their record.
    """

    def __init__(
        self, writer: LogWriter, rings: Iterable[Ring], *, units: Mapping[str, Mapping[str, str]] | None = None
    ) -> None:
        self._writer, self._rings = writer, tuple(rings)
        self._last: dict[str, _Last] = {}
        self._unplaced: dict[str, int] = {}  # lost rows of channels that have not delivered a row since
        self._sequence = {GAP_CHANNEL: 0, EVENT_CHANNEL: 0}
        self._failing_since_ns: int | None = None
        for ring in self._rings:
            writer.register(ring.name, ring.dtype, units=(units or {}).get(ring.name))
        writer.register(GAP_CHANNEL, records.GAP)
        writer.register(EVENT_CHANNEL, records.EVENT)

    def step(self, now_ns: int) -> StepReport:
        """Record what the rings hold."""
        if self._writer.failing:
            self._sync(now_ns)
        report = self._drain(now_ns)
        if not self._writer.failing:
            self._sync(now_ns)
        return report._replace(failing=self._writer.failing)

    def close(self, now_ns: int) -> StepReport:
        """Record what the rings still hold and close the log.

        Returns:
            ``failing`` when the disk refused: call it again, or ``abandon`` the writer.
        """
        report = StepReport(0, 0, False) if self._writer.ended else self.step(now_ns)
        try:
            self._writer.close()
        except OSError:
            return report._replace(failing=True)
        return report._replace(failing=False)

    def _drain(self, now_ns: int) -> StepReport:
        taken = lost = 0
        for ring in self._rings:
            if self._writer.failing:
                break
            rows, missed = ring.read()
            lost += missed
            if missed := missed + self._unplaced.pop(ring.name, 0):
                self._tell_overrun(now_ns, ring.name, rows, missed)
            if len(rows):
                self._write(now_ns, ring.name, rows)
                self._last[ring.name] = _Last(int(rows["sequence"][-1]), int(rows["host_ns"][-1]))
                taken += len(rows)
        return StepReport(taken, lost, self._writer.failing)

    def _tell_overrun(self, now_ns: int, channel: str, rows: Rows, missed: int) -> None:
        """GAP rows for ``missed`` rows: they lie before ``rows`` or among them, where the sequence numbers jump."""
        if not len(rows):
            self._unplaced[channel] = missed
            return
        sequence = rows["sequence"].astype(np.int64)
        host_ns = rows["host_ns"]
        last = self._last.get(channel, _Last(-1, int(host_ns[0])))
        before = np.concatenate([[last.sequence], sequence[:-1]])
        before_ns = np.concatenate([[last.host_ns], host_ns[:-1]])
        for jump in np.flatnonzero(sequence - before > 1):
            first, end = int(before[jump]) + 1, int(sequence[jump])
            duration_ns = int(host_ns[jump] - before_ns[jump])
            self._own(GAP_CHANNEL, records.gap(now_ns, channel, first, end - 1, duration_ns, OVERRUN))
            missed -= end - first
            if missed <= 0:  # further jumps are losses that the device's own worker has told
                return
        if missed > 0:
            text = f"{channel}: {missed} rows were lost that its sequence numbers do not show"
            self._tell(now_ns, Severity.ERROR, OVERRUN, text)

    def _tell(self, now_ns: int, severity: Severity, code: str, text: str) -> None:
        self._own(EVENT_CHANNEL, records.event(now_ns, severity, code, _SOURCE, text))

    def _own(self, channel: str, batch: Batch) -> None:
        """Write a row on a channel of our own."""
        batch.rows["sequence"] = self._sequence[channel]
        self._sequence[channel] += 1
        self._write(int(batch.rows["host_ns"][0]), channel, batch.rows)

    def _write(self, now_ns: int, channel: str, rows: Rows) -> None:
        try:
            self._writer.write(channel, rows)
        except OSError as error:
            self._refused(now_ns, error)

    def _sync(self, now_ns: int) -> None:
        try:
            self._writer.sync(now_ns)
        except OSError as error:
            self._refused(now_ns, error)
        if self._failing_since_ns is not None and not self._writer.failing:
            since_ns, self._failing_since_ns = self._failing_since_ns, None
            text = f"the disk takes the log again after {(now_ns - since_ns) * 1e-9:.3f} s"
            self._tell(now_ns, Severity.INFO, "disk_resumed", text)

    def _refused(self, now_ns: int, error: OSError) -> None:
        if self._failing_since_ns is None:
            self._failing_since_ns = now_ns
            text = f"the disk refused the log: {error.strerror or error}; the rings hold what comes meanwhile"
            self._tell(now_ns, Severity.ERROR, "disk_error", text)
