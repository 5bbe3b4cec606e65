"""The FIFO of a simulated chip: bytes that forget their oldest, and what ever went into it."""


class TwinFifo:
    """Bytes, and the accounts of the samples written.

    Args:
        size: How many.

    Attributes:
        produced: Samples written in each of the periods in which it was enabled, the current one last.
        between: Sample periods between two times in which it was filled.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.produced = [0]
        self.between = 0
        self._bytes = bytearray()
        self._last = 0
        self._latch = 0
        self._filled_s: float | None = None  # mission time of the last sample in it
        self._period_s = 1.0  # true sample period then

    def __len__(self) -> int:
        return len(self._bytes)

    def power_up(self) -> None:
        """Reset values; the accounts go on."""
        self._bytes = bytearray()
        self._last = self._latch = 0

    def enable(self) -> None:
        """USER_CTRL switches it on."""
        self.produced.append(0)

    def clear(self) -> None:
        """FIFO_RESET."""
        self._bytes.clear()

    def fill(self, data: bytes, samples: int, first_s: float, last_s: float, period_s: float) -> bool:
        """Write samples; whether it ran over.

        Args:
            data: Their bytes.
            samples: How many they are.
            first_s: Mission time of the first, s.
            last_s: Mission time of the last, s.
            period_s: True sample period, s.
        """
        if self._filled_s is not None and not self.produced[-1]:
            self.between += max(round((first_s - self._filled_s) / self._period_s) - 1, 0)
        self.produced[-1] += samples
        self._period_s = period_s
        self._filled_s = last_s
        return self.write(data)

    def write(self, data: bytes) -> bool:
        """Append bytes; whether it ran over, and the oldest are lost."""
        self._bytes += data
        excess = len(self._bytes) - self._size
        if excess > 0:
            del self._bytes[:excess]
        return excess > 0

    def pop(self, count: int, is_enabled: bool) -> bytes:
        """Bytes read; when it is empty or disabled, the last byte read, again and again."""
        taken = b""
        if is_enabled:
            taken = bytes(self._bytes[:count])
            del self._bytes[:count]
        if taken:
            self._last = taken[-1]
        return taken + bytes([self._last]) * (count - len(taken))

    def count_high(self) -> int:
        """FIFO_COUNT_H; reading it latches both halves."""
        self._latch = len(self._bytes)
        return self._latch >> 8

    def count_low(self) -> int:
        """FIFO_COUNT_L, as latched."""
        return self._latch & 0xFF
