"""Traffic that candump (or python-can, in its format) recorded, read by ``can.LogReader`` and given to our driver."""

from collections.abc import Sequence
from pathlib import Path

import can

from drivers.canopen_pdo import CanopenBus, SyncConfig
from drivers.canopen_pdo.profiles.channel import NodeConfig
from drivers.ports import CanFrame
from drivers.records import Batch

NMT, SDO_REQUESTS = 0x000, range(0x601, 0x680)


class Recorded:
    """A ``CanPort`` on a log: gives what others said up to ``now_ns``; what is sent is kept, and answered by the log.

    Attributes:
        frames: What others said.
        theirs: What the recorded driver sent: NMT and SDO requests.
        sent: What the driver on this port sends.
    """

    def __init__(self, log: Path) -> None:
        with can.LogReader(log) as messages:
            everything = [CanFrame(round(m.timestamp * 1e9), m.arbitration_id, bytes(m.data)) for m in messages]
        asked = [frame.identifier == NMT or frame.identifier in SDO_REQUESTS for frame in everything]
        self.frames = [frame for frame, ours in zip(everything, asked, strict=True) if not ours]
        self.theirs = [(frame.identifier, frame.data) for frame, ours in zip(everything, asked, strict=True) if ours]
        self.sent: list[tuple[int, bytes]] = []
        self.now_ns = self.frames[0].host_ns
        self._given = 0

    def send(self, identifier: int, data: bytes) -> None:
        self.sent.append((identifier, bytes(data)))

    def receive(self, timeout_s: float) -> list[CanFrame]:
        del timeout_s
        first = self._given
        while self._given < len(self.frames) and self.frames[self._given].host_ns <= self.now_ns:
            self._given += 1
        return self.frames[first : self._given]

    def mute(self) -> None:
        self._given = len(self.frames)

    def close(self) -> None:
        pass


def decoded(log: Path, nodes: Sequence[NodeConfig]) -> tuple[list[Batch], Recorded]:
    """What a driver of these nodes makes of the log, pumped at every frame in it; and the port it did that on."""
    port = Recorded(log)
    bus = CanopenBus(port, nodes, SyncConfig())
    batches = bus.start(port.now_ns - 1)
    for frame in port.frames:
        port.now_ns = frame.host_ns
        batches += bus.pump(port.now_ns)
    return batches + bus.stop(port.now_ns), port
