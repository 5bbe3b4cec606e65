"""A node typed from docs/node_frame.md: packs with struct, a bitwise CRC, and COBS of its own."""

import struct

PACK = "BbHhIiq"  # by type code


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def stuffed(data: bytes) -> bytes:
    """COBS, from the paper: split at zeros, blocks of at most 254."""
    out = bytearray()
    parts = data.split(b"\0")
    for place, part in enumerate(parts):
        full = len(part) // 254 * 254
        for at in range(0, full, 254):
            out += b"\xff" + part[at : at + 254]
        if full == len(part) > 0 and place == len(parts) - 1:
            break
        out += bytes([len(part) - full + 1]) + part[full:]
    return bytes(out)


def framed(payload: bytes) -> bytes:
    """A frame with CRC and delimiter."""
    return stuffed(payload + crc16(payload).to_bytes(2, "big")) + b"\0"


class NodeModel:
    """A node; channels are (name, unit, type, flags, mantissa, exponent)."""

    def __init__(self, channels, node=1, tick_hz=1_000_000, boot=0) -> None:
        self.channels, self.node, self.tick_hz, self.boot = channels, node, tick_hz, boot
        self.sequence = self.pulse = self.pulse_tick = 0

    @property
    def body(self) -> bytes:
        body = struct.pack("<IB", self.tick_hz, len(self.channels))
        for name, unit, code, flags, mantissa, exponent in self.channels:
            body += struct.pack("<BBib8s16s", code, flags, mantissa, exponent, unit.encode(), name.encode())
        return body

    @property
    def schema(self) -> int:
        return crc16(self.body)

    def descriptor(self, tick: int) -> bytes:
        head = struct.pack("<BBHIQI", 0x11, self.node, self.schema, self.sequence, tick, self.boot)
        return framed(head + self.body)

    def edge(self, tick: int) -> None:
        self.pulse += 1
        self.pulse_tick = tick & 0xFFFFFFFF

    def data(self, tick: int, *values: int, status: int = 0) -> bytes:
        head = struct.pack(
            "<BBHIIIIB",
            *(0x10, self.node, self.schema, self.sequence & 0xFFFFFFFF, tick & 0xFFFFFFFF),
            *(self.pulse, self.pulse_tick, status),
        )
        types = "<" + "".join(PACK[channel[2]] for channel in self.channels)
        self.sequence += 1
        return framed(head + struct.pack(types, *values))
