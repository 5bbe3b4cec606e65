"""Decodes QSB lines from ASCII to numbers, many at once. No port, no clock.

As configured here (EOR = Fh) a line is 26 bytes, ``s 0E 0001F4A2 00001234 !`` CR LF: kind, register, data, timestamp.
Before set-up and after a reset, lines may lack spaces, timestamp, CR and LF; all end with ``!``.
"""

import binascii
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError
from drivers.serial_line.frames import ReceivedBuffer

LINE_BYTES = 26
MOST_LINES = 4096  # in one take
LONGEST_LINE = 64
KINDS = b"rwsex"  # read, write, stream; refused (data echoed, not written), unsupported
GREETING = ord("Q")  # kind assigned to the line an adapter sends after a reset ("QSB-D  0E!")

_FIXED_AT = [1, 4, 13, 22, 23, 24, 25]
_FIXED = np.frombuffer(b"    !\r\n", np.uint8)
_HEX_AT = [2, 3, *range(5, 13), *range(14, 22)]
_OF_POSITION = [(0, b"s"), (1, b" "), (2, b"0"), (3, b"E"), (4, b" "), (13, b" "), (22, b" ")]
_OF_POSITION += [(23, b"!"), (24, b"\r"), (25, b"\n")]
_FIELDS = np.dtype([("register", "u1"), ("data", ">u4"), ("stamp", ">u4")])
_IS_KIND = np.zeros(256, np.bool_)
_IS_KIND[list(KINDS)] = True
_IS_HEX = np.zeros(256, np.bool_)
_IS_HEX[list(b"0123456789ABCDEFabcdef")] = True

_HEX8 = rb"([0-9A-Fa-f]{8})"
_ANY_FORMAT = re.compile(rb"([rwsex]) ?([0-9A-Fa-f]{2}) ?" + _HEX8 + rb"(?: ?" + _HEX8 + rb")? ?!$")
_COMPLAINT = re.compile(rb"([ex]) ?([0-9A-Fa-f]{2})[ 0-9A-Fa-f]*!$")
_GREETING = re.compile(rb"QSB-[A-Z] *([0-9A-Fa-f]{2})!$")


class Lines(NamedTuple):
    """Decoded successive lines, each array of shape (n,).

    Attributes:
        kind: Code of the first character, or ``GREETING``.
        register: Register number.
        data: Its value.
        stamp: Timestamp, ticks modulo 2^32; 0 where the line has none.
        stamped: The lines carry timestamps.
        positions: All are streamed positions.
    """

    kind: NDArray[np.uint8]
    register: NDArray[np.uint8]
    data: NDArray[np.uint32]
    stamp: NDArray[np.uint32]
    stamped: bool = True
    positions: bool = False

    def since(self, first: int) -> "Lines":
        """The lines from ``first`` on."""
        if not first:
            return self
        kind, register, data, stamp, *flags = self
        return Lines(kind[first:], register[first:], data[first:], stamp[first:], *flags)


class LineStream(ReceivedBuffer):
    """Splits a byte stream into lines: ``receive`` bytes, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.
    """

    def __init__(self) -> None:
        super().__init__()
        self._in_step = False  # the last take found 26-byte lines where they were expected

    def take(self) -> Lines | None:
        """All whole lines up to the first of another form, or that one line; None when more bytes are needed.

        Raises:
            FrameError: No valid line at this place; the bytes were discarded, call ``take`` again.
        """
        count = min(len(self.waiting) // LINE_BYTES, MOST_LINES if self._in_step else 1)
        positions = _positions(self.waiting[: count * LINE_BYTES], count) if count else None
        if positions is not None:
            self.waiting = self.waiting[count * LINE_BYTES :]
            self._in_step = True
            return positions
        if count:
            matrix = np.frombuffer(self.waiting, np.uint8, count * LINE_BYTES).reshape(count, LINE_BYTES)
            good = _first_bad(matrix)
            self._in_step = good > 0
            if good:
                self.waiting = self.waiting[good * LINE_BYTES :]
                return _numbers(matrix[:good])
        return self._take_odd()

    def _take_odd(self) -> Lines | None:
        """A line of any format."""
        self.waiting = self.waiting.lstrip(b"\r\n")
        end = self.waiting.find(b"!", 0, LONGEST_LINE) + 1
        if not end:
            if len(self.waiting) < LONGEST_LINE:
                return None
            self.waiting = self.waiting[LONGEST_LINE:]
            raise FrameError(f"{LONGEST_LINE} bytes without the '!' that ends a line: check baud rate and wiring")
        text = self.waiting[:end]
        found = _ANY_FORMAT.search(text)
        if found is not None and found.start():
            self.waiting = self.waiting[found.start() :]
            raise FrameError(f"{text[: found.start()]!r} is no line: bytes were lost")
        self.waiting = self.waiting[end:]
        if found is not None:
            kind, register, data, stamp = found.groups()
            return _one(kind[0], register, data, stamp)
        if (complaint := _COMPLAINT.match(text)) is not None:
            return _one(complaint[1][0], complaint[2], b"0", None)
        if (greeting := _GREETING.search(text)) is not None:
            return _one(GREETING, b"0", greeting[1], None)
        raise FrameError(f"{text!r} is no line: bytes were lost")


def _positions(data: bytes, count: int) -> Lines | None:
    """Decode 26-byte lines that are all streamed positions, the fast path of the normal case; else None."""
    for at, text in _OF_POSITION:
        if data[at::LINE_BYTES] != text * count:
            return None
    try:
        fields = np.frombuffer(binascii.unhexlify(data.translate(None, b"s !\r\n")), _FIELDS)
    except ValueError:
        return None
    if len(fields) != count:
        return None
    kind = np.frombuffer(data, np.uint8)[::LINE_BYTES]
    return Lines(kind, fields["register"], fields["data"], fields["stamp"], positions=True)


def _first_bad(matrix: NDArray[np.uint8]) -> int:
    """Number of rows (n, 26) before the first that is not a line."""
    good = (matrix[:, _FIXED_AT] == _FIXED).all(axis=1)
    good &= _IS_KIND[matrix[:, 0]] & _IS_HEX[matrix[:, _HEX_AT]].all(axis=1)
    return len(matrix) if good.all() else int(good.argmin())


def _numbers(matrix: NDArray[np.uint8]) -> Lines:
    fields = np.frombuffer(binascii.unhexlify(matrix[:, _HEX_AT].tobytes()), _FIELDS)
    data, stamp = fields["data"].astype(np.uint32), fields["stamp"].astype(np.uint32)
    return Lines(matrix[:, 0].copy(), fields["register"].copy(), data, stamp)


def _one(kind: int, register: bytes, data: bytes, stamp: bytes | None) -> Lines:
    return Lines(
        np.array([kind], np.uint8),
        np.array([int(register, 16)], np.uint8),
        np.array([int(data, 16)], np.uint32),
        np.array([int(stamp or b"0", 16)], np.uint32),
        stamp is not None,
    )
