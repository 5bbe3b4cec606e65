"""Counters that wrap at some power of two."""

import numpy as np
from numpy.typing import NDArray


def steps(words: NDArray[np.integer], bits: int, before: int) -> NDArray[np.int64]:
    """Signed steps of a counter, each the shorter way round.

    Args:
        words: What it held, modulo ``2**bits``, signed or unsigned, shape (n,).
        bits: Its width, up to 63.
        before: What it held before the first of them; whole turns of it do not matter.

    Returns:
        Steps in ``-2**(bits - 1) .. 2**(bits - 1) - 1``, shape (n,).
    """
    half = 1 << (bits - 1)
    whole = words.astype(np.int64)
    shifted = np.empty_like(whole)
    shifted[:1] = before % (2 * half)
    shifted[1:] = whole[:-1]
    turned: NDArray[np.int64] = ((whole - shifted + half) & (2 * half - 1)) - half
    return turned
