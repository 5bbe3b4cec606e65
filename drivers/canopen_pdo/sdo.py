"""Non-blocking CANopen SDO client: runs a sequence of reads and writes, with timeouts and retries.

A sequence is a generator that yields ``SdoRead`` and ``SdoWrite`` and is sent ``SdoData``; an abort is thrown into it
as ``SdoAbortError``, so that it can skip an object that the node does not have.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import NamedTuple

from drivers.canopen_pdo import frame
from drivers.errors import ConfigurationError, FrameError, NoAnswerError, SdoAbortError

TIMEOUT_NS = 500_000_000
TRIES = 3


@dataclass(frozen=True, slots=True)
class SdoRead:
    """Read an object."""

    index: int
    subindex: int = 0


@dataclass(frozen=True, slots=True)
class SdoWrite:
    """Write an object of one to four bytes."""

    index: int
    subindex: int
    data: bytes


class SdoData(NamedTuple):
    """What was read (empty after a write), and when the answer came (CLOCK_MONOTONIC, ns)."""

    data: bytes
    host_ns: int


Setup = Generator[SdoRead | SdoWrite, SdoData, None]


def read_unsigned(index: int, subindex: int = 0) -> Generator[SdoRead | SdoWrite, SdoData, int]:
    """Part of a sequence: read an object as an unsigned integer, little-endian."""
    reply = yield SdoRead(index, subindex)
    return int.from_bytes(reply.data, "little")


def write_unsigned(index: int, subindex: int, value: int, size: int) -> Generator[SdoRead | SdoWrite, SdoData, None]:
    """Part of a sequence: write an unsigned integer of ``size`` bytes."""
    yield SdoWrite(index, subindex, value.to_bytes(size, "little"))


def attempt(index: int, subindex: int, value: int, size: int) -> Generator[SdoRead | SdoWrite, SdoData, bool]:
    """Part of a sequence: write; True if the node accepted it."""
    try:
        yield from write_unsigned(index, subindex, value, size)
    except SdoAbortError:
        return False
    return True


def confirm(index: int, subindex: int, value: int, size: int) -> Generator[SdoRead | SdoWrite, SdoData, None]:
    """Part of a sequence: write an integer of ``size`` bytes, and read it back.

    Raises:
        SdoAbortError: The node refuses it.
        ConfigurationError: It took another value.
    """
    data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
    yield SdoWrite(index, subindex, data)
    reply = yield SdoRead(index, subindex)
    if reply.data[:size] != data:
        got = int.from_bytes(reply.data[:size], "little", signed=value < 0)
        raise ConfigurationError(
            f"{index:04X}h:{subindex:02X} was written {value} and reads {got}: its range or a write protection"
        )


def ensure_tpdo(
    number: int, cob_id: int, transmission: int, mapping: tuple[int, ...]
) -> Generator[SdoRead | SdoWrite, SdoData, None]:
    """Part of a sequence: a TPDO with this COB-ID, transmission type and mapping; written only where it differs.

    Args:
        number: 1..4.
        cob_id: 11 bits.
        transmission: 1..240 every n-th SYNC, 254 and 255 on events.
        mapping: Entries of 1A00h: index << 16 | subindex << 8 | bits.

    Raises:
        SdoAbortError: The node has another mapping and refuses to change it.
    """
    yield from ensure_pdo(0x1800 + number - 1, cob_id, transmission, mapping)


def ensure_rpdo(
    number: int, cob_id: int, transmission: int, mapping: tuple[int, ...]
) -> Generator[SdoRead | SdoWrite, SdoData, None]:
    """Part of a sequence: an RPDO, as ``ensure_tpdo`` has a TPDO. Raises SdoAbortError."""
    yield from ensure_pdo(0x1400 + number - 1, cob_id, transmission, mapping)


def ensure_pdo(
    communication: int, cob_id: int, transmission: int, mapping: tuple[int, ...]
) -> Generator[SdoRead | SdoWrite, SdoData, None]:
    """Part of a sequence: a PDO by its communication parameter; its mapping is 200h further. Raises SdoAbortError."""
    mapped = communication + 0x200
    present = []
    for place in range((yield from read_unsigned(mapped, 0))):
        present.append((yield from read_unsigned(mapped, place + 1)))
    old_cob_id = yield from read_unsigned(communication, 1)
    old_transmission = yield from read_unsigned(communication, 2)
    if (old_cob_id & ~frame.NO_RTR, old_transmission, tuple(present)) == (cob_id, transmission, mapping):
        return
    # CiA 301, 7.5.2.36: switch the PDO off, change it, switch it on
    flags = old_cob_id & frame.NO_RTR
    yield from write_unsigned(communication, 1, frame.NOT_VALID | flags | cob_id, 4)
    if old_transmission != transmission:
        yield from write_unsigned(communication, 2, transmission, 1)
    if tuple(present) != mapping:
        yield from write_unsigned(mapped, 0, 0, 1)
        for place, entry in enumerate(mapping):
            yield from write_unsigned(mapped, place + 1, entry, 4)
        yield from write_unsigned(mapped, 0, len(mapping), 1)
    yield from write_unsigned(communication, 1, flags | cob_id, 4)


class SdoClient:
    """Runs one sequence at a time against one node.

    Args:
        node: Node number.
        send: Sends a frame (COB-ID, data); may fail without raising, an unanswered request is sent again.

    Attributes:
        malformed: Answers that could not be decoded.
    """

    def __init__(self, node: int, send: Callable[[int, bytes], None]) -> None:
        self._node = node
        self._send = send
        self._sequence: Setup | None = None
        self._request: SdoRead | SdoWrite = SdoRead(0)
        self._deadline_ns = 0
        self._tries = 0
        self.malformed = 0

    @property
    def busy(self) -> bool:
        """A sequence is under way."""
        return self._sequence is not None

    def begin(self, sequence: Setup, now_ns: int) -> None:
        """Start a sequence; one under way is dropped."""
        self._sequence = sequence
        self._ask(next(sequence), now_ns)

    def accept(self, data: bytes, host_ns: int) -> None:
        """An SDO answer of the node; the next request goes out.

        Answers to other requests are ignored: after a repeated request the node answers twice.

        Raises:
            DriverError: Raised by the sequence, which has ended; includes an SdoAbortError that it did not catch.
        """
        sequence = self._sequence
        if sequence is None:
            return
        try:
            reply = frame.decode_sdo_reply(data)
        except FrameError:
            self.malformed += 1
            return
        request = self._request
        if (reply.index, reply.subindex) != (request.index, request.subindex):
            return
        if not reply.abort_code and reply.is_read is not isinstance(request, SdoRead):
            return
        if reply.abort_code:
            if reply.is_read:
                self._send(
                    frame.SDO_REQUEST + self._node,
                    frame.encode_sdo_abort(reply.index, reply.subindex, reply.abort_code),
                )
            refusal = self._refusal(reply.abort_code)
            self._advance(sequence, lambda: sequence.throw(refusal), host_ns)
        else:
            self._advance(sequence, lambda: sequence.send(SdoData(reply.data, host_ns)), host_ns)

    def poll(self, now_ns: int) -> None:
        """Repeat a request that was not answered in time.

        Raises:
            NoAnswerError: It was not answered ``TRIES`` times; the sequence is dropped.
        """
        if self._sequence is None or now_ns < self._deadline_ns:
            return
        if self._tries < TRIES:
            self._transmit(now_ns)
            return
        self._sequence = None
        index, subindex = self._request.index, self._request.subindex
        raise NoAnswerError(
            f"node {self._node} does not answer (SDO {index:04X}h:{subindex:02X}): check power and number"
        )

    def drop(self) -> None:
        """Drop the sequence under way."""
        self._sequence = None

    def _refusal(self, code: int) -> SdoAbortError:
        request = self._request
        verb = "read" if isinstance(request, SdoRead) else "write"
        why = frame.ABORT_TEXT.get(code, "see its manual")
        text = f"node {self._node} refuses to {verb} {request.index:04X}h:{request.subindex:02X}: {code:08X}h, {why}"
        return SdoAbortError(text, code)

    def _advance(self, sequence: Setup, step: Callable[[], SdoRead | SdoWrite], now_ns: int) -> None:
        self._sequence = None
        try:
            request = step()
        except StopIteration:
            return
        self._sequence = sequence
        self._ask(request, now_ns)

    def _ask(self, request: SdoRead | SdoWrite, now_ns: int) -> None:
        self._request = request
        self._tries = 0
        self._transmit(now_ns)

    def _transmit(self, now_ns: int) -> None:
        request = self._request
        if isinstance(request, SdoRead):
            data = frame.encode_sdo_read(request.index, request.subindex)
        else:
            data = frame.encode_sdo_write(request.index, request.subindex, request.data)
        self._tries += 1
        self._deadline_ns = now_ns + TIMEOUT_NS
        self._send(frame.SDO_REQUEST + self._node, data)
