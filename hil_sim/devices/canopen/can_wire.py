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
from functools import lru_cache
from typing import Final, NamedTuple, Protocol, runtime_checkable

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
    for state in range(12):
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


_CRC: Final = _crc_table()
_STUFF: Final = _stuff_table()


def crc15(bits: int, n_bytes: int) -> int:
    """CRC-15-CAN of a bit string held in the low ``8 * n_bytes`` bits; leading zero bits do not change it."""
    crc = 0
    for byte in bits.to_bytes(n_bytes, "big"):
        crc = _CRC[crc >> 7 ^ byte] ^ (crc << 8 & 0x7FFF)
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
    padding = 0b010101 if stream & 1 else 0b101010  # to a whole byte; alternating bits are never stuffed
    state = stuff_bits = 0
    for byte in (stream << 6 | padding).to_bytes(n + 5, "big"):
        state, more = _STUFF[state << 8 | byte]
        stuff_bits += more
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


class _Waiting(NamedTuple):
    identifier: int
    order: int
    data: bytes
    sender: int
    asked: int | None = None  # bytes that a remote frame asks for


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
        self._single: list[Callable[[int], bool]] = []
        self._later: list[tuple[int, _Waiting]] = []  # by ready time
        self._ready: list[_Waiting] = []  # by arbitration
        self._on_wire: tuple[int, _Waiting] | None = None
        self.overwritten: Counter[int] = Counter()  # frames that never came to their turn, by identifier
        self._idle_ns = 0
        self._order = 0
        self._received: list[WireFrame] = []

    @property
    def due_ns(self) -> int:
        """When something next happens on the wire or in a node."""
        return min(self._wire_due_ns(), min((node.due_ns for node in self._nodes), default=NEVER))

    def add(self, node: CanTalker, single_buffer: Callable[[int], bool] = lambda identifier: False) -> None:
        """Connect a node, and say for which identifiers it has a single buffer."""
        index = len(self._nodes)
        self._single.append(single_buffer)
        self._nodes.append(node)

        def transmit(identifier: int, data: bytes, ready_ns: int) -> None:
            self._offer(identifier, data, ready_ns, index)

        node.connect(transmit)

    def send(self, identifier: int, data: bytes, ready_ns: int) -> None:
        """Offer a frame of the flight computer to the bus."""
        self._offer(identifier, data, ready_ns, _HOST)

    def request(self, identifier: int, size: int, ready_ns: int) -> None:
        """Offer a remote frame of the flight computer, that asks for ``size`` bytes."""
        self._offer(identifier, b"", ready_ns, _HOST, size)

    def advance(self, now_ns: int) -> list[WireFrame]:
        """Let everything happen that is due at ``now_ns``; returns what the flight computer's controller received."""
        nodes = self._nodes
        node_ns: int | None = None  # when the first of them acts; None: one of them has acted or received since
        while True:
            wire_ns = self._wire_due_ns()
            if node_ns is None:
                node_ns = min([node.due_ns for node in nodes], default=NEVER)
            if wire_ns > now_ns and node_ns > now_ns:
                break
            if node_ns <= wire_ns:
                for node in nodes:
                    if node.due_ns <= node_ns:
                        node.act(node_ns)
                node_ns = None
            elif self._on_wire is not None:
                self._end()
                node_ns = None
            else:
                self._begin(wire_ns)
        received, self._received = self._received, []
        return received

    def _offer(self, identifier: int, data: bytes, ready_ns: int, sender: int, asked: int | None = None) -> None:
        self._order += 1
        heapq.heappush(self._later, (ready_ns, _Waiting(identifier, self._order, data, sender, asked)))

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
        end_ns = start_ns + round(frame_bits(frame.identifier, frame.data, frame.asked) * self._bit_ns)
        self._on_wire = (end_ns, frame)
        self._idle_ns = end_ns + round(_INTERMISSION_BITS * self._bit_ns)

    def _contend(self, frame: _Waiting) -> None:
        if frame.sender != _HOST and self._single[frame.sender](frame.identifier):
            for place, waiting in enumerate(self._ready):
                if waiting.identifier == frame.identifier and waiting.sender == frame.sender:
                    self.overwritten[frame.identifier] += 1
                    self._ready[place] = frame._replace(order=waiting.order)
                    return
        heapq.heappush(self._ready, frame)

    def _end(self) -> None:
        if self._on_wire is None:
            return
        end_ns, (identifier, _, data, sender, asked) = self._on_wire
        self._on_wire = None
        if asked is None:
            is_pdo = 0x180 < identifier < 0x580
            for index, node in enumerate(self._nodes):
                if index != sender and (node.hears_process_data or not is_pdo):
                    node.receive(identifier, data, end_ns)
        else:
            for node in self._nodes:
                if isinstance(node, AnswersRemoteFrames):
                    node.remote(identifier, end_ns)
        if sender != _HOST:
            self._received.append(WireFrame(end_ns, identifier, data))


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
