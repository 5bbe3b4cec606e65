"""A Robotous sensor under fuzz, by its decoder and by the device; its seeds."""

import contextlib
import struct

from bench import peers
from bench.fuzzing.laws import STEPS_NS, drive, exhaust, leading, spoken
from drivers import robotous_rft
from drivers.errors import FrameError
from drivers.robotous_rft import RftConfig, RobotousRft
from drivers.serial_line.scalars import WrenchChannel


def _packet(field: bytes) -> bytes:
    field = field[:16].ljust(16, b"\0")
    return b"\x55" + field + bytes([sum(field) & 0xFF, 0xAA])


def robotous(data: bytes) -> None:
    """Packets by the decoder and by the device, whose questions are answered as the bytes say, or not."""
    (how, which, fail_at), body = leading(data, 3)
    if which & 0x80:  # sums and ends are put right
        at = body.find(b"\x55")
        while at >= 0:
            body = body[:at] + _packet(body[at + 1 : at + 17]) + body[at + 19 :]
            at = body.find(b"\x55", at + 19)
    with contextlib.suppress(FrameError):
        robotous_rft.decode_packet(body[: robotous_rft.PACKET_BYTES])
    exhaust(robotous_rft.rft_stream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    if not which & 0x40:
        said = bytes([which & 8, which >> 1 & 3])
        port.answer = lambda command: b"" if command[1] in (11, 12, 17) else _packet(command[1:2] + said)
    channels = [WrenchChannel("fx", 0, "N"), WrenchChannel("tz", 5, "N m")]
    device = RobotousRft("wrist", channels, lambda: port, clock, RftConfig((200.0, 1000.0)[which & 1]))
    drive(device, clock, spoken(port, body, how), STEPS_NS[which >> 4 & 3])


def _seeds() -> list[bytes]:
    samples = [_packet(struct.pack(">B6hB", 11, at, 0, -1, 0, 0x5555, 32767, at & 8)) for at in range(60)]
    again = b"".join(samples[:4])
    return [
        b"\0\0\0" + b"".join(samples[:40]),
        b"\x03\x90\0" + b"".join(samples[:30]) + again,
        b"\0\x40\0" + _packet(b"\1RFT80-6A01") + _packet(b"\x10\0") + _packet(b"\x09\1\1") + _packet(b"\x08\1") + again,
        b"\x05\xa9\x09" + again[:50] + b"".join(samples[30:50]) + again,
    ]


SEEDS = _seeds()
