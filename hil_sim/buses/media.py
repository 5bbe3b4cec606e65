"""Simulated I2C, CAN and pulse lines between twins and flight computer (serial lines: ``serial_bus``).

``I2cBus``, ``CanBus`` and ``PulseLine`` are the wires: a mission connects its twins to them and advances them; the
runner chooses the other end. Nothing here reads a clock or starts a thread, so a run is reproducible to the byte.
"""

import errno
import os
import socket
import struct
from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, Final, Protocol, cast, runtime_checkable

import numpy as np

from drivers.ports import CanFrame
from hil_sim.devices.can_bus.can_wire import Babbler, CanTalker, CanWire, is_process_data
from hil_sim.devices.can_bus.sync_train import WireFrame
from hil_sim.devices.sync.sync_box import SYNC_COB_ID, SyncBox
from hil_sim.devices.sync.sync_line import EdgeCapture
from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind

_EDGE: Final = struct.Struct("<qI")  # edge_ns, line_sequence
_LAZY_NS: Final = 50_000_000
_frame_of: Final = cast(Callable[[tuple[Any, ...]], CanFrame], partial(tuple.__new__, CanFrame))  # faster than it
_PROTOCOL_ERROR, _BUS_OFF, _BUS_ERROR, _RESTARTED = 0x008, 0x040, 0x080, 0x100  # linux/can/error.h


def _os_error(code: int) -> OSError:
    return OSError(code, os.strerror(code))


class Bus(Protocol):
    """Any bus."""

    @property
    def due_ns(self) -> int:
        """Time of the next event, ns."""

    def inject(self, faults: DeviceFaults) -> None:
        """Set the faults."""

    def advance(self, now_ns: int) -> None:
        """Process everything due at ``now_ns``."""


class I2cSlave(Protocol):
    """A device with an I2C interface."""

    address: int

    def advance(self, now_ns: int) -> None:
        """Do what is due."""

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """START, write, repeated START, read, STOP; raises OSError with the kernel's errno."""


class I2cBus:
    """Two wires with slaves on them. A transfer takes no time here: see ``transfer_ns``."""

    def __init__(self) -> None:
        self.transfers = 0
        self.refused = 0
        self._slaves: dict[int, I2cSlave] = {}
        self._faults = NO_FAULTS

    @property
    def due_ns(self) -> int:
        """Never: slaves are asked."""
        return NEVER

    def add(self, slave: I2cSlave) -> None:
        """Connect a slave.

        Raises:
            ValueError: its address is taken.
        """
        addresses = getattr(slave, "addresses", (slave.address,))  # of a chip of several dies
        for address in addresses:
            if address in self._slaves:
                raise ValueError(f"Address {address:#04x} is taken on this bus; give the slave another.")
        self._slaves |= dict.fromkeys(addresses, slave)

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that an I2C bus cannot have.
        """
        self._faults = faults.require(FaultKind.NACK, FaultKind.TIMEOUT, FaultKind.STUCK_BUS, FaultKind.INTERMITTENT)

    def advance(self, now_ns: int) -> None:
        """Let every slave do what is due."""
        for slave in self._slaves.values():
            slave.advance(now_ns)

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """One transaction.

        Raises:
            OSError: EREMOTEIO without an acknowledge, or what the slave or a fault says.
        """
        self.transfers += 1
        slave = self._slaves.get(address)
        try:
            self._obstruct(now_ns)
            if slave is None:
                raise _os_error(errno.EREMOTEIO)
            answer = slave.transfer(address, write, read_count, now_ns)
            if self._faults and self._faults.active(FaultKind.TIMEOUT, now_ns) is not None:
                raise _os_error(errno.ETIMEDOUT)
        except OSError:
            self.refused += 1
            raise
        return answer

    def _obstruct(self, now_ns: int) -> None:
        """What keeps a transfer from beginning, if anything does."""
        if not self._faults:
            return
        if self._faults.active(FaultKind.STUCK_BUS, now_ns) is not None:
            raise _os_error(errno.EBUSY)
        nack = self._faults.active(FaultKind.NACK, now_ns)
        if nack is not None or self._faults.is_away(now_ns):
            raise _os_error(int(nack.value) if nack is not None and nack.value else errno.EREMOTEIO)

    @staticmethod
    def transfer_ns(write_count: int, read_count: int, bit_rate: int = 400_000) -> int:
        """How long a transaction occupies real wires: nine bits a byte, addresses, START and STOP conditions."""
        bits = 2 + 9 * (1 + write_count) if write_count or not read_count else 1
        bits += 1 + 9 * (1 + read_count) if read_count else 0
        return bits * 1_000_000_000 // bit_rate


class CanLink(Protocol):
    """The flight computer's CAN interface, seen from the wire."""

    def take(self) -> list[tuple[int, bytes | int]]:
        """Frames the flight computer sent since the last call: identifier, and data or how many a remote one asks."""

    @property
    def listening(self) -> bool:
        """Whether the flight computer has its end open."""

    def give(self, frames: Sequence[CanFrame]) -> None:
        """Frames it receives, with the stamp of its kernel."""


