"""Code of the sync pulses: any three successive intervals identify the pulse number.

The interval before pulse n is ``30 + c[n mod 32768]`` SYNC periods, c being the de Bruijn sequence B(32, 3) over 0..31
in its lexicographically least form: the Lyndon words whose length divides 3, joined in lexicographic order
(Fredricksen, Kessler and Maiorana, "Lexicographic compositions and deBruijn sequences", 1977). Every triple occurs
once in a cycle, so a stream that starts late or misses edges is identified after three good intervals. Pulse 0 rises
with SYNC number 0; at 200 Hz the intervals are 150..305 ms and the code repeats after 2.07 h.

Pulse n rises a little after the start of its SYNC period: ``(19 n) mod 32`` thirty-seconds of a millisecond, so that
any 32 in a row fall on all of them. A 1 kHz recorder marks a pulse to one sample; with pulses whole milliseconds apart
all would fall at the same phase of its sample period, and the quantisation error would not average out.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

SYMBOLS = 32
WORD = 3
CODE_LENGTH = SYMBOLS**WORD
SHORTEST_INTERVAL = 30


@cache
def intervals() -> NDArray[np.int64]:
    """The intervals of one cycle, SYNC periods, read-only, shape (32768,): entry n precedes pulse n."""
    symbols: list[int] = []
    word = [-1]
    while word:  # Duval's generation of Lyndon words up to length 3, in lexicographic order
        word[-1] += 1
        if WORD % len(word) == 0:
            symbols += word
        word = [word[place % len(word)] for place in range(WORD)]
        while word and word[-1] == SYMBOLS - 1:
            word.pop()
    code = np.array(symbols, np.int64) + SHORTEST_INTERVAL
    code.setflags(write=False)
    return code


@cache
def dither_ns() -> NDArray[np.int64]:
    """Delay of each pulse of one cycle after the start of its SYNC period, ns. Read-only, shape (32768,)."""
    delays = 19 * np.arange(CODE_LENGTH, dtype=np.int64) % 32 * (1_000_000 // 32)
    delays.setflags(write=False)
    return delays


@cache
def sync_numbers() -> NDArray[np.int64]:
    """SYNC number with which each pulse of the first cycle rises; entry 0 is 0. Read-only, shape (32768,)."""
    numbers = np.cumsum(intervals())
    numbers -= numbers[0]
    numbers.setflags(write=False)
    return numbers


@cache
def cycle_sync_periods() -> int:
    """SYNC periods in one cycle of the code: pulse n + 32768 rises this long after pulse n."""
    return int(intervals().sum())
