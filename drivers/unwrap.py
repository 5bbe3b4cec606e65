"""Unwraps counters that wrap at a power of two."""

import numpy as np
from numpy.typing import NDArray


def steps(words: NDArray[np.integer], bits: int, before: int) -> NDArray[np.int64]:
    """Signed steps of a wrapping counter, each the one of smaller magnitude.

    Args:
        words: Counter values modulo ``2**bits``, signed or unsigned, shape (n,).
        bits: Its width, up to 63.
        before: Value before the first of them, modulo ``2**bits``.

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
    """Unwrapped values of a counter.

    Args:
        words: As in ``steps``; at least one.
        bits: The same.
        before: The same.
        value: Unwrapped value before the first of them.

    Returns:
        ``value`` plus the accumulated steps, shape (n,).
    """
    half = 1 << (bits - 1)
    plain = words.tolist()
    if max(plain) - min(plain) < half:  # no wrap among these values
        first = value + (plain[0] - before + half) % (2 * half) - half
        whole: NDArray[np.int64] = words.astype(np.int64)
        whole += first - plain[0]
        return whole
    return value + steps(words, bits, before).cumsum()
