"""TPDOs of a node as numbered SCALAR rows; every missing one is recorded in a gap."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.canopen_pdo.sdo import Setup
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import FrameError
from drivers.position import Position
from drivers.records import SCALAR, Rows, SampleStatus, Severity
from drivers.reporter import Reporter

_HALF_WORD = 1 << 31


class Sample(NamedTuple):
    """A decoded TPDO: raw value, the device's status byte, reasons why it may not be used."""

    value_raw: int
    device_status: int = 0
    status: SampleStatus = SampleStatus.OK


class Samples(NamedTuple):
    """Decoded TPDOs: arrays (n,) of what a :class:`Sample` has; None: all are 0."""

    value_raw: Sequence[int] | NDArray[np.int64]
    device_status: NDArray[np.uint8] | None = None
    status: NDArray[np.uint8] | None = None


def position_samples(position: Position, words: NDArray[np.int64]) -> Samples | None:
    """Position samples of ``words`` (n,), each within a revolution of the one before; None, and no change, else."""
    if position.at is None:
        return None
    wraps = (position.at - int(words[0]) + _HALF_WORD) // (2 * _HALF_WORD)
    positions = (words + 2 * _HALF_WORD * wraps).tolist()  # where it wraps within them, they are read one by one
    return Samples(positions) if position.follow(positions) else None


def position_sample(position: Position, word: int) -> Sample:
    """A position sample; NOT_VALID where ``Position`` rejects the step."""
    value, is_accepted = position.place(word)
    return Sample(value) if is_accepted else Sample(value, 0, SampleStatus.NOT_VALID)


class ProcessData(ABC):
    """One value of one node: its set-up sequence and the decoding of its TPDO.

    Attributes:
        name: Channel.
        node: Node number.
        cob_id: COB-ID of the TPDO.
        profile: Low word of 1000h that the node must have; None: any.
        unit: Unit of a scaled value.
        scale: ``unit`` per count; valid once ``setup`` has run.
    """

    profile: int | None = None
    unit = "1"
    scale = 1.0

    def __init__(self, name: str, node: int, cob_id: int) -> None:
        self.name = name
        self.node = node
        self.cob_id = cob_id

    @abstractmethod
    def setup(self) -> Setup:
        """SDO transfers that check and configure the node. Raises ConfigurationError when it cannot be used."""

    def rebooted(self) -> None:  # noqa: B027 - a hook that may be left as it is
        """The node sent its boot-up message."""

    @abstractmethod
    def decode(self, data: bytes) -> Sample:
        """Read a TPDO. Raises FrameError when its length is wrong."""

    def decode_many(self, words: NDArray[np.uint8]) -> Samples | None:
        """Read TPDOs of one length, ``words`` (n, bytes); None, and no change, where they are to be read one by one."""
        del words
        return None


class NodeConfig(Protocol):
    """Configuration of a node, or of some channels of one."""

    def process_data(self) -> Sequence[ProcessData]:
        """Its channels."""


class PdoChannel(ABC):
    """Rows of one ``ProcessData``, gathered between two pumps.

    Args:
        data: The value.
        report: Where rows, gaps and events go.
        sync: Numbers the SYNCs of this bus.

    Attributes:
        data: The value.
        live: The node is set up and operational; earlier TPDOs are ignored.
    """

    def __init__(self, data: ProcessData, report: Reporter, sync: SyncCounter) -> None:
        self.data = data
        self.live = False
        self._report = report
        self._sync = sync
        self._next = 0  # sequence of the next row
        self._after_reset = False
        self._rows: list[tuple[int, int, int, int, float, str, int, int, int]] = []
        self._blocks: list[Rows] = []  # before these
        self._alike: Rows | None = None  # (1,), what all rows of arrays have

    @property
    def started(self) -> bool:
        """Whether a first sample has been received."""
        return self._next > 0

    def go_live(self) -> None:
        """The node has been started."""
        self.live = True

    def node_reset(self) -> None:
        """The node restarted: TPDOs are ignored until it is set up again; the next row is marked AFTER_RESET."""
        self.live = False
        self._after_reset = self.started

    def node_rebooted(self) -> None:
        """The node sent its boot-up message."""
        self.data.rebooted()

    @abstractmethod
    def accept(self, host_ns: int, data: bytes) -> None:
        """A TPDO arrived."""

    def suspect(self, host_ns: int, *, bus: bool) -> None:  # noqa: B027 - a hook that may be left as it is
        """The node reported an error, of its ``bus`` or another one: TPDOs may have been lost."""

    def check_ns(self) -> int | None:
        """When the value is to be read back next, as things stand; None: never."""
        return None

    def check(self, now_ns: int) -> Setup | None:
        """SDO transfers that read the value back, if due now; else None."""
        del now_ns
        return None

    def hand_over(self) -> None:
        """Pass the collected rows to the reporter."""
        self._gather()
        for rows in self._blocks:
            self._report.rows(self.data.name, rows)
        self._blocks.clear()

    def _gather(self) -> None:
        """Make an array of the single rows."""
        if self._rows:
            rows = np.zeros(len(self._rows), SCALAR)
            rows[:] = self._rows
            self._rows.clear()
            self._blocks.append(rows)

    def _append_many(self, host_ns: Sequence[int], tick: int, samples: Samples, counters: Sequence[int]) -> None:
        """Rows of SYNC ``tick`` and those that follow."""
        self._gather()
        count, data = len(host_ns), self.data
        if self._alike is None or self._alike["scale"][0] != data.scale:
            self._alike = np.zeros(1, SCALAR)
            self._alike["scale"], self._alike["unit"] = data.scale, data.unit
        rows = self._alike.repeat(count)
        rows["sequence"] = range(self._next, self._next + count)
        rows["host_ns"], rows["sync_counter"] = host_ns, counters
        rows["tick"] = range(tick, tick + count)
        rows["value_raw"], device_status, status = samples
        if device_status is not None:
            rows["device_status"] = device_status
        if status is not None:
            rows["status"] = status
        self._blocks.append(rows)
        self._next += count

    def _decoded(self, host_ns: int, data: bytes) -> Sample | None:
        try:
            return self.data.decode(data)
        except FrameError as error:
            self._report.event(host_ns, Severity.WARNING, "bad_pdo", str(error), self.data.name)
            return None

    def _append(self, host_ns: int, tick: int, sample: Sample, sync_counter: int) -> None:
        value_raw, device_status, status = sample
        if self._after_reset:
            status |= SampleStatus.AFTER_RESET
            self._after_reset = False
        data, number = self.data, self._next
        self._rows.append(
            (number, host_ns, tick, value_raw, data.scale, data.unit, sync_counter, device_status, int(status))
        )
        self._next = number + 1
