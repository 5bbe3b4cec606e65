"""TPDOs sent when something changes: one row each, and nothing that says by itself that one was lost.

So what the node told is read back by SDO: soon after each change, which is a second row that confirms the first, and
every ``CHECK_NS``, which is a row only where it brings news. Where the TPDO carries a counter of the changes too,
losses are counted by it and the check reads the counter alone; where it does not, a value that differs from the last
one told is one loss at the least. A TPDO whose counter does not follow on the last one is NOT_VALID; the next that
agrees with it, or the node when asked, says which of the two was right.
"""

from drivers.canopen_pdo.channel import PdoChannel, Sample
from drivers.canopen_pdo.mapped_object import MappedObject, Reading
from drivers.canopen_pdo.sdo import Setup
from drivers.canopen_pdo.sync import SyncCounter
from drivers.records import SampleStatus, Severity
from drivers.reporter import Reporter

CHECK_NS = 500_000_000
QUIET_NS = 20_000_000  # after a TPDO, before it is read back: what comes fast confirms itself


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
        self._value: int | None = None  # of the last row that was believed
        self._counter: int | None = None  # the same
        self._doubted: list[int] = []  # counters of the TPDOs not believed since
        self._unconfirmed = False  # the last row that was believed brought news
        self._row_ns = 0
        self._heard_ns = 0  # of the last TPDO
        self._checked_ns = 0

    def go_live(self) -> None:
        """The node has been started: its present value, read while setting up, is the first row."""
        super().go_live()
        reading = self._object.initial
        if reading is not None:
            self._read(reading)

    def node_rebooted(self) -> None:
        """See ``PdoChannel``. What it counts may have begun anew."""
        super().node_rebooted()
        self._counter = self._value = None

    def accept(self, host_ns: int, data: bytes) -> None:
        """See ``PdoChannel``."""
        sample = self._decoded(host_ns, data) if self.live else None
        if sample is None:
            return
        self._heard_ns = host_ns
        counter = self._object.counter(data)
        if counter is None or self._counter is None or self._object.steps(self._counter, counter) <= 1:
            self._believe(host_ns, sample, counter)
        elif self._doubted and self._object.steps(self._doubted[-1], counter) <= 1:
            self._lose(host_ns, self._object.steps(self._counter, counter) - len(self._doubted) - 1)
            self._believe(host_ns, sample, counter)
        else:
            self._doubted.append(counter)
            self._put(host_ns, sample, SampleStatus.NOT_VALID)

    def suspect(self, host_ns: int) -> None:
        """See ``PdoChannel``."""
        self._checked_ns = min(self._checked_ns, host_ns - CHECK_NS)

    def check(self, now_ns: int) -> Setup | None:
        """See ``PdoChannel``."""
        if not (self.live and self._object.is_readable) or now_ns - self._heard_ns < QUIET_NS:
            return None
        if not (self._unconfirmed or self._doubted) and now_ns - self._checked_ns < CHECK_NS:
            return None
        self._checked_ns = now_ns
        return self._check(now_ns)

    def _check(self, now_ns: int) -> Setup:
        counter = yield from self._object.read_counter()
        open_question = self._unconfirmed or bool(self._doubted)
        if counter is not None and counter == self._counter and not open_question:
            return
        host_ns, sample, _ = yield from self._object.read_value()
        if self._heard_ns >= now_ns:  # a TPDO crossed it: which of the two is older is not known
            self._put(host_ns, sample, SampleStatus.NOT_VALID)
        elif counter is not None or open_question or sample.value_raw != self._value:
            self._read(Reading(host_ns, sample, counter))

    def _read(self, reading: Reading) -> None:
        """What the node holds, in its own words."""
        host_ns, sample, counter = reading
        if counter is not None and self._counter is not None:
            self._lose(host_ns, self._object.steps(self._counter, counter) - len(self._doubted))
        elif self._value is not None and sample.value_raw != self._value:
            self._lose(host_ns, 1)
        self._checked_ns = host_ns
        self._believe(host_ns, sample, counter)

    def _believe(self, host_ns: int, sample: Sample, counter: int | None) -> None:
        self._unconfirmed = sample.value_raw != self._value
        self._value, self._counter = sample.value_raw, counter
        self._doubted.clear()
        self._put(host_ns, sample, SampleStatus.OK)

    def _put(self, host_ns: int, sample: Sample, status: SampleStatus) -> None:
        self._row_ns = host_ns
        self._append(host_ns, self._sync.tick or 0, sample._replace(status=sample.status | status), 0)

    def _lose(self, host_ns: int, count: int) -> None:
        """So many changes were told by TPDOs that did not arrive."""
        if count <= 0:
            return
        name, first = self.data.name, self._next
        self._report.gap(host_ns, name, first, first + count - 1, host_ns - self._row_ns, "no_pdo")
        self._next += count
        text = f"{count} TPDOs {self.data.cob_id:03X}h did not arrive, by its counter or its value now: check the bus"
        self._report.event(host_ns, Severity.WARNING, "pdo_lost", text, name)
