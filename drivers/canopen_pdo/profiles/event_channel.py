"""TPDOs sent on change: one row each; losses are found by reading the value back over SDO.

A change alone does not show that an earlier one was lost. The value is therefore read back by SDO soon after each
change (a second row that confirms the first) and every ``CHECK_NS`` (a row only if the value is new). Where the TPDO
also carries a change counter, losses are counted by it and the check reads the counter only; without a counter, a value
that differs from the last one recorded counts as one loss. A TPDO whose counter does not continue the last one is
NOT_VALID; the next TPDO that agrees with it, or the value read back, decides between the two.
"""

from drivers.canopen_pdo.profiles.channel import PdoChannel, Sample
from drivers.canopen_pdo.profiles.mapped_object import MappedObject, Reading
from drivers.canopen_pdo.sdo import Setup
from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import CHANGES_UNHEARD, SampleStatus, Severity
from drivers.reporter import Reporter

CHECK_NS = 500_000_000
OUTAGE_NS = 600_000_000  # without a TPDO and since an answered check was begun: changes may have been missed
QUIET_NS = 20_000_000  # after a TPDO, before it is read back; a further TPDO restarts the wait


class EventChannel(PdoChannel):
    """One row for each TPDO, and for each value read back. ``tick`` is the SYNC number current when it arrived.

    Args:
        data: The object.
        report: Where rows, gaps and events go.
        sync: Numbers the SYNCs of this bus.
    """

    def __init__(self, data: MappedObject, report: Reporter, sync: SyncCounter) -> None:
        super().__init__(data, report, sync)
        self._object = data
        self._value: int | None = None  # of the last accepted row
        self._counter: int | None = None  # the same
        self._rejected: list[int] = []  # counters of the TPDOs rejected since
        self._unconfirmed = False  # the last accepted row changed the value
        self._row_ns = 0
        self._heard_ns = 0  # of the last TPDO
        self._checked_ns = 0
        self._confirmed_ns = 0  # of the last TPDO, or answer to a check
        self._cut = False  # the node was cut off since: it may have sent what did not arrive
        self._is_heard = False  # since it was started: a node may send one as it enters Operational

    def go_live(self) -> None:
        """The node has been started: the value read during set-up becomes the first row."""
        super().go_live()
        self._is_heard = False
        reading = self._object.initial
        if reading is not None:
            self._read(reading)

    def node_rebooted(self) -> None:
        """See ``PdoChannel``. The change counter may have restarted."""
        super().node_rebooted()
        self._counter = self._value = None

    def accept(self, host_ns: int, data: bytes) -> None:
        """See ``PdoChannel``."""
        sample = self._decoded(host_ns, data) if self.live else None
        if sample is None:
            return
        self._heard_ns = self._confirmed_ns = host_ns
        self._is_heard = True
        counter = self._object.counter(data)
        if counter is None or self._counter is None or self._object.steps(self._counter, counter) <= 1:
            is_change = counter is None or (self._counter is not None and counter != self._counter)
            if self._cut and is_change:  # sent again as the node was started, after a change that was not heard
                self._lose(host_ns, 1)
            self._accept(host_ns, sample, counter)
        elif self._rejected and self._object.steps(self._rejected[-1], counter) <= 1:
            missed = self._object.steps(self._counter, counter) - len(self._rejected) - 1
            self._lose(host_ns, missed, counted=True)
            self._accept(host_ns, sample, counter)
        else:
            self._rejected.append(counter)
            self._put(host_ns, sample, SampleStatus.NOT_VALID)

    def node_reset(self) -> None:
        """See ``PdoChannel``. The value may have changed and changed back."""
        super().node_reset()
        self._cut = self.started

    def suspect(self, host_ns: int, *, bus: bool) -> None:
        """See ``PdoChannel``."""
        self._cut |= bus and self.started
        self._checked_ns = min(self._checked_ns, host_ns - CHECK_NS)

    def check_ns(self) -> int | None:
        """See ``PdoChannel``."""
        if not (self.live and self._object.is_readable):
            return None
        quiet_ns = self._heard_ns + QUIET_NS
        return quiet_ns if self._unconfirmed or self._rejected else max(quiet_ns, self._checked_ns + CHECK_NS)

    def check(self, now_ns: int) -> Setup | None:
        """See ``PdoChannel``."""
        due_ns = self.check_ns()
        if due_ns is None or now_ns < due_ns:
            return None
        self._checked_ns = now_ns
        return self._check(now_ns)

    def _check(self, now_ns: int) -> Setup:
        counter = yield from self._object.read_counter()
        if counter is not None and counter == self._counter:
            self._confirmed_ns = now_ns
        open_question = self._unconfirmed or bool(self._rejected)
        if counter is not None and counter == self._counter and not open_question:
            return
        host_ns, sample, _ = yield from self._object.read_value()
        if self._heard_ns >= now_ns:  # a TPDO arrived meanwhile: which of the two is older is not known, if they differ
            agrees = sample.value_raw == self._value and not self._rejected
            self._put(host_ns, sample, SampleStatus.OK if agrees else SampleStatus.NOT_VALID)
            self._unconfirmed &= not agrees
        elif counter is not None or open_question or sample.value_raw != self._value or self._cut:
            self._read(Reading(host_ns, sample, counter))
            self._unconfirmed = False
        self._confirmed_ns = now_ns

    def _read(self, reading: Reading) -> None:
        """Compare the value read back with the last row; record a row if it is new."""
        host_ns, sample, counter = reading
        if counter is not None and self._counter is not None:
            self._lose(host_ns, self._object.steps(self._counter, counter) - len(self._rejected), counted=True)
        elif self._value is not None and (sample.value_raw != self._value or self._cut):
            self._lose(host_ns, 1, cause=CHANGES_UNHEARD if self._cut else "no_pdo")
        self._checked_ns = self._confirmed_ns = host_ns
        self._accept(host_ns, sample, counter)

    def finish(self, now_ns: int) -> None:
        """Last call: without a sign of life, changes up to the end may have been missed."""
        if self.started and self._object.is_readable and now_ns - self._confirmed_ns > OUTAGE_NS:
            self._lose(now_ns, 1, cause=CHANGES_UNHEARD)

    def _accept(self, host_ns: int, sample: Sample, counter: int | None) -> None:
        self._unconfirmed = sample.value_raw != self._value
        self._value, self._counter = sample.value_raw, counter
        self._rejected.clear()
        self._cut = False
        self._put(host_ns, sample, SampleStatus.OK)

    def _put(self, host_ns: int, sample: Sample, status: SampleStatus) -> None:
        self._row_ns = host_ns
        self._append(host_ns, self._sync.tick or 0, sample._replace(status=sample.status | status), 0)

    def _lose(self, host_ns: int, count: int, *, counted: bool = False, cause: str = "no_pdo") -> None:
        """Record a gap of ``count`` TPDOs that did not arrive. A node that was cut off may not have sent them."""
        if count <= 0:
            return
        name, first = self.data.name, self._next
        span_ns = host_ns - self._row_ns
        self._report.gap(
            host_ns,
            name,
            first,
            first + count - 1,
            span_ns,
            cause,
            counted=counted and self._is_heard and not self._cut,
        )
        self._next += count
        least = "at least " if cause == CHANGES_UNHEARD else ""
        cob_id = self.data.cob_id
        text = f"{least}{count} TPDOs {cob_id:03X}h did not arrive, by its counter or its value now: check the bus"
        self._report.event(host_ns, Severity.WARNING, "pdo_lost", text, name)
