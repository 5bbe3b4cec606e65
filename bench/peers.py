"""The other ends of the wire, for fuzz.py and acquisition.py: frames the drivers accept, and ports in memory.

Typed from the same documents as the drivers, with none of their code. Only good devices: the fuzzer adds the damage.
"""

import binascii
import struct
from collections.abc import Callable

from cobs import cobs  # type: ignore[import-untyped]

from drivers.ports import CanFrame, Edge, I2cReply
from tests.drivers.dynamixel_model import crc

QSB_TICK_NS = 1_953_125
NIMU_HEADER = b"\xff\xff\xff\xff\x26"

# Node frame: kind, node, schema, sequence, tick, pulse, pulse tick, status (docs/node_frame.md)
_DATA = struct.Struct("<BBHIIIIB")
_DESCRIPTOR = struct.Struct("<BBHIQI")

# CANopen: (node, index, subindex): bytes. An encoder whose TPDO2 is set up, a load cell, a controller with a phase
# that is guarded, a drive.
OBJECTS: dict[tuple[int, int, int], bytes] = {
    (1, 0x1000, 0): (0x0002_0196).to_bytes(4, "little"),
    (1, 0x1017, 0): bytes(2),
    (1, 0x6000, 0): bytes(2),
    (1, 0x6501, 0): (500_000).to_bytes(4, "little"),
    (1, 0x6200, 0): bytes(2),
    (1, 0x1800, 1): (0x4000_0181).to_bytes(4, "little"),
    (1, 0x1801, 1): (0x4000_0281).to_bytes(4, "little"),
    (1, 0x1801, 2): b"\xfe",
    (1, 0x1A01, 0): b"\1",
    (1, 0x1A01, 1): (0x6004_0020).to_bytes(4, "little"),
    (2, 0x1000, 0): (0x0002_0194).to_bytes(4, "little"),
    (2, 0x1017, 0): bytes(2),
    (2, 0x6131, 1): (0x0021_0000).to_bytes(4, "little"),
    (2, 0x6132, 1): b"\4",
    (2, 0x1800, 1): (0x182).to_bytes(4, "little"),
    (2, 0x1800, 2): b"\1",
    (2, 0x1A00, 0): b"\2",
    (2, 0x1A00, 1): (0x9130_0120).to_bytes(4, "little"),
    (2, 0x1A00, 2): (0x6150_0108).to_bytes(4, "little"),
    (3, 0x1000, 0): bytes(4),
    (3, 0x100C, 0): bytes(2),
    (3, 0x100D, 0): bytes(1),
    (3, 0x2000, 1): b"\7",
    (3, 0x1A00, 0): b"\1",
    (3, 0x1A00, 1): (0x2000_0108).to_bytes(4, "little"),
    (4, 0x1000, 0): (0x0002_0192).to_bytes(4, "little"),
    (4, 0x1017, 0): bytes(2),
    (4, 0x6076, 0): (1_270).to_bytes(4, "little"),
    (4, 0x1800, 1): (0x184).to_bytes(4, "little"),
    (4, 0x1800, 2): b"\1",
    (4, 0x1A00, 0): b"\2",
    (4, 0x1A00, 1): (0x6064_0020).to_bytes(4, "little"),
    (4, 0x1A00, 2): (0x606C_0020).to_bytes(4, "little"),
    (4, 0x1801, 1): (0x284).to_bytes(4, "little"),
    (4, 0x1801, 2): b"\1",
    (4, 0x1A01, 0): b"\1",
    (4, 0x1A01, 1): (0x6077_0010).to_bytes(4, "little"),
}


class Clock:
    """CLOCK_MONOTONIC that the caller advances."""

    def __init__(self, now_ns: int = 10_000_000_000) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        """CLOCK_MONOTONIC, ns."""
        return self.now_ns


