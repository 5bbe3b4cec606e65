"""Decodes nIMU packets from bytes to words, many at once. No port, no clock.

DOC00290 rev J, table 3: FF FF FF FF, message size (26h), reserved, message id (14h), timer (big-endian u16, 2.1701 us),
2 reserved, 2 serial number, payload of big-endian int16 (gyro, accel, magnetometer, temperature, each x, y, z), and a
checksum.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, FrameError
from drivers.serial_line.frames import ReceivedBuffer

PACKET_BYTES = 38
MOST_PACKETS = 4096  # in one take
SYNC = b"\xff\xff\xff\xff"
HEADER = SYNC + bytes([PACKET_BYTES])
MESSAGE_ID = 0x14
TICK_NS = 2170.1
STANDARD_GRAVITY_M_S2 = 9.80665
CHECKSUM_SPANS = {
    "packet": 0,
    "after_sync": len(SYNC),
    "payload": 13,
}  # first byte summed; the last is the one before it

_ID_AT, _TIMER_AT, _PAYLOAD_AT, _CHECKSUM_AT = 6, 7, 13, 37
_HEADER_WORD = np.frombuffer(HEADER, np.uint8)


@dataclass(frozen=True)
class NimuConfig:
    """Configuration of a nIMU.

    Scales are 1.5 range / 32768; defaults are those of the 300 deg/s, 2 g model. The baud rate is set in the bus URL:
    the public drivers use 115200, the manual does not state it.

    Attributes:
        accel_range_g: Rated range, g; a sample beyond it is SATURATED.
        gyro_range_deg_s: Rated range, deg/s.
        accel_scale_g: Specific force per count, g.
        gyro_scale_deg_s: Angular rate per count, deg/s.
        magnetometer: Record the magnetometer too, as SCALAR channels ``NAME_mag_x``, ``_y``, ``_z``.
        magnetometer_scale_gauss: Flux density per count, gauss.
        checksum_span: Bytes the checksum covers: ``packet`` (all before it, as in the public drivers), ``after_sync``
            (without the FF FF FF FF), or ``payload`` (one reading of the manual).
        poll_period_ms: How often the port is read; 0: the port waits.
        silence_ms: Time without a packet after which the port is reopened.

    Raises:
        ConfigurationError: A value out of range.
    """

    accel_range_g: float = 2.0
    gyro_range_deg_s: float = 300.0
    accel_scale_g: float = 9.1553e-5
    gyro_scale_deg_s: float = 1.3733e-2
    magnetometer: bool = True
    magnetometer_scale_gauss: float = 8.6975e-5
    checksum_span: str = "packet"
    poll_period_ms: float = 20.0
    silence_ms: float = 500.0

    def __post_init__(self) -> None:
        positive = (self.accel_range_g, self.gyro_range_deg_s, self.accel_scale_g, self.gyro_scale_deg_s)
        if min(*positive, self.magnetometer_scale_gauss) <= 0.0:
            raise ConfigurationError("ranges and scales of a nIMU are more than 0: correct them")
        if self.checksum_span not in CHECKSUM_SPANS:
            raise ConfigurationError(f"checksum_span = {self.checksum_span!r}: use {', '.join(CHECKSUM_SPANS)}")


class Packets(NamedTuple):
    """Decoded words of successive packets.

    Attributes:
        timer: Timer counts, 2.1701 us each, modulo 65536, shape (n,).
        words: Gyro, accel, magnetometer, temperature, each x, y, z, shape (n, 12).
    """

    timer: NDArray[np.uint16]
    words: NDArray[np.int16]


class PacketStream(ReceivedBuffer):
    """Splits a byte stream into packets: ``receive`` bytes, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.

    Args:
        checksum_span: See ``NimuConfig``.
    """

    def __init__(self, checksum_span: str = "packet") -> None:
        super().__init__()
        self._span = checksum_span
        self._in_step = False  # the last take found packets where they were expected

    def take(self) -> Packets | None:
        """All whole packets up to the first bad place; None when more bytes are needed.

        Raises:
            FrameError: No packet at this place; bytes that cannot begin one were discarded, call ``take`` again.
        """
        count = min(len(self.waiting) // PACKET_BYTES, MOST_PACKETS if self._in_step else 1)
        whole = count * PACKET_BYTES
        if count:
            matrix = np.frombuffer(self.waiting, np.uint8, whole).reshape(count, PACKET_BYTES)
            good = _are_good(matrix, self._span)
            first_bad = count if good.all() else int(good.argmin())
            self._in_step = first_bad > 0
            if first_bad:
                self.waiting = self.waiting[first_bad * PACKET_BYTES :]
                return _words(matrix[:first_bad])
            raise FrameError(f"{_why_not(matrix[0], self._span)}; {self._skip(1)} bytes skipped")
        start = self.waiting[: len(HEADER)]
        if not HEADER.startswith(start):
            raise FrameError(f"no packet header; {self._skip(1)} bytes skipped: check baud rate and wiring")
        return None

    def _skip(self, first: int) -> int:
        """Discard bytes up to the next possible packet start at or after ``first``; returns their count."""
        place = self.waiting.find(HEADER, first)
        if place < 0:
            place = next(
                at
                for at in range(max(first, len(self.waiting) - len(SYNC)), len(self.waiting) + 1)
                if SYNC.startswith(self.waiting[at:])
            )
        self.waiting = self.waiting[place:]
        return place


def _are_good(matrix: NDArray[np.uint8], span: str) -> NDArray[np.bool_]:
    """Which of the rows (n, 38) are valid packets, shape (n,)."""
    header = (matrix[:, : len(HEADER)] == _HEADER_WORD).all(axis=1) & (matrix[:, _ID_AT] == MESSAGE_ID)
    return np.asarray(header & (_sum(matrix, span) == matrix[:, _CHECKSUM_AT]), np.bool_)


def _sum(matrix: NDArray[np.uint8], span: str) -> NDArray[np.uint8]:
    total: NDArray[np.uint8] = matrix[:, CHECKSUM_SPANS[span] : _CHECKSUM_AT].sum(axis=1, dtype=np.uint8)
    return total


def _words(matrix: NDArray[np.uint8]) -> Packets:
    timer = matrix[:, _TIMER_AT : _TIMER_AT + 2].copy().view(">u2")[:, 0].astype(np.uint16)
    words = matrix[:, _PAYLOAD_AT:_CHECKSUM_AT].copy().view(">i2").astype(np.int16)
    return Packets(timer, words)


def _why_not(packet: NDArray[np.uint8], span: str) -> str:
    if packet[: len(HEADER)].tobytes() != HEADER:
        return "no packet header (FF FF FF FF 26)"
    if packet[_ID_AT] != MESSAGE_ID:
        return f"message id {packet[_ID_AT]:#04x} is not {MESSAGE_ID:#04x}"
    row = packet[np.newaxis]
    other = [name for name in CHECKSUM_SPANS if _sum(row, name)[0] == packet[_CHECKSUM_AT]]
    hint = f" (it is that of checksum_span = {other[0]!r}: set it if this persists)" if other else ""
    return f"checksum {packet[_CHECKSUM_AT]:#04x} is not {_sum(row, span)[0]:#04x}{hint}"
