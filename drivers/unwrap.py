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


def unwrapped(words: NDArray[np.integer], bits: int, before: int, value: int) -> NDArray[np.int64]:
    """A counter made whole.

    Args:
        words: As of ``steps``; one at least.
        bits: The same.
        before: The same.
        value: What the whole counter was then.

    Returns:
        ``value`` and the steps since, shape (n,).
    """
    half = 1 << (bits - 1)
    plain = words.tolist()
    if max(plain) - min(plain) < half:  # it does not wrap among them
        first = value + (plain[0] - before + half) % (2 * half) - half
        whole: NDArray[np.int64] = words.astype(np.int64)
        whole += first - plain[0]
        return whole
    return value + steps(words, bits, before).cumsum()
