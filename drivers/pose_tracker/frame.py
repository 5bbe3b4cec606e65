"""Decodes MAVLink 2 messages, and ATT_POS_MOCAP among them. No port, no clock.

A message is FDh, length n, incompatibility and compatibility flags, sequence, system, component, identifier (3 bytes,
little-endian), n bytes, CRC-16/MCRF4XX of all after FDh and of the message's CRC_EXTRA, and 13 bytes of signature where
flag 1 says so. Zeros at the end of its content are left out. The CRC can be checked only of messages whose CRC_EXTRA is
known; those that a motion capture bridge may send besides are read and left aside.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, FrameError
from drivers.records import POSE, Rows
from drivers.serial_line.frames import FrameSplitter, crc_reflected

START, HEADER_BYTES, CRC_BYTES, SIGNATURE_BYTES = 0xFD, 10, 2, 13
ATT_POS_MOCAP = 138
CRC_EXTRA = {0: 50, 2: 137, 111: 34, ATT_POS_MOCAP: 109}  # HEARTBEAT, SYSTEM_TIME, TIMESYNC
SHORT_BYTES, LONG_BYTES = HEADER_BYTES + 40 + CRC_BYTES, HEADER_BYTES + 120 + CRC_BYTES  # a covariance of NaN; one
SIGNED = 0x01
LATEST_US = 1 << 53  # of a time stamp: 285 years
_CONTENT = np.dtype(
    [("time_usec", "<u8"), ("quaternion", "<f4", (4,)), ("position_m", "<f4", (3,)), ("covariance", "<f4", (21,))]
)


@dataclass(frozen=True)
class PoseTrackerConfig:
    """Configuration of a pose tracker.

    Attributes:
        system: MAVLink system that sends the poses; 0: any.
        component: Its component; 0: any.
        poll_period_ms: How often the port is read; 0: the port waits.
        silence_ms: Time without a message after which the port is reopened.

    Raises:
        ConfigurationError: A number out of range.
    """

    system: int = 0
    component: int = 0
    poll_period_ms: float = 5.0
    silence_ms: float = 2000.0

    def __post_init__(self) -> None:
        if not (0 <= self.system <= 255 and 0 <= self.component <= 255):
            raise ConfigurationError(f"system = {self.system}, component = {self.component}: use 0 (any) to 255")


class Message(NamedTuple):
    """A message whose CRC is right."""

    sequence: int
    system: int
    component: int
    identifier: int
    content: bytes  # without zeros at its end


def crc(data: bytes, extra: int) -> int:
    """CRC-16/MCRF4XX (polynomial 1021h reflected, from FFFFh) of ``data`` and of the message's CRC_EXTRA."""
    return crc_reflected(data + bytes([extra]))


def decode_message(data: bytes) -> Message:
    """One whole message.

    Raises:
        FrameError: It is none, is not whole, has a wrong CRC or one that cannot be checked.
    """
    if len(data) < HEADER_BYTES + CRC_BYTES or data[0] != START:
        raise FrameError("no MAVLink 2 message (FDh): set the bridge to MAVLink 2, check baud rate and wiring")
    size, flags = data[1], data[2]
    end = HEADER_BYTES + size
    identifier = int.from_bytes(data[7:10], "little")
    if flags & ~SIGNED:
        raise FrameError(f"incompatibility flags {flags:#04x} of message {identifier}: only signatures are known")
    if identifier not in CRC_EXTRA:
        raise FrameError(f"message {identifier} is not known: have the bridge send ATT_POS_MOCAP (138) alone")
    if len(data) != end + CRC_BYTES + (SIGNATURE_BYTES if flags & SIGNED else 0):
        raise FrameError(f"{len(data)} bytes are no whole message {identifier}")
    told, found = int.from_bytes(data[end : end + CRC_BYTES], "little"), crc(data[1:end], CRC_EXTRA[identifier])
    if told != found:
        raise FrameError(f"CRC {told:#06x} of message {identifier} is not {found:#06x}: bytes were lost or changed")
    return Message(data[4], data[5], data[6], identifier, data[HEADER_BYTES:end])


def decode_pose(message: Message) -> Rows:
    """ATT_POS_MOCAP as one row of POSE, (1,); ``sequence``, ``host_ns`` and ``status`` are 0.

    Raises:
        FrameError: Another message, more content than it has, or a time that is none.
    """
    if message.identifier != ATT_POS_MOCAP or len(message.content) > _CONTENT.itemsize:
        raise FrameError(f"message {message.identifier} of {len(message.content)} bytes is no ATT_POS_MOCAP")
    content = np.frombuffer(message.content.ljust(_CONTENT.itemsize, b"\0"), _CONTENT)
    if content["time_usec"][0] >= LATEST_US:
        raise FrameError(f"a pose of {content['time_usec'][0]} us, which is no time: check the bridge's clock")
    row = np.zeros(1, POSE)
    row["tick"], row["link_sequence"] = content["time_usec"], message.sequence
    for field in ("position_m", "quaternion", "covariance"):
        row[field] = content[field]
    return row


def _size(data: bytes) -> int:
    """Of the message that ``data`` begins with; of a kind that cannot be checked, enough to name it."""
    if len(data) < HEADER_BYTES or int.from_bytes(data[7:10], "little") not in CRC_EXTRA or data[2] & ~SIGNED:
        return HEADER_BYTES + CRC_BYTES
    return HEADER_BYTES + data[1] + CRC_BYTES + (SIGNATURE_BYTES if data[2] & SIGNED else 0)


def message_stream() -> FrameSplitter[Message]:
    """Splits a byte stream into messages."""
    return FrameSplitter(START, _size, decode_message)
