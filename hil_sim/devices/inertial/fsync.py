"""The FSYNC latch of a simulated chip (RM-MPU-6000A 4.3): a pulse on the pin marks one bit of the next sample."""

import numpy as np
from numpy.typing import NDArray


class FsyncLatch:
    """Pulses on the pin, until the sample that they mark is made. Times are mission times [s]."""

    def __init__(self) -> None:
        self._pulses: list[tuple[float, float]] = []  # rise and fall

    def high(self, rise_s: float, fall_s: float) -> None:
        """The pin is high from ``rise_s`` to ``fall_s``."""
        self._pulses.append((rise_s, fall_s))

    def latch(self, counts: NDArray[np.int16], times_s: NDArray[np.float64], last_s: float, column: int | None) -> None:
        """Mark the samples in which the pin was high at any time since the sample before.

        Args:
            counts: samples (n, 7), changed in place.
            times_s: when they were made, (n,).
            last_s: when the sample before them was made.
            column: the word whose lowest bit is the mark; None: EXT_SYNC_SET is off.
        """
        if column is None:
            return
        if not self._pulses:
            counts[:, column] &= ~1
            return
        before_s = np.concatenate(([last_s], times_s[:-1]))  # (n,)
        marks = np.zeros(len(times_s), np.int16)
        for rise_s, fall_s in self._pulses:
            first = int(np.searchsorted(times_s, rise_s, "left"))
            last = int(np.searchsorted(before_s, fall_s, "left"))
            marks[first:last] = 1
        counts[:, column] = (counts[:, column] & ~1) | marks

    def forget(self, last_s: float) -> None:
        """Pulses over before ``last_s``, the time of the newest sample, mark nothing more."""
        if self._pulses:
            self._pulses = [pulse for pulse in self._pulses if pulse[1] > last_s]
