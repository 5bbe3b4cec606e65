"""CANopen frames (CiA 301): COB-IDs, and the data of each service. Bytes in, a value or ``FrameError`` out."""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from drivers.errors import FrameError

NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080  # + node, and so on below
TPDO = (0, 0x180, 0x280, 0x380, 0x480)
SDO_REPLY = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700

NOT_VALID = 0x8000_0000  # bit 31 of a PDO's COB-ID entry: the PDO is switched off
NO_RTR = 0x4000_0000

SYNC_COUNTER_MOST = 240  # 1019h

_HEADER = struct.Struct("<BHB")
_ABORT = struct.Struct("<BHBI")
_EMERGENCY = struct.Struct("<HB5s")

ABORT_TEXT = {  # CiA 301, 7.2.4.3.17
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    0x0504_0001: "command not known",
    0x0601_0000: "access not supported",
    0x0601_0001: "write only",
    0x0601_0002: "read only",
    0x0602_0000: "no such object",
    0x0604_0041: "cannot be mapped to a PDO",
    0x0604_0042: "PDO length exceeded",
    0x0604_0043: "parameter incompatible",
    0x0606_0000: "hardware error",
    0x0607_0010: "wrong data type or length",
    0x0609_0011: "no such subindex",
    0x0609_0030: "value out of range",
    0x060A_0023: "resource not available",
    0x0800_0000: "general error",
    0x0800_0020: "cannot be stored",
    0x0800_0021: "local control",
    0x0800_0022: "not in this device state",
}
COMMAND_NOT_KNOWN = 0x0504_0001


class NmtCommand(IntEnum):
    """Command of an NMT frame (CiA 301, 7.2.8.3.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80


class NmtState(IntEnum):
    """State in a heartbeat (CiA 301, 7.2.8.3.2.2)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Emergency(NamedTuple):
    """An EMCY: error code (0: errors are over), error register 1001h, five bytes of the maker's."""

    code: int
    register: int
    vendor: bytes


@dataclass(frozen=True, slots=True)
class SdoReply:
    """Answer of an SDO server. ``data`` after a read, empty after a write; ``abort_code`` 0 unless refused."""

    index: int
    subindex: int
    data: bytes
    abort_code: int
    is_read: bool


def encode_nmt(command: NmtCommand, node: int) -> bytes:
    """Data of an NMT frame; node 0 means all."""
    return bytes((command, node))


def decode_heartbeat(data: bytes) -> NmtState:
    """State in a heartbeat or boot-up message.

    Raises:
        FrameError: Not one byte, or no state.
    """
    try:
        (state,) = data
        return NmtState(state & 0x7F)
    except ValueError as error:
        raise FrameError(f"{data.hex(' ')} is no heartbeat: look for a second node with this number") from error


def decode_sync(data: bytes) -> int:
    """Counter of a SYNC, 1..240; 0 when it carries none.

    Raises:
        FrameError: Longer than one byte, or a counter out of range.
    """
    if not data:
        return 0
    if len(data) != 1 or not 1 <= data[0] <= SYNC_COUNTER_MOST:
        raise FrameError(f"{data.hex(' ')} is no SYNC: its counter is a byte, 1..240 (1019h)")
    return data[0]


def decode_emergency(data: bytes) -> Emergency:
    """An EMCY message.

    Raises:
        FrameError: Not eight bytes.
    """
    if len(data) != _EMERGENCY.size:
        raise FrameError(f"{data.hex(' ')} is no EMCY: it has eight bytes")
    return Emergency(*_EMERGENCY.unpack(data))


def encode_sdo_read(index: int, subindex: int) -> bytes:
    """Request to read an object."""
    return _HEADER.pack(0x40, index, subindex) + bytes(4)


def encode_sdo_write(index: int, subindex: int, data: bytes) -> bytes:
    """Request to write an object of one to four bytes (expedited, size given).

    Raises:
        FrameError: Data of another length.
    """
    if not 1 <= len(data) <= 4:
        raise FrameError(f"{len(data)} bytes do not fit an expedited SDO: write 1..4")
    return _HEADER.pack(0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")


def encode_sdo_abort(index: int, subindex: int, code: int) -> bytes:
    """SDO abort from the client."""
    return _ABORT.pack(0x80, index, subindex, code)


def decode_sdo_reply(data: bytes) -> SdoReply:
    """Answer of an SDO server to a read or a write.

    An object too long for an expedited transfer is returned with abort code ``COMMAND_NOT_KNOWN``, which the client
    must send to the server to end the segmented transfer.

    Raises:
        FrameError: Not eight bytes, or not the command of an answer to a read or a write.
    """
    if len(data) != 8:
        raise FrameError(f"{data.hex(' ')} is no SDO: it has eight bytes")
    command, index, subindex = _HEADER.unpack_from(data)
    if command == 0x60:
        return SdoReply(index, subindex, b"", 0, False)
    if command == 0x80:
        return SdoReply(index, subindex, b"", _ABORT.unpack(data)[3], False)
    if command & 0xF0 == 0x40:
        if not command & 0x02:
            return SdoReply(index, subindex, b"", COMMAND_NOT_KNOWN, True)
        size = 4 - (command >> 2 & 3) if command & 0x01 else 4
        return SdoReply(index, subindex, data[4 : 4 + size], 0, True)
    raise FrameError(f"{data.hex(' ')} is not an SDO answer: look for a second SDO client on the bus")
