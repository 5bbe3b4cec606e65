"""Frames and answers of the sensor. No port, no clock.

A frame is AAh, 34 bytes of content, little-endian, and their CRC-16/X-25 (polynomial 1021h reflected, from FFFFh,
inverted), low byte first. Answers are text: ``r,0,COMMAND,CODE``; code 0 is done. After power-up it says "App Init".
"""

import binascii
import re

import numpy as np

from drivers.errors import FrameError

START, CONTENT_BYTES, FRAME_BYTES = 0xAA, 34, 37
FRAME = np.dtype(
    [
        ("start", "u1"),
        ("status", "<u2"),
        ("wrench", "<f4", (6,)),  # force along x, y, z [N], moment about them [N m]
        ("time_us", "<u4"),  # since power-up
        ("temperature_c", "<f4"),
        ("crc", "<u2"),
    ]
)
SKIPS, OVERRANGE, INVALID, RAW = 1, 2, 4, 8  # of the status: measurements left out, beyond range, invalid, uncalibrated
BOOTED = b"App Init"
_ANSWER = re.compile(rb"r,0,(.),(\d+)")
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc(content: bytes) -> int:
    """CRC-16/X-25."""
    mirrored = binascii.crc_hqx(content.translate(_REVERSED), 0xFFFF)
    return int(f"{mirrored:016b}"[::-1], 2) ^ 0xFFFF


def decode_frame(data: bytes) -> bytes:
    """The bytes of one whole frame of ``FRAME``, checked.

    Raises:
        FrameError: It is none, or its CRC is wrong.
    """
    if len(data) != FRAME_BYTES or data[0] != START:
        raise FrameError("no frame of 37 bytes that begins with AAh: check the baud rate (460,800) and the wiring")
    said, found = int.from_bytes(data[-2:], "little"), crc(data[1 : 1 + CONTENT_BYTES])
    if said != found:
        raise FrameError(f"CRC {said:#06x} is not {found:#06x}: bytes were lost or changed")
    return data


def answer(text: bytes, command: bytes) -> tuple[int, int] | None:
    """The code that a command is answered with, and where in ``text`` the answer ends; None: it is not there yet."""
    for found in _ANSWER.finditer(text):
        if found[1] == command[:1]:
            return int(found[2]), found.end()
    return None


class WrenchStream:
    """Splits a byte stream into frames: ``receive`` bytes, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.
    """

    def __init__(self) -> None:
        self._buffer = b""

    def receive(self, data: bytes) -> None:
        """Append bytes."""
        self._buffer += data

    @property
    def waiting(self) -> int:
        """Bytes that are not taken yet."""
        return len(self._buffer)

    def clear(self) -> None:
        """Drop a partial frame: the stream was interrupted."""
        self._buffer = b""

    def take(self) -> bytes | None:
        """The next frame; None when more bytes are needed.

        Raises:
            FrameError: No frame at this place; bytes that cannot begin one were discarded, call ``take`` again.
        """
        if not self._buffer or (self._buffer[0] == START and len(self._buffer) < FRAME_BYTES):
            return None
        try:
            frame = decode_frame(self._buffer[:FRAME_BYTES])
        except FrameError as error:
            place = self._buffer.find(START, 1)
            skipped = len(self._buffer) if place < 0 else place
            self._buffer = self._buffer[skipped:]
            raise FrameError(f"{error}; {skipped} bytes skipped") from None
        self._buffer = self._buffer[FRAME_BYTES:]
        return frame
