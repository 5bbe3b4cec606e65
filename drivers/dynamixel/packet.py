"""DYNAMIXEL protocol 2.0 as a master speaks it: instruction packets, and the answer to one of them. No port, no clock.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0" (packet, processing order, Sync Read, Fast Sync Read) and "CRC
Calculation". The CRC of each block of a Fast Sync Read is over all that stands before it in the packet, CRCs included,
as its example shows.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.errors import ConfigurationError, FrameError

HEADER = b"\xff\xff\xfd"
BROADCAST, LARGEST_ID = 0xFE, 0xFC
PING, READ, WRITE, SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, STATUS = 0x01, 0x02, 0x03, 0x82, 0x83, 0x8A, 0x55
PING_BYTES = 3  # of its answer: model number and firmware
ALERT = 0x80  # of the error byte: Hardware Error Status is not 0
HEAD = 7  # header, reserved, id, length
ERRORS = {
    1: "it failed",
    2: "it does not know the instruction",
    3: "the CRC was wrong",
    4: "a value out of its range",
    5: "wrong length of data",
    6: "a value beyond its limit",
    7: "no access to that address",
}


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_TABLE = _crc_table()


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC-16/BUYPASS of ``data``, after that of what precedes it; FEE8h for ``123456789``. Sent low byte first."""
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def _packet(identifier: int, instruction: int, parameters: bytes) -> bytes:
    """An instruction packet with its length, stuffing and CRC."""
    body = (bytes([instruction]) + parameters).replace(HEADER, HEADER + b"\xfd")
    packet = HEADER + bytes([0, identifier]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def read_request(identifier: int, address: int, count: int) -> bytes:
    """Read ``count`` bytes of one servo's control table from ``address`` on.

    Raises:
        ConfigurationError: An argument outside the range of the protocol.
    """
    _check([identifier], address, count)
    return _packet(identifier, READ, address.to_bytes(2, "little") + count.to_bytes(2, "little"))


def write_request(identifier: int, address: int, data: bytes) -> bytes:
    """Write one servo's control table from ``address`` on; it answers without data.

    Raises:
        ConfigurationError: An argument outside the range of the protocol.
    """
    _check([identifier], address, len(data))
    return _packet(identifier, WRITE, address.to_bytes(2, "little") + data)


def sync_write_request(address: int, blocks: Mapping[int, bytes]) -> bytes:
    """Write as many bytes to each of several servos, which take them at once and do not answer.

    Args:
        address: Of the first byte.
        blocks: Bytes by ID, of one length.

    Raises:
        ConfigurationError: An argument outside the range of the protocol.
    """
    (count,) = {len(data) for data in blocks.values()}
    _check(list(blocks), address, count)
    parameters = b"".join(bytes([identifier]) + data for identifier, data in blocks.items())
    return _packet(BROADCAST, SYNC_WRITE, address.to_bytes(2, "little") + count.to_bytes(2, "little") + parameters)


def ping_request() -> bytes:
    """Ask every servo who it is; each answers 3 ms later than the ID before its own."""
    return _packet(BROADCAST, PING, b"")


def sync_read_request(identifiers: Sequence[int], address: int, count: int, *, fast: bool = False) -> bytes:
    """Read the same ``count`` bytes of several servos, which answer in this order; ``fast``: in one packet.

    Raises:
        ConfigurationError: An argument outside the range of the protocol.
    """
    _check(identifiers, address, count)
    parameters = address.to_bytes(2, "little") + count.to_bytes(2, "little") + bytes(identifiers)
    return _packet(BROADCAST, FAST_SYNC_READ if fast else SYNC_READ, parameters)


def _check(identifiers: Sequence[int], address: int, count: int) -> None:
    known = all(0 <= identifier <= LARGEST_ID for identifier in identifiers)
    if not (identifiers and known and len(set(identifiers)) == len(identifiers)):
        raise ConfigurationError(f"ids {list(identifiers)}: give each once, 0 to {LARGEST_ID}")
    if not (0 <= address <= 0xFFFF and 1 <= count <= 1000):
        raise ConfigurationError(f"{count} bytes from address {address}: use 1 to 1000 bytes, addresses to 65535")


def answer_bytes(servos: int, count: int, *, fast: bool) -> int:
    """Bytes of a whole answer, without stuffing."""
    return HEAD + 1 + servos * (count + 4) if fast else servos * (HEAD + 4 + count)


class Block(NamedTuple):
    """What one servo answered: its error byte, and the bytes asked for (none where it refused)."""

    identifier: int
    error: int
    data: bytes


class Reply:
    """Gathers the answer to one request, in pieces.

    Instruction packets are passed over: an adapter may hear what it sends.

    Args:
        identifiers: Servos that were asked, in order.
        count: Bytes that each was asked for; 0 of a write.
        fast: The request was a Fast Sync Read.

    Attributes:
        blocks: What came so far, each with a right CRC.
    """

    def __init__(self, identifiers: Sequence[int], count: int, *, fast: bool = False) -> None:
        self.blocks: list[Block] = []
        self._pending = list(identifiers)
        self._count, self._fast = count, fast
        self._buffer = b""
        self._inside = 0  # the first so many bytes of a Fast Sync Read's packet are decoded,
        self._crc = 0  # and this is their CRC

    @property
    def missing(self) -> int:
        """Bytes still to come, at the least, if no servo refuses or is silent."""
        head = 0 if self._inside or not self._fast else HEAD + 1
        rest = len(self._pending) * (self._count + 4 if self._fast else HEAD + 4 + self._count)
        return max(1, head + rest - (len(self._buffer) - self._inside))

    def receive(self, data: bytes) -> bool:
        """More bytes; whether the answer is whole.

        Raises:
            FrameError: The bytes are not the answer to this request; wait for silence before the next one.
        """
        self._buffer += data
        while self._pending and (self._take_fast() if self._inside else self._take()):
            pass
        if not self._pending and len(self._buffer) > self._inside:
            raise FrameError(f"{len(self._buffer) - self._inside} bytes after the answer: is another master there?")
        return not self._pending

    def _take(self) -> bool:
        """Decode a packet, or the head of a Fast Sync Read's; whether there is more to do."""
        buffer = self._buffer
        if not buffer[:3] == HEADER[: len(buffer)] or buffer[3:4] not in (b"", b"\0"):
            raise FrameError(f"{buffer[:4].hex(' ')} begins no packet: bytes were lost, or the baud rate is another")
        if len(buffer) <= HEAD:
            return False
        identifier, length, instruction = buffer[4], int.from_bytes(buffer[5:7], "little"), buffer[7]
        if instruction == STATUS and self._fast:
            if (identifier, length) != (BROADCAST, answer_bytes(len(self._pending), self._count, fast=True) - HEAD):
                raise FrameError(f"{length} bytes of id {identifier}: it is late, or not of a Fast Sync Read")
            self._inside = HEAD + 1
            self._crc = crc16(buffer[: HEAD + 1])
            return True
        longest = 3 * self._count // 2 + 8 if instruction == STATUS else 1000
        if not 3 <= length <= longest:
            raise FrameError(f"a packet of {length} bytes: it is late, or bytes were lost")
        if len(buffer) < HEAD + length:
            return False
        packet, self._buffer = buffer[: HEAD + length], buffer[HEAD + length :]
        if crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            raise FrameError(f"CRC of id {identifier} is wrong: check wiring, termination and baud rate")
        if instruction == STATUS:
            self._accept(identifier, packet[HEAD + 1 : -2].replace(HEADER + b"\xfd", HEADER))
        return bool(self._buffer)

    def _accept(self, identifier: int, content: bytes) -> None:
        """Take error byte and data of a status packet."""
        if identifier not in self._pending:
            raise FrameError(f"id {identifier} answers and was not asked: give each servo a different id")
        if len(content) not in (1, 1 + self._count) or (len(content) == 1 and self._count and not content[0] & ~ALERT):
            raise FrameError(f"id {identifier} sent {len(content) - 1} bytes, not {self._count}: it is late")
        del self._pending[: self._pending.index(identifier) + 1]  # they answer in order: those before it are silent
        self.blocks.append(Block(identifier, content[0], content[1:]))

    def _take_fast(self) -> bool:
        """Decode the next servo's part of a Fast Sync Read's packet; it has no stuffing."""
        end = self._inside + self._count + 4
        if len(self._buffer) < end:
            return False
        error, identifier, *data = self._buffer[self._inside : end - 2]
        if identifier != self._pending[0]:
            raise FrameError(f"id {identifier} where {self._pending[0]} answers: bytes were lost, or it is late")
        crc = crc16(self._buffer[self._inside : end - 2], self._crc)
        if crc != int.from_bytes(self._buffer[end - 2 : end], "little"):
            raise FrameError(f"CRC of id {identifier} is wrong: check wiring, termination and baud rate")
        self._crc = crc16(self._buffer[end - 2 : end], crc)
        self.blocks.append(Block(identifier, error, bytes(data)))
        del self._pending[0]
        self._inside = end
        return True


def statuses(data: bytes) -> list[Block]:
    """Status packets with a right CRC, wherever they are in some bytes; all else is passed over."""
    found = []
    at = data.find(HEADER)
    while at >= 0:
        end = at + HEAD + int.from_bytes(data[at + 5 : at + HEAD], "little")
        packet = data[at:end]
        whole = len(data) >= end >= at + HEAD + 4
        if whole and packet[HEAD] == STATUS and crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little"):
            content = packet[HEAD + 2 : -2].replace(HEADER + b"\xfd", HEADER)
            found.append(Block(packet[4], packet[HEAD + 1], content))
        else:
            end = at + 1
        at = data.find(HEADER, end)
    return found
