"""How long a CAN frame is: its CRC is computed and its stuff bits are counted (ISO 11898-1), for one or for many."""

import struct
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

_CRC_POLYNOMIAL: Final = 0x4599  # ISO 11898-1: CRC-15-CAN
_TAIL_BITS: Final = 10  # CRC delimiter, ACK slot, ACK delimiter, seven bits of end-of-frame
INTERMISSION_BITS: Final = 3


def _crc_words() -> list[int]:
    """CRC of each 16-bit word, by that of its bytes."""
    table = np.arange(256) << 7
    for _ in range(8):
        table = (table << 1 ^ np.where(table & 0x4000, _CRC_POLYNOMIAL, 0)) & 0x7FFF
    first = table[:, None]
    return list((table[first >> 7 ^ np.arange(256)] ^ (first << 8 & 0x7FFF)).ravel().tolist())


def _stuff_words() -> bytes:
    """By state * 65536 + word: the next state + 16 * the stuff bits inserted; state = 2 * run length + last bit.

    By the same of each byte, (10, 256): a run is four bits long at most.
    """
    before, byte = np.arange(10, dtype=np.uint8)[:, None], np.arange(256, dtype=np.uint8)
    run, last, stuffed = before >> 1, before & 1, np.zeros((10, 256), np.uint8)
    for shift in range(7, -1, -1):
        bit = byte >> shift & 1
        run = np.where((bit == last) & (run > 0), run + 1, 1)
        full = run == 5  # the stuff bit is the opposite one, and begins a run of its own
        stuffed += full
        run, last = np.where(full, 1, run), bit ^ full
    state = run << 1 | last
    both = state[state] | (stuffed[:, :, None] + stuffed[state]) << 4  # (10, 256, 256)
    return bytes(both.tobytes())


_CRC: Final = _crc_words()
_STUFF: Final = _stuff_words()
_CRCS: Final = np.array(_CRC)
_STUFFS: Final = np.frombuffer(_STUFF, np.uint8)
_WORDS: Final = tuple(struct.Struct(f">{count}H") for count in range(8))


def crc15(bits: int, n_bytes: int) -> int:
    """CRC-15-CAN of a bit string held in the low ``8 * n_bytes`` bits; leading zero bits do not change it."""
    crc, count = 0, (n_bytes + 1) // 2
    for word in _WORDS[count].unpack(bits.to_bytes(2 * count, "big")):
        crc = _CRC[crc << 1 ^ word]
    return crc


@lru_cache(maxsize=4096)  # SYNCs, and values that rest
def frame_bits(identifier: int, data: bytes, asked: int | None = None) -> int:
    """Length of a frame with an 11-bit identifier, start-of-frame to end-of-frame, stuff bits included.

    Args:
        identifier: Its.
        data: Its; none in a remote frame.
        asked: How many bytes a remote frame asks for; None: a data frame.
    """
    n = len(data)
    control = n if asked is None else 1 << 6 | asked  # RTR, IDE, r0, 4 bits DLC
    head = identifier << 7 | control  # with SOF and 11 identifier bits: 19 bits
    body = head << 8 * n | int.from_bytes(data, "big")
    stuffed_bits = 34 + 8 * n
    stream = body << 15 | crc15(body, n + 3)
    padding_bits = -stuffed_bits % 16  # to a whole word; alternating bits are never stuffed
    padding = (0x1555 if stream & 1 else 0x2AAA) >> 14 - padding_bits
    count = (stuffed_bits + padding_bits) // 16
    state = stuff_bits = 0
    for word in _WORDS[count].unpack((stream << padding_bits | padding).to_bytes(2 * count, "big")):
        found = _STUFF[state << 16 | word]
        state = found & 15
        stuff_bits += found >> 4
    return stuffed_bits + stuff_bits + _TAIL_BITS


def frames_bits(identifier: int, data: NDArray[np.uint8]) -> NDArray[np.int64]:
    """``frame_bits`` of data frames with one identifier, data (frames, bytes); shape (frames,)."""
    count, n = data.shape
    head = np.unpackbits(np.frombuffer((identifier << 7 | n).to_bytes(3, "big"), np.uint8))
    size = 34 + 8 * n
    bits = np.empty((count, 5 + size + -size % 16), np.uint8)  # five zeros before the start of frame fill a byte
    bits[:, :24] = head
    bits[:, 24 : 24 + 8 * n] = np.unpackbits(data, axis=1)
    odd = 8 * (n % 2 == 0)  # zeros in front, to whole words
    body = np.zeros((count, odd + 24 + 8 * n), np.uint8)
    body[:, odd:] = bits[:, : 24 + 8 * n]
    crc = np.zeros(count, np.int64)
    for word in _words(body):
        crc = _CRCS[crc << 1 ^ word]
    bits[:, 24 + 8 * n : 5 + size] = crc[:, None] >> np.arange(14, -1, -1) & 1
    padding = np.arange(1, 1 + -size % 16) & 1  # alternating bits are never stuffed
    bits[:, 5 + size :] = bits[:, 4 + size, None] ^ padding
    state, stuffed = np.zeros((2, count), np.int64)
    for word in _words(bits[:, 5:]):
        found = _STUFFS[state << 16 | word].astype(np.int64)
        state = found & 15
        stuffed += found >> 4
    lengths: NDArray[np.int64] = size + stuffed + _TAIL_BITS
    return lengths


def _words(bits: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Bits (frames, 16 k) as words, (k, frames)."""
    return np.packbits(bits, axis=1).view(">u2").T.astype(np.int64)