class MemorySerial:
    """A ``SerialPort`` in memory.

    Args:
        answer: What comes back for what is written.
        fail_at: Number of the call that raises OSError, from 1; 0: none.
    """

    def __init__(self, answer: Callable[[bytes], bytes] = lambda _: b"", fail_at: int = 0) -> None:
        self.answer = answer
        self.waiting = b""
        self._fail_in = fail_at

    @property
    def in_waiting(self) -> int:
        """Bytes waiting."""
        self._call()
        return len(self.waiting)

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` bytes."""
        self._call()
        data, self.waiting = self.waiting[:size], self.waiting[size:]
        return data

    def write(self, data: bytes, /) -> int:
        """Send ``data``."""
        self._call()
        self.waiting += self.answer(data)
        return len(data)

    def close(self) -> None:
        """Discards unread bytes."""
        self.waiting = b""

    def _call(self) -> None:
        self._fail_in -= 1
        if self._fail_in == 0:
            raise OSError(5, "Input/output error")


class MemoryCan:
    """A ``CanPort`` in memory; ``answering`` nodes put their SDO answers into ``waiting``, with the clock's stamp."""

    def __init__(self, clock: Clock, *, answering: bool = True) -> None:
        self.clock = clock
        self.answering = answering
        self.waiting: list[CanFrame] = []
        self._toggle = 0

    def send(self, identifier: int, data: bytes) -> None:
        """Queue one frame."""
        answer = sdo_answer(identifier, data) if self.answering else None
        if answer is not None:
            self.waiting.append(CanFrame(self.clock(), *answer))

    def request(self, identifier: int, size: int) -> None:
        """A remote frame: a guarded node says that it is operational."""
        del size
        if self.answering:
            self.waiting.append(CanFrame(self.clock(), identifier, bytes([self._toggle | 5])))
            self._toggle ^= 0x80

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All frames waiting."""
        del timeout_s
        frames, self.waiting = self.waiting, []
        return frames

    def mute(self) -> None:
        """Take no more."""

    def close(self) -> None:
        """Leave."""


class MemoryPulses:
    """A ``PulsePort`` in memory; while ``fails`` it raises."""

    def __init__(self) -> None:
        self.waiting: list[Edge] = []
        self.fails = False

    def receive(self, timeout_s: float) -> list[Edge]:
        """All edges waiting."""
        del timeout_s
        if self.fails:
            raise OSError(5, "Input/output error")
        edges, self.waiting = self.waiting, []
        return edges

    def close(self) -> None:
        """Leave."""


class MemoryMpu6050:
    """An ``I2cPort`` with one chip: registers that hold what is written, and a FIFO that is filled from outside.

    Attributes:
        registers: What they hold.
        fifo: Bytes in the FIFO; an empty one repeats its last byte.
        count: What FIFO_COUNT says instead; None: the truth.
        fail_in: Transfers until one raises OSError; 0: none does.
        code: Its errno.
        transfer_ns: Time a transfer takes, ns.
    """

    def __init__(self, clock: Clock, identity: int = 0x68, transfer_ns: int = 0) -> None:
        self.clock = clock
        self.transfer_ns = transfer_ns
        self.registers = bytearray(128)
        self.registers[0x75] = identity
        self.fifo = b""
        self.count: int | None = None
        self.fail_in = 0
        self.code = 5

    def write(self, address: int, data: bytes) -> None:
        """Write a register."""
        self._transfer(address)
        register, value = data
        if register == 0x6B and value & 0x80:
            value = 0x40
        self.registers[register] = value

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """Read registers, or pop the FIFO."""
        self._transfer(address)
        register = data[0]
        if register == 0x74:
            reply, self.fifo = self.fifo[:count], self.fifo[count:]
            return I2cReply(reply.ljust(count, b"\0"), self.clock())
        queued = min(len(self.fifo), 0xFFFF) if self.count is None else self.count
        self.registers[0x72:0x74] = queued.to_bytes(2, "big")
        reply = bytes(self.registers[register : register + count])
        if register == 0x3A:
            self.registers[0x3A] = 0
        return I2cReply(reply.ljust(count, b"\0"), self.clock())

    def close(self) -> None:
        """Leave."""

    def _transfer(self, address: int) -> None:
        del address
        self.clock.now_ns += self.transfer_ns
        self.fail_in = max(0, self.fail_in - 1) if self.fail_in != 1 else -1
        if self.fail_in < 0:
            self.fail_in = 0
            raise OSError(self.code, "transfer failed")


def sdo_answer(identifier: int, data: bytes) -> tuple[int, bytes] | None:
    """What the node of ``OBJECTS`` answers to an SDO request; None to anything else."""
    node = identifier - 0x600
    if not 1 <= node <= 4:
        return None
    command, index, subindex = struct.unpack_from("<BHB", data)
    head = data[1:4]
    value = OBJECTS.get((node, index, subindex))
    if command == 0x40 and value is not None:
        return 0x580 + node, bytes([0x43 | (4 - len(value)) << 2]) + head + value.ljust(4, b"\0")
    if command == 0x40:
        return 0x580 + node, b"\x80" + head + (0x0602_0000).to_bytes(4, "little")
    return 0x580 + node, b"\x60" + head + bytes(4)


def can_round(number: int) -> list[tuple[int, bytes]]:
    """SYNC ``number`` and the TPDOs of encoder and load cell that answer it."""
    position = (250_000 + 100 * number) & 0xFFFF_FFFF
    force = 12_345 + number % 100
    return [
        (0x080, bytes([number % 240 + 1])),
        (0x281, position.to_bytes(4, "little")),
        (0x182, force.to_bytes(4, "little") + b"\0"),
    ]


def mpu6050_packets(first: int, count: int) -> bytes:
    """FIFO packets: accel, temperature, gyro; they differ, and the temperature does not jump."""
    return b"".join(
        struct.pack(">7h", number % 997, -number % 991, 8192, -3920, number % 100, -7, 3)
        for number in range(first, first + count)
    )


def nimu_summed(packet: bytes, first: int = 0) -> bytes:
    """A packet with its checksum put right; it sums from byte ``first`` on."""
    return packet[:37] + bytes([sum(packet[first:37]) % 256]) + packet[38:]


def qsb_line(kind: str, register: int, data: int, tick: int) -> bytes:
    """A line of 26 bytes."""
    return f"{kind} {register:02X} {data & 0xFFFFFFFF:08X} {tick & 0xFFFFFFFF:08X} !\r\n".encode()


def qsb_answer(command: bytes, tick: int) -> bytes:
    """What an adapter answers to a command: the echo of a write, the content of a register."""
    text = command.decode("ascii").strip()
    register = int(text[1:3], 16)
    data = int(text[3:] or "0", 16) if text[0] == "W" else {0x14: 0x0001_2005}.get(register, 0)
    return qsb_line(text[0].lower(), register, data, tick)


def dynamixel_packet(head: str, data: bytes) -> bytes:
    """A packet of DYNAMIXEL protocol 2.0, or the next part of one: bytes in hex, data, CRC over all of it."""
    packet = bytes.fromhex(head) + data
    return packet + crc(packet)


def node_framed(payload: bytes) -> bytes:
    """A node frame on the wire: payload, CRC-16/CCITT-FALSE, COBS, delimiter."""
    return bytes(cobs.encode(payload + binascii.crc_hqx(payload, 0xFFFF).to_bytes(2, "big"))) + b"\0"


def node_descriptor(names: tuple[str, ...], sequence: int, tick: int) -> bytes:
    """Payload of a descriptor without CRC: node 1, 1 MHz, channels of 32 bits, the first of them a counter."""
    body = struct.pack("<IB", 1_000_000, len(names))
    for place, name in enumerate(names):
        body += struct.pack("<BBib8s16s", 5, int(place == 0), 5, -3, b"N", name.encode())
    return _DESCRIPTOR.pack(0x11, 1, binascii.crc_hqx(body, 0xFFFF), sequence, tick, 1) + body


def node_data(schema: int, sequence: int, tick: int, values: tuple[int, ...], pulse: int = 0) -> bytes:
    """Payload of a data frame without CRC."""
    head = _DATA.pack(0x10, 1, schema, sequence & 0xFFFFFFFF, tick & 0xFFFFFFFF, pulse, tick & 0xFFFFFFFF, 0)
    return head + struct.pack(f"<{len(values)}i", *values)


def node_schema(descriptor: bytes) -> int:
    """The schema that a descriptor's channel list has."""
    return binascii.crc_hqx(descriptor[_DESCRIPTOR.size :], 0xFFFF)
