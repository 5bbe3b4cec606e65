"""The CAN wire: frames take their true time, one after the other, the lowest identifier first.

Frame lengths are exact: the CRC is computed and stuff bits are counted (ISO 11898-1), so the time at which a frame
ends depends on its content, as on a real bus. A frame is received at the end of its end-of-frame field; three bits of
intermission follow. Talkers never lose arbitration bit by bit: whoever is ready when the bus falls idle takes part.
Frames of a node queue, but for the identifiers that it has a single buffer for: there a frame that still waits is
overwritten by the next. The flight computer may send remote frames; those nodes get them that answer any. Error
frames and retransmission are not modelled, nor 29-bit identifiers.
"""

import heapq
import struct
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy as np

from hil_sim.faults import NEVER

_CRC_POLYNOMIAL: Final = 0x4599  # ISO 11898-1: CRC-15-CAN
_TAIL_BITS: Final = 10  # CRC delimiter, ACK slot, ACK delimiter, seven bits of end-of-frame
_INTERMISSION_BITS: Final = 3


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1 ^ _CRC_POLYNOMIAL if crc & 0x4000 else crc << 1) & 0x7FFF
        table.append(crc)
    return tuple(table)


def _stuff_table() -> tuple[tuple[int, int], ...]:
    """By state * 256 + byte: the next state and the stuff bits inserted; state = 2 * run length + last bit."""
    table = []
    for state in range(10):  # a run is four bits long at most
        for byte in range(256):
            run, last, stuffed = state >> 1, state & 1, 0
            for shift in range(7, -1, -1):
                bit = byte >> shift & 1
                run = run + 1 if bit == last and run else 1
                last = bit
                if run == 5:  # the stuff bit is the opposite one, and begins a run of its own
                    stuffed += 1
                    run, last = 1, 1 - bit
            table.append((run << 1 | last, stuffed))
    return tuple(table)


def _crc_words() -> list[int]:
    """CRC of each 16-bit word, by that of its bytes."""
    table = np.array(_crc_table())
    first = table[:, None]
    return list((table[first >> 7 ^ np.arange(256)] ^ (first << 8 & 0x7FFF)).ravel().tolist())


def _stuff_words() -> bytes:
    """By state * 65536 + word: the next state + 16 * the stuff bits inserted, by the table of bytes."""
    state, stuffed = np.array(_stuff_table()).reshape(10, 256, 2).transpose(2, 0, 1)
    both = state[state] | (stuffed[:, :, None] + stuffed[state]) << 4  # (10, 256, 256)
    return bytes(both.astype(np.uint8).tobytes())


_CRC: Final = _crc_words()
_STUFF: Final = _stuff_words()
_WORDS: Final = tuple(struct.Struct(f">{count}H") for count in range(8))


def crc15(bits: int, n_bytes: int) -> int:
    """CRC-15-CAN of a bit string held in the low ``8 * n_bytes`` bits; leading zero bits do not change it."""
    crc, count = 0, (n_bytes + 1) // 2
    for word in _WORDS[count].unpack(bits.to_bytes(2 * count, "big")):
        crc = _CRC[crc << 1 ^ word]
    return crc


@lru_cache(maxsize=4096)  # SYNCs, and values that rest
def frame_bits(identifier: int, data: bytes, asked: int | None = None) -> int:
    """Length of a frame with an 11-bit identifier, start-of-frame to end-of-frame, stuff bits included.

    Args:
        identifier: Its.
        data: Its; none in a remote frame.
        asked: How many bytes a remote frame asks for; None: a data frame.
    """
    n = len(data)
    control = n if asked is None else 1 << 6 | asked  # RTR, IDE, r0, 4 bits DLC
    head = identifier << 7 | control  # with SOF and 11 identifier bits: 19 bits
    body = head << 8 * n | int.from_bytes(data, "big")
    stuffed_bits = 34 + 8 * n
    stream = body << 15 | crc15(body, n + 3)
    padding_bits = -stuffed_bits % 16  # to a whole word; alternating bits are never stuffed
    padding = (0x1555 if stream & 1 else 0x2AAA) >> 14 - padding_bits
    count = (stuffed_bits + padding_bits) // 16
    state = stuff_bits = 0
    for word in _WORDS[count].unpack((stream << padding_bits | padding).to_bytes(2 * count, "big")):
        found = _STUFF[state << 16 | word]
        state = found & 15
        stuff_bits += found >> 4
    return stuffed_bits + stuff_bits + _TAIL_BITS


class WireFrame(NamedTuple):
    """A frame that has been on the wire, and when its last bit was there."""

    end_ns: int
    identifier: int
    data: bytes


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
    return identifier == 0x080 or 0x180 < identifier < 0x580


class CanWire:
    """The wire, its nodes, and the flight computer's controller.

    Args:
        bit_rate: bit/s.
    """

    def __init__(self, bit_rate: int = 500_000) -> None:
        self._bit_ns = 1e9 / bit_rate
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
        received, self._received = self._received, []
        return received

    def _offer(self, identifier: int, data: bytes, ready_ns: int, sender: int, asked: int | None = None) -> None:
        self._order += 1
        heapq.heappush(self._later, (ready_ns, (identifier, self._order, data, sender, asked)))

    def _nodes_due_ns(self) -> int:
        return min([node.due_ns for node in self._nodes], default=NEVER)

    def _wire_due_ns(self) -> int:
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
        self._idle_ns = end_ns + round(_INTERMISSION_BITS * self._bit_ns)

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
        bits = frame_bits(identifier, bytes(8)) + _INTERMISSION_BITS
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
