"""Frames and answers of the sensor. No port, no clock.

A frame is AAh, 34 bytes of content, little-endian, and their CRC-16/X-25 (polynomial 1021h reflected, from FFFFh,
inverted), low byte first. Answers are text: ``r,0,COMMAND,CODE``; code 0 is done. After power-up it says "App Init".
"""

import re

import numpy as np

from drivers.errors import FrameError
from drivers.serial_line.frames import FrameSplitter, crc_reflected

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


def crc(content: bytes) -> int:
    """CRC-16/X-25."""
    return crc_reflected(content) ^ 0xFFFF


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


def wrench_stream() -> FrameSplitter[bytes]:
    """Splits a byte stream into frames."""
    return FrameSplitter(START, lambda _: FRAME_BYTES, decode_frame)
