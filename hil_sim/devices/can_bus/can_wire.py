"""The CAN wire: frames take their true time, one after the other, the lowest identifier first.

Frame lengths are exact: the CRC is computed and stuff bits are counted (ISO 11898-1), so the time at which a frame
ends depends on its content, as on a real bus. A frame is received at the end of its end-of-frame field; three bits of
intermission follow. Talkers never lose arbitration bit by bit: whoever is ready when the bus falls idle takes part.
Frames of a node queue, but for the identifiers that it has a single buffer for: there a frame that still waits is
overwritten by the next. The flight computer may send remote frames; those nodes get them that answer any. Error
frames and retransmission are not modelled, nor 29-bit identifiers.
"""

import heapq
from collections import Counter
from collections.abc import Callable
from typing import Final, Protocol, runtime_checkable

from hil_sim.devices.can_bus.frame_length import INTERMISSION_BITS, frame_bits
from hil_sim.devices.can_bus.sync_train import SYNC, SyncTrains, Train, WireFrame
from hil_sim.faults import NEVER


class TransmitFrame(Protocol):
    """What a talker is given to send with."""

    def __call__(self, identifier: int, data: bytes, ready_ns: int) -> None:
        """Offer a frame to the bus, to be sent not before ``ready_ns``."""


class CanTalker(Protocol):
    """A node on the wire.

    Attributes:
        hears_process_data: Whether it does anything about PDOs of other nodes; they are not given to it otherwise.
    """

    hears_process_data: bool

    @property
    def due_ns(self) -> int:
        """When it next wants to do something of its own accord; ``NEVER`` when it does not."""

    def connect(self, transmit: TransmitFrame) -> None:
        """Give it the wire."""

    def act(self, now_ns: int) -> None:
        """Do what is due."""

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """A frame of another node has ended."""


@runtime_checkable
class AnswersRemoteFrames(Protocol):
    """A node that does something about remote frames."""

    def remote(self, identifier: int, now_ns: int) -> None:
        """A remote frame has ended."""


_Waiting = tuple[int, int, bytes, int, int | None]
"""Identifier, order, data, sender, bytes that a remote frame asks for; sorts by arbitration."""

_HOST: Final = -1


def is_process_data(identifier: int) -> bool:
    """SYNC and PDOs by the predefined connection set (CiA 301, 7.3.3): of these only the newest is worth sending."""
    return identifier == SYNC or 0x180 < identifier < 0x580


