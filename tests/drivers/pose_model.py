"""A motion capture bridge, typed from the MAVLink guide, and messages of the MAVLink project's own encoder.

Messages: made on 2026-11-22 by pymavlink 2.4.50 (github.com/ArduPilot/pymavlink, LGPL), dialect v20.common, system 7,
component 198: ``MAVLink_att_pos_mocap_message(...).pack(mav)``, numbers 41 and 42 of the link, a heartbeat, and number
44 with a signature of link 1, time 12345, key of 32 zeros. It is not installed with the tests (93 MB).
"""

import struct

WHOLE = bytes.fromhex(  # 1234567890123 us, (0.5, -0.5, 0.5, 0.5), (1.25, -2.5, 0.375) m, covariance 1e-6, 2e-6 .. 21e-6
    "fd7800002907c68a0000cb04fb711f0100000000003f000000bf0000003f0000003f0000a03f000020c00000c03ebd378635bd3706369c53"
    "4936bd378636acc5a7369c53c9368be1ea36bd370637b5fe1637acc52737a48c38379c534937931a5a378be16a3782a87b37bd378637399b"
    "8e37b5fe963730629f37acc5a7372829b037df9f"
)
SHORT = bytes.fromhex(  # 1234567900123 us, no turn, (1, 2, -3) mm, covariance NaN and zeros, which are not sent
    "fd2800002a07c68a0000db2bfb711f0100000000803f0000000000000000000000006f12833a6f12033ba69b44bb0000c07f964d"
)
HEARTBEAT = bytes.fromhex("fd0900002b07c6000000000000000608000403350c")
SIGNED = bytes.fromhex(
    "fd2801002c07c68a0000db2bfb711f0100000000803f0000000000000000000000006f12833a6f12033ba69b44bb0000c07f"
    "84860139300000000092bb244e98fe"
)


def x25(data: bytes) -> int:
    """Bit by bit, of the guide's description: reflected 1021h from FFFFh."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
    return crc


def message(content: bytes, identifier: int = 138, number: int = 0, system: int = 1, flags: int = 0) -> bytes:
    """Any message, its CRC by the extra of those that are known."""
    content = content.rstrip(b"\0") or b"\0"
    head = bytes([len(content), flags, 0, number % 256, system, 196]) + identifier.to_bytes(3, "little")
    extra = {0: 50, 2: 137, 111: 34, 138: 109}.get(identifier, 0)
    signature = bytes(13) if flags & 1 else b""
    return b"\xfd" + head + content + struct.pack("<H", x25(head + content + bytes([extra]))) + signature


def pose(number: int, time_us: int, place: float = 0.0, quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> bytes:
    """A pose at (place, 2, 3) m."""
    return message(struct.pack("<Q8f", time_us, *quaternion, place, 2.0, 3.0, float("nan")), 138, number)
