"""What becomes of a node's TPDOs: SCALAR rows, numbered, with every one that is missing named."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from drivers.canopen_pdo.sdo import Setup
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import FrameError
from drivers.records import SCALAR, SampleStatus, Severity
from drivers.reporter import Reporter


class Sample(NamedTuple):
    """A TPDO decoded: raw value, the device's own status byte, why it may not be used."""

    value_raw: int
    device_status: int = 0
    status: SampleStatus = SampleStatus.OK


class ProcessData(ABC):
    """One value of one node: how the node is set up for it, and how its TPDO is read.

    Attributes:
        name: Channel.
        node: Node number.
        cob_id: COB-ID of the TPDO.
        synchronous: The TPDO answers a SYNC; otherwise it is sent on events.
        profile: Low word of 1000h that the node must have; None: any.
        unit: Unit of a scaled value.
        scale: ``unit`` per count; valid once ``setup`` has run.
    """

    profile: int | None = None
    synchronous = True
    unit = "1"
    scale = 1.0

    def __init__(self, name: str, node: int, cob_id: int) -> None:
        self.name = name
        self.node = node
        self.cob_id = cob_id

    @abstractmethod
    def setup(self) -> Setup:
        """The SDO transfers that check and set the node up. Raises ConfigurationError when it cannot serve."""

    @abstractmethod
    def decode(self, data: bytes) -> Sample:
        """Read a TPDO. Raises FrameError when its length is wrong."""

    def initial(self) -> tuple[int, Sample] | None:
        """A value read while setting up, and its stamp, where the TPDO only comes on events."""
        return None


class Channel(ABC):
    """Rows of one ``ProcessData``, gathered between two pumps.

    Args:
        data: The value.
        report: Where rows, gaps and events go.
        sync: Numbers the SYNCs of this bus.

    Attributes:
        data: The value.
        live: The node is set up and running; TPDOs before that are not counted as samples.
    """

    def __init__(self, data: ProcessData, report: Reporter, sync: SyncCounter) -> None:
        self.data = data
        self.live = False
        self._report = report
        self._sync = sync
        self._next = 0  # sequence of the next row
        self._after_reset = False
        self._rows: list[tuple[int, int, int, int, float, str, int, int, int]] = []

    @property
    def started(self) -> bool:
        """It has had a first sample."""
        return self._next > 0

    def go_live(self) -> None:
        """The node has been started."""
        self.live = True

    def node_reset(self) -> None:
        """The node began anew: nothing counts until it is set up again, and its next row says AFTER_RESET."""
        self.live = False
        self._after_reset = self.started

    @abstractmethod
    def accept(self, host_ns: int, data: bytes) -> None:
        """A TPDO arrived."""

    def hand_over(self) -> None:
        """Give the rows gathered to the reporter."""
        if self._rows:
            rows = np.zeros(len(self._rows), SCALAR)
            rows[:] = self._rows
            self._rows.clear()
            self._report.rows(self.data.name, rows)

    def _decoded(self, host_ns: int, data: bytes) -> Sample | None:
        try:
            return self.data.decode(data)
        except FrameError as error:
            self._report.event(host_ns, Severity.WARNING, "bad_pdo", str(error), self.data.name)
            return None

    def _append(self, host_ns: int, tick: int, sample: Sample, sync_counter: int) -> None:
        status = sample.status
        if self._after_reset:
            status |= SampleStatus.AFTER_RESET
            self._after_reset = False
        data = self.data
        self._rows.append(
            (
                *(self._next, host_ns, tick, sample.value_raw, data.scale),
                *(data.unit, sync_counter, sample.device_status, int(status)),
            )
        )
        self._next += 1


class EventChannel(Channel):
    """TPDOs sent when something changes: one row each. ``tick`` is the SYNC number current when it arrived."""

    def go_live(self) -> None:
        """The node has been started: its present value is the first row."""
        super().go_live()
        initial = self.data.initial()
        if initial is not None:
            host_ns, sample = initial
            self._append(host_ns, self._sync.tick or 0, sample, 0)

    def accept(self, host_ns: int, data: bytes) -> None:
        """See ``Channel``."""
        sample = self._decoded(host_ns, data) if self.live else None
        if sample is not None:
            self._append(host_ns, self._sync.tick or 0, sample, 0)