class CanWire:
    """The wire, its nodes, and the flight computer's controller.

    Args:
        bit_rate: bit/s.
    """

    def __init__(self, bit_rate: int = 500_000) -> None:
        self._bit_ns = 1e9 / bit_rate
        self._gap_ns = round(INTERMISSION_BITS * self._bit_ns)
        self._nodes: list[CanTalker] = []
        self._hearing: list[tuple[int, CanTalker]] = []  # nodes that PDOs are given to
        self._others: dict[int, list[CanTalker]] = {}  # nodes that other frames are given to, by the sender
        self._single: list[Callable[[int], bool]] = []
        self._later: list[tuple[int, _Waiting]] = []  # by ready time
        self._ready: list[_Waiting] = []  # by arbitration
        self._buffered: set[tuple[int, int]] = set()  # of these, identifier and sender of those in a single buffer
        self._on_wire: tuple[int, _Waiting] | None = None
        self.overwritten: Counter[int] = Counter()  # frames that never came to their turn, by identifier
        self._idle_ns = 0
        self._order = 0
        self._received: list[WireFrame] = []
        self.trains = SyncTrains(self._bit_ns)
        self._known_ns: Callable[[], int] | None = None
        self._train: Train | None = None  # the answers to the last SYNC, if nothing else is on the wire
        self._train_at = 0  # the first of its frames that has not ended
        self._reached_ns = 0

    def know_ahead(self, known_ns: Callable[[], int]) -> None:
        """Compute what nodes answer SYNCs with as far ahead as ``known_ns()``, before when the plant is known."""
        self._known_ns = known_ns

    @property
    def due_ns(self) -> int:
        """When something next happens on the wire or in a node."""
        return min(self._wire_due_ns(), self._nodes_due_ns())

    def add(self, node: CanTalker, single_buffer: Callable[[int], bool] = lambda identifier: False) -> None:
        """Connect a node, and say for which identifiers it has a single buffer."""
        index = len(self._nodes)
        self._single.append(single_buffer)
        self._nodes.append(node)

        def transmit(identifier: int, data: bytes, ready_ns: int) -> None:
            self._offer(identifier, data, ready_ns, index)

        node.connect(transmit)
        self._note_hearing()
        self._others = {
            sender: [other for place, other in enumerate(self._nodes) if place != sender]
            for sender in range(_HOST, len(self._nodes))
        }

    def send(self, identifier: int, data: bytes, ready_ns: int) -> None:
        """Offer a frame of the flight computer to the bus."""
        self._offer(identifier, data, ready_ns, _HOST)

    def request(self, identifier: int, size: int, ready_ns: int) -> None:
        """Offer a remote frame of the flight computer, that asks for ``size`` bytes."""
        self._offer(identifier, b"", ready_ns, _HOST, size)

    def advance(self, now_ns: int) -> list[WireFrame]:
        """Let everything happen that is due at ``now_ns``; returns what the flight computer's controller received."""
        node_ns = self._nodes_due_ns()  # when the first of them acts; changes when one acts or receives
        while True:
            if self._train is not None:
                self._follow(self._train, min(now_ns, node_ns - 1))
                if self._train is None:
                    continue
                if node_ns > now_ns:
                    break
                self.dissolve(node_ns - 1)
            if self._run(node_ns, now_ns):
                node_ns = self._nodes_due_ns()
            wire_ns = self._wire_due_ns() if self._on_wire is None else self._on_wire[0]
            if node_ns <= wire_ns:
                if node_ns > now_ns:
                    break
                for node in self._nodes:
                    if node.due_ns <= node_ns:
                        node.act(node_ns)
                node_ns = self._nodes_due_ns()
            elif wire_ns > now_ns:
                break
            elif self._on_wire is None:
                self._begin(wire_ns)
            elif self._end():
                node_ns = self._nodes_due_ns()
        self._reached_ns = now_ns
        received, self._received = self._received, []
        return received

    def _run(self, node_ns: int, now_ns: int) -> bool:
        """Let SYNCs and their answers pass that are whole before anything else happens; whether there were any.

        Args:
            node_ns: When the first node acts.
            now_ns: Up to when the wire goes on.
        """
        box: object = self.trains.box
        if box is None or self._on_wire is not None or self._later or self._ready or node_ns < self._idle_ns:
            return False
        others_ns = min([node.due_ns for node in self._nodes if node is not box], default=NEVER)
        frames = self.trains.run(node_ns, min(now_ns, others_ns - 1)) if others_ns > node_ns else []
        if frames:
            self._received += frames
            self._idle_ns = frames[-1].end_ns + self._gap_ns
        return bool(frames)

    def _offer(self, identifier: int, data: bytes, ready_ns: int, sender: int, asked: int | None = None) -> None:
        if self._train is not None:
            self.dissolve(self._reached_ns)
        self._order += 1
        heapq.heappush(self._later, (ready_ns, (identifier, self._order, data, sender, asked)))

    def _nodes_due_ns(self) -> int:
        return min([node.due_ns for node in self._nodes], default=NEVER)

    def _wire_due_ns(self) -> int:
        if self._train is not None:
            return self._train.frames[self._train_at].end_ns
        if self._on_wire is not None:
            return self._on_wire[0]
        if self._ready:
            return self._idle_ns
        return max(self._idle_ns, self._later[0][0]) if self._later else NEVER

    def _begin(self, start_ns: int) -> None:
        while self._later and self._later[0][0] <= start_ns:
            self._contend(heapq.heappop(self._later)[1])
        frame = heapq.heappop(self._ready)
        self._buffered.discard((frame[0], frame[3]))
        end_ns = start_ns + round(frame_bits(frame[0], frame[2], frame[4]) * self._bit_ns)
        self._on_wire = (end_ns, frame)
        self._idle_ns = end_ns + self._gap_ns

    def _contend(self, frame: _Waiting) -> None:
        identifier, _, data, sender, asked = frame
        if (identifier, sender) in self._buffered:
            for place, waiting in enumerate(self._ready):
                if waiting[0] == identifier and waiting[3] == sender:
                    self.overwritten[identifier] += 1
                    self._ready[place] = (identifier, waiting[1], data, sender, asked)
                    return
        if sender != _HOST and self._single[sender](identifier):
            self._buffered.add((identifier, sender))
        heapq.heappush(self._ready, frame)

    def _end(self) -> bool:
        """The frame on the wire has ended; whether a node was given it."""
        if self._on_wire is None:
            return False
        end_ns, (identifier, _, data, sender, asked) = self._on_wire
        self._on_wire = None
        if sender != _HOST:
            self._received.append(WireFrame(end_ns, identifier, data))
        if asked is None and 0x180 < identifier < 0x580:
            for index, node in self._hearing:
                if index != sender:
                    node.receive(identifier, data, end_ns)
            return bool(self._hearing)
        if asked is None and identifier == SYNC and self._set_off(end_ns, sender):
            return False
        if asked is None:
            for node in self._others[sender]:
                node.receive(identifier, data, end_ns)
        else:
            for node in self._nodes:
                if isinstance(node, AnswersRemoteFrames):
                    node.remote(identifier, end_ns)
        if identifier >= 0x580:
            self._note_hearing()
        return True

    def _set_off(self, end_ns: int, sender: int) -> bool:
        """After a SYNC: whether its answers are known, and nothing else waits."""
        if self._known_ns is None or self._later or self._ready or sender == _HOST:
            return False
        train = self.trains.take(end_ns, self._nodes, self._nodes[sender], self._known_ns())
        if train is not None and train.frames:
            self._train, self._train_at = train, 0
        return train is not None

    def _follow(self, train: Train, until_ns: int) -> None:
        """The frames of the train that end up to then."""
        frames, at = train.frames, self._train_at
        while at < len(frames) and frames[at].end_ns <= until_ns:
            self._received.append(frames[at])
            at += 1
        self._train_at = at
        if at == len(frames):
            self._train = None
            self._idle_ns = frames[-1].end_ns + self._gap_ns

    def dissolve(self, until_ns: int) -> None:
        """What is left of the train goes on frame by frame; ``until_ns``: up to when the wire has gone on."""
        train, self._train = self._train, None
        if train is None:
            return
        begun = False
        if self._train_at:
            self._idle_ns = train.frames[self._train_at - 1].end_ns + self._gap_ns
            begun = True
        for at in range(self._train_at, len(train.frames)):
            end_ns, identifier, data = train.frames[at]
            self._order += 1
            frame: _Waiting = (identifier, self._order, data, train.senders[at], None)
            if train.begins_ns[at] <= until_ns and self._on_wire is None:
                self._on_wire, self._idle_ns, begun = (end_ns, frame), end_ns + self._gap_ns, True
            elif begun:
                self._contend(frame)
            else:
                heapq.heappush(self._later, (train.ready_ns, frame))

    def _note_hearing(self) -> None:
        """Which nodes hear PDOs: what the object dictionary of one says, changed by SDO if at all."""
        self._hearing = [(index, node) for index, node in enumerate(self._nodes) if node.hears_process_data]


class Babbler:
    """A broken node that sends one identifier without pause.

    Args:
        identifier: What it sends, with eight zero bytes.
        start_ns: From when on.
        end_ns: Until when.
        bit_rate: bit/s.
    """

    hears_process_data = False

    def __init__(self, identifier: int, start_ns: int, end_ns: int, bit_rate: int = 500_000) -> None:
        self.due_ns = start_ns
        self._identifier = identifier
        self._end_ns = end_ns
        bits = frame_bits(identifier, bytes(8)) + INTERMISSION_BITS
        self._step_ns = bits * 1_000_000_000 // bit_rate  # never later than the frame before it has gone
        self._transmit: TransmitFrame | None = None

    def connect(self, transmit: TransmitFrame) -> None:
        """Give it the wire."""
        self._transmit = transmit

    def act(self, now_ns: int) -> None:
        """Send the next one."""
        if now_ns < self._end_ns and self._transmit is not None:
            self._transmit(self._identifier, bytes(8), now_ns)
            self.due_ns = now_ns + self._step_ns
        else:
            self.due_ns = NEVER

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """Ignores all frames."""