@runtime_checkable
class ReportsCanErrors(Protocol):
    """An interface that also reports its controller's errors; an slcan adapter does not."""

    def give_error(self, end_ns: int, classes: int) -> None:
        """An error frame, its classes as in linux/can/error.h."""


@runtime_checkable
class CanBePulled(Protocol):
    """An interface on an adapter that can be pulled out; a controller on the board cannot."""

    def unplug(self) -> None:
        """The adapter is pulled out: it hears and sends nothing, and what is open on it fails."""

    def plug(self) -> None:
        """The adapter is back; it has to be opened again."""


class CanBus:
    """A CAN bus with nodes on it and the flight computer at one end.

    A received frame is stamped later than the end of its last bit by a fixed latency and an exponential one.

    Args:
        link: The flight computer's end.
        bit_rate: bit/s.
        seed: Of the stamp jitter.
        latency_ns: Fixed part of the interrupt latency.
        jitter_ns: Mean of its random part.
    """

    def __init__(
        self, link: CanLink, bit_rate: int = 500_000, seed: int = 0, *, latency_ns: int = 5_000, jitter_ns: int = 3_000
    ) -> None:
        self.dropped = 0
        self.delivered = 0
        self.heard: Counter[int] = Counter()  # frames by identifier, sent while the flight computer listened
        self._link = link
        self._wire = CanWire(bit_rate)
        self._rng = np.random.default_rng([seed, 0xCA])
        self._latency_ns = latency_ns
        self._jitter_ns = jitter_ns
        self.errors = 0  # error frames sent
        self._bit_rate = bit_rate
        self._faults = NO_FAULTS
        self._late: deque[tuple[int, WireFrame]] = deque()  # frames on their way to us, by time of arrival
        self._now_ns = self._reached_ns = 0
        self._waits = False
        self._drivers: list[SyncBox] = []
        self._wakes_ns = 0  # when it goes on though nobody looks
        self._last_stamp_ns = 0
        self._pulled = False  # the adapter out of the flight computer

    @property
    def due_ns(self) -> int:
        """When something next happens on the bus."""
        return self._wire.due_ns

    def know_ahead(self, known_ns: Callable[[], int]) -> None:
        """Let the answers to SYNCs be computed as far ahead as ``known_ns()``, before when the plant is known.

        A bus without faults then goes on where the flight computer looks, by ``look``, before the sync line rises, or
        where 50 ms have gathered: what comes is the same.
        """
        self._wire.know_ahead(known_ns)
        self._waits = True

    def add(self, node: CanTalker) -> None:
        """Connect a node."""
        self._wire.add(node, is_process_data)
        if isinstance(node, SyncBox):
            self._drivers.append(node)

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that a CAN bus cannot have.
        """
        self._faults = faults.require(
            FaultKind.FRAME_DROP,
            FaultKind.BUS_OFF,
            FaultKind.ERROR_FRAMES,
            FaultKind.FLOOD,
            FaultKind.DELAYED,
            FaultKind.INTERMITTENT,
            *((FaultKind.UNPLUG,) if isinstance(self._link, CanBePulled) else ()),
        )
        for window in faults.windows:
            if window.kind is FaultKind.FLOOD:
                babbler = Babbler(int(window.value), window.start_ns, window.end_ns, self._bit_rate)
                self._wire.add(babbler, lambda identifier: True)

    def advance(self, now_ns: int) -> None:
        """Send what the flight computer sent since the last call, let nodes and wire go on, deliver what arrived."""
        self._reached_ns = now_ns
        if now_ns >= self._wakes_ns:
            self._advance(now_ns)

    def look(self) -> None:
        """The flight computer does something with its end: all is to be as it is now."""
        if self._now_ns < self._reached_ns:
            self._advance(self._reached_ns)

    def _advance(self, now_ns: int) -> None:
        self._pull(now_ns)
        sent = self._link.take()
        if not (self._faults and self._is_cut(self._now_ns)):
            for identifier, data in sent:
                if isinstance(data, bytes):
                    self._wire.send(identifier, data, self._now_ns)
                else:
                    self._wire.request(identifier, data, self._now_ns)
        frames = self._wire.advance(now_ns)
        before_ns, self._now_ns = self._now_ns, now_ns
        if self._link.listening:
            self.heard.update([frame.identifier for frame in frames])
        if self._faults:
            if self._link.listening:  # a babbling node's frames of eight bytes are no SYNCs
                self.heard[SYNC_COB_ID] -= sum(f.identifier == SYNC_COB_ID and len(f.data) > 1 for f in frames)
            kept = [frame for frame in frames if not self._is_dropped(frame)]
            self.dropped += len(frames) - len(kept)
            frames = self._arrived(kept, now_ns)
            self._tell_errors(before_ns, now_ns)
        if frames:
            self.delivered += len(frames)
            self._link.give(self._stamped(frames))
        if self._waits and not self._faults:
            self._wakes_ns = min([now_ns + _LAZY_NS, *(driver.pulse_ns for driver in self._drivers)])

    def _pull(self, now_ns: int) -> None:
        """Pull the adapter out, or put it back in."""
        pulled = self._faults.active(FaultKind.UNPLUG, now_ns) is not None if self._faults else False
        if pulled != self._pulled and isinstance(self._link, CanBePulled):
            self._pulled = pulled
            if pulled:
                self._link.unplug()
                self._late.clear()
            else:
                self._link.plug()

    def _is_cut(self, now_ns: int) -> bool:
        return (
            self._pulled or self._faults.active(FaultKind.BUS_OFF, now_ns) is not None or self._faults.is_away(now_ns)
        )

    def _is_dropped(self, frame: WireFrame) -> bool:
        fault = self._faults.active(FaultKind.FRAME_DROP, frame.end_ns)
        return self._is_cut(frame.end_ns) or (fault is not None and fault.value in (0, frame.identifier))

    def _arrived(self, frames: list[WireFrame], now_ns: int) -> list[WireFrame]:
        """Frames that are with us now, those that were delayed before included."""
        for frame in frames:
            delayed = self._faults.active(FaultKind.DELAYED, frame.end_ns)
            here_ns = frame.end_ns + (0 if delayed is None else round(delayed.value * 1e9))
            if self._late:
                here_ns = max(here_ns, self._late[-1][0])
            self._late.append((here_ns, frame))
        arrived = []
        while self._late and self._late[0][0] <= now_ns:
            here_ns, frame = self._late.popleft()
            arrived.append(frame._replace(end_ns=here_ns))
        return arrived

    def _tell_errors(self, before_ns: int, now_ns: int) -> None:
        errors = [
            (t, _PROTOCOL_ERROR | _BUS_ERROR) for t in self._faults.repeats(FaultKind.ERROR_FRAMES, before_ns, now_ns)
        ]
        for window in self._faults.windows:
            if window.kind is FaultKind.BUS_OFF:
                ends = ((window.start_ns, _BUS_OFF), (window.end_ns, _RESTARTED))
                errors += [(t, classes) for t, classes in ends if before_ns < t <= now_ns]
        for time_ns, classes in sorted(errors):
            self.errors += 1
            if isinstance(self._link, ReportsCanErrors):
                self._link.give_error(time_ns, classes)

    def _stamped(self, frames: list[WireFrame]) -> list[CanFrame]:
        ends_ns, identifiers, data = zip(*frames, strict=True)
        share, places = self._rng.standard_exponential(len(frames)), np.arange(len(frames))
        late_ns = np.array(ends_ns) + self._latency_ns + (share * self._jitter_ns).astype(np.int64)
        late_ns[0] = max(int(late_ns[0]), self._last_stamp_ns + 1)
        stamps_ns = (np.maximum.accumulate(late_ns - places) + places).tolist()  # each later than the one before
        self._last_stamp_ns = stamps_ns[-1]
        return list(map(_frame_of, zip(stamps_ns, identifiers, data, repeat(False), strict=False)))


class EdgeLink(Protocol):
    """Where stamped edges go."""

    def give(self, edge_ns: int, line_sequence: int) -> bool:
        """One edge, as the kernel reports it; returns whether anybody was there to take it."""


class PulseLine:
    """The pulse line's input at the flight computer.

    Args:
        link: Where its edges go.
        seed: Of the stamp jitter.
    """

    def __init__(self, link: EdgeLink, seed: int = 0) -> None:
        self.capture = EdgeCapture(seed)
        self.seen = 0
        self.heard = 0  # of these, taken by a receiver
        self._link = link
        self._source: CanTalker | None = None

    @property
    def due_ns(self) -> int:
        """When the box that drives it next does something."""
        return NEVER if self._source is None else self._source.due_ns

    def drive(self, source: CanTalker) -> None:
        """Let the line move a box that no CAN bus moves."""
        self._source = source

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks.

        Raises:
            FaultError: a fault that the line cannot have.
        """
        self.capture.inject(faults)

    def edge(self, edge_ns: int, high_ns: int) -> None:
        """The line goes high."""
        self.capture.edge(edge_ns, high_ns)

    def advance(self, now_ns: int) -> None:
        """Let the box act, and report the edges stamped up to ``now_ns``."""
        while self.due_ns <= now_ns and self._source is not None:
            self._source.act(self.due_ns)
        for edge_ns, line_sequence in self.capture.advance(now_ns):
            self.seen += 1
            self.heard += self._link.give(edge_ns, line_sequence)


class EdgeDatagrams:
    """Edges as datagrams to a Unix socket that the receiver binds.

    Args:
        path: The receiver's socket. An edge that finds no receiver, or one that is full, is counted in ``lost``.
    """

    def __init__(self, path: Path) -> None:
        self.lost = 0
        self._path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def give(self, edge_ns: int, line_sequence: int) -> bool:
        """Send one edge."""
        try:
            self._socket.sendto(_EDGE.pack(edge_ns, line_sequence), self._path)
        except (ConnectionError, FileNotFoundError):
            self.lost += 1
            return False
        except BlockingIOError:  # a receiver is there, and its queue is full
            self.lost += 1
        return True

    def close(self) -> None:
        """Close the sending end."""
        self._socket.close()
